"""Workspace of kernels, kept between calls: new memory pages cost more time than many kernels."""

from __future__ import annotations

import math
import threading
import weakref
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lmkit.kernels.load import address

SHAPES = 16  # largest number of image sizes in use at once


class Workspace(threading.local):
    """Named arrays of each thread; they grow and are never released."""

    def __init__(self) -> None:
        self._held: dict[str, tuple[NDArray[np.float32], int]] = {}

    def bytes(self, name: str, shape: tuple[int, ...]) -> NDArray[np.uint8]:
        """Array of this shape, in memory that the next call with the same name reuses."""
        size = math.prod(shape)
        self.floats(name, (size + 3) // 4)
        return self._held[name][0].view(np.uint8)[:size].reshape(shape)

    def floats(self, name: str, count: int) -> int:
        """Address of at least a number of floats, with the values of the last call."""
        held = self._held.get(name)
        if held is None or len(held[0]) < count:
            array = np.empty(count + 16, np.float32)
            held = array, address(array)
            self._held[name] = held
        return held[1]


class _Loan:
    """Base of all arrays on lent memory: in numpy, slices of an array have the same base."""

    def __init__(self, held: NDArray[Any]) -> None:
        self.__array_interface__ = held.__array_interface__


class Loans:
    """Arrays whose memory is reused after they and their slices are dropped, at most ``most`` of one shape."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._free: dict[Any, list[NDArray[Any]]] = {}

    def lend(self, shape: tuple[int, ...], dtype: Any, written: tuple[slice, ...] | None = None) -> NDArray[Any]:
        """Array of this shape and type, with the values of its last user.

        Args:
            written: the part that is written to; it is cleared at the end, and the array is 0 elsewhere.
        """
        key = (shape, dtype, written is None)
        try:
            held = self._free[key].pop()
        except LookupError:
            held = np.zeros(shape, dtype)
        loan = _Loan(held)
        weakref.finalize(loan, self._take_back, key, held, written).atexit = False
        return np.asarray(loan)

    def _take_back(self, key: Any, held: NDArray[Any], written: tuple[slice, ...] | None) -> None:
        if written is not None:
            held[written] = 0
        if key not in self._free and len(self._free) >= SHAPES:
            self._free.clear()
        free = self._free.setdefault(key, [])
        if len(free) < self._most:
            free.append(held)
