"""Memory that kernels work in, kept from call to call: pages that are new cost more than many a kernel."""

from __future__ import annotations

import math
import threading

import numpy as np
from numpy.typing import NDArray

from lmkit.kernels.load import address


class Workspace(threading.local):
    """Named arrays of each thread; they grow and are never given back."""

    def __init__(self) -> None:
        self._held: dict[str, tuple[NDArray[np.float32], int]] = {}

    def bytes(self, name: str, shape: tuple[int, ...]) -> NDArray[np.uint8]:
        """Array of this shape in memory that the next call with the name gives again."""
        size = math.prod(shape)
        self.floats(name, (size + 3) // 4)
        return self._held[name][0].view(np.uint8)[:size].reshape(shape)

    def floats(self, name: str, count: int) -> int:
        """Address of at least so many floats, whose values are whatever the last call left."""
        held = self._held.get(name)
        if held is None or len(held[0]) < count:
            array = np.empty(count + 16, np.float32)
            held = array, address(array)
            self._held[name] = held
        return held[1]
