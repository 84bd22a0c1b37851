"""Page 3: time between the images of two cameras, which causes depth errors on a moving robot."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.errors import InputError
from lmkit.live.captures import Capture, SourceLost
from lmkit.live.clock import LoopClock
from lmkit.live.open_capture import open_capture
from lmkit.live.source_address import parse_source

SETTLING, COUNTED = 3, 12  # images


def time_between(names: Sequence[str]) -> float:
    """Median time from an image of the first camera to the nearest of the second, seconds.

    Both cameras run simultaneously, as in a live run; stamps are the driver's if available, else the times of
    arrival.

    Raises:
        InputError: one of them gives no image while the other is open.
    """
    clock = LoopClock()
    captures: list[Capture] = []
    try:
        for name in names:
            captures.append(open_capture(parse_source(name), clock))
        with ThreadPoolExecutor(len(captures)) as pool:
            first, second = pool.map(_stamps, captures)
    except SourceLost as error:
        message = f"{names[0]} and {names[1]} do not run at the same time: {error}"
        raise InputError("not_together", message, "plug them into different USB controllers") from None
    finally:
        for capture in captures:
            capture.close()
    return float(np.median(np.abs(first[:, None] - second).min(axis=1)))


def _stamps(capture: Capture) -> FloatArray:
    return np.array([capture.read()[0] for _ in range(SETTLING + COUNTED)][SETTLING:])
