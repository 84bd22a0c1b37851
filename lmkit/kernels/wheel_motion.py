"""Planar motions between times from rows of wheel odometry, for several sets of its errors.

Each row is a chord at the heading of its midpoint; between rows the path is straight.
"""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lmkit.kernels.load import address, addresses, contiguous, function

Array = NDArray[np.floating[Any]]


@dataclass(frozen=True, eq=False)
class WheelRows:
    """N rows of odometry, as arrays (N,).

    Attributes:
        times: seconds, increasing.
        forward, turn: since the previous row, meters and radians.
        seconds: since the previous row.
        rate: absolute yaw rate, rad/s.
    """

    times: Array
    forward: Array
    turn: Array
    seconds: Array
    rate: Array

    def __post_init__(self) -> None:
        """Make the arrays contiguous.

        Raises:
            ValueError: a shape differs.
        """
        count = len(self.times)
        for name in ("times", "forward", "turn", "seconds", "rate"):
            object.__setattr__(self, name, contiguous(getattr(self, name), (count,)))


def wheel_motions(rows: WheelRows, at: Array, parameters: Array) -> Array:
    """(P,K-1,3) forward, left (m) and turn (rad) between consecutive times ``at`` (K,), in either order.

    Args:
        parameters: (P,6) sets of errors: scale of the way, scale of the turns, turn per second, turn per meter, share
            of the way that is lost per rad/s, and delay in seconds.

    Raises:
        ValueError: a shape differs, or fewer than two rows.
    """
    if len(rows.times) < 2:
        raise ValueError(f"{len(rows.times)} rows, expected two at least")
    at, parameters = contiguous(at, (-1,)), contiguous(parameters, (-1, 6))
    kernel = _kernel()
    if kernel is None:
        return wheel_motions_numpy(rows, at, parameters)
    count, sets = len(at), len(parameters)
    path, motions = np.empty((len(rows.times), 3)), np.empty((sets, max(count - 1, 0), 3))
    columns = addresses(rows.times, rows.forward, rows.turn, rows.seconds, rows.rate)
    kernel(len(rows.times), *columns, sets, *addresses(parameters), count, *addresses(at, path, motions))
    return motions


def wheel_motions_numpy(rows: WheelRows, at: Array, parameters: Array) -> Array:
    """Definition of :func:`wheel_motions`."""
    scale, turn_scale, per_s, per_m, slowing, delay = parameters.T[:, :, None]
    forward = scale * rows.forward * (1 - slowing * rows.rate)
    turn = turn_scale * rows.turn + per_s * rows.seconds + per_m * forward
    heading = np.cumsum(turn, axis=1)
    middle = heading - turn / 2
    path = np.stack(
        [np.cumsum(forward * np.cos(middle), axis=1), np.cumsum(forward * np.sin(middle), axis=1), heading]
    )
    own = np.clip(at - delay, rows.times[0], rows.times[-1])
    after = np.searchsorted(rows.times, own).clip(1, len(rows.times) - 1)
    share = (own - rows.times[after - 1]) / (rows.times[after] - rows.times[after - 1])
    sets = np.arange(len(parameters))[:, None]
    x, y, turned = path[:, sets, after - 1] * (1 - share) + path[:, sets, after] * share
    dx, dy = np.diff(x, axis=1), np.diff(y, axis=1)
    c, s = np.cos(turned[:, :-1]), np.sin(turned[:, :-1])
    return np.stack([c * dx + s * dy, -s * dx + c * dy, np.diff(turned, axis=1)], axis=2)


class Moves(NamedTuple):
    """Steps of parameters for derivatives, and the definition of a gap.

    Attributes:
        steps: of each parameter but the delay.
        delay_span_s: of the delay, to both sides.
        longest_step_s: longest interval between rows; longer intervals are gaps without information.
    """

    steps: tuple[float, float, float, float, float]
    delay_span_s: float
    longest_step_s: float


class WheelSteps(NamedTuple):
    """Motions between K times.

    Attributes:
        motions: (K-1,3) forward, left (m), turn (rad).
        by_parameters: (K-1,3,6) derivatives.
        grown: (K-1,4) seconds, way (m) and turn (rad) by the rows, and of the seconds those without odometry.
    """

    motions: Array
    by_parameters: Array
    grown: Array


def wheel_steps(rows: WheelRows, at: Array, parameters: Array, moves: Moves) -> WheelSteps:
    """Motions between consecutive times ``at`` (K,), with errors (6,) as of :func:`wheel_motions`.

    Raises:
        ValueError: a shape differs, or fewer than two rows.
    """
    at, parameters = contiguous(at, (-1,)), contiguous(parameters, (6,))
    size, between = len(rows.times), max(len(at) - 1, 0)
    if size < 2:
        raise ValueError(f"{size} rows, expected two at least")
    kernel = _steps_kernel()
    if kernel is None:
        return wheel_steps_numpy(rows, at, parameters, moves)
    found = WheelSteps(np.empty((between, 3)), np.empty((between, 3, 6)), np.empty((between, 4)))
    numbers = (ctypes.c_double * 7)(*moves.steps, moves.delay_span_s, moves.longest_step_s)
    scratch = np.empty(3 * size + 24 * between)
    columns = addresses(rows.times, rows.forward, rows.turn, rows.seconds, rows.rate, parameters)
    path = address(scratch)
    kernel(size, *columns, numbers, len(at), address(at), path, path + 24 * size, *addresses(*found))
    return found


def wheel_steps_numpy(rows: WheelRows, at: Array, parameters: Array, moves: Moves) -> WheelSteps:
    """Definition of :func:`wheel_steps`."""
    count = len(moves.steps) + 1
    moved = np.zeros((count + 2, count))
    moved[1:-2, :-1] = np.diag(moves.steps)
    moved[-2:, -1] = moves.delay_span_s, -moves.delay_span_s
    motions = wheel_motions_numpy(rows, at, parameters + moved)
    by_parameters = (motions[1:-1] - motions[0]).transpose(1, 2, 0) / np.append(moves.steps, 1.0)
    by_parameters[:, :, -1] = (motions[count] - motions[count + 1]) / (2 * moves.delay_span_s)
    own = at - parameters[-1]
    outside = np.minimum(own, rows.times[0]) + np.maximum(own, rows.times[-1])
    # A row after a gap has the distance traveled in it, but not the times.
    gaps = np.where(rows.seconds > moves.longest_step_s, rows.seconds, 0.0)
    totals = np.cumsum([np.abs(rows.forward), np.abs(rows.turn), gaps], axis=1)
    growing = np.array([at, *(np.interp(own, rows.times, total) for total in totals), outside])
    grown = np.abs(np.diff(growing, axis=1))
    grown[3] += grown[4]
    return WheelSteps(motions[0], by_parameters, grown[:4].T)


@lru_cache(maxsize=1)
def _kernel() -> Any:
    count, pointer = ctypes.c_int64, ctypes.c_void_p
    return function("lmkit_wheel_motions", count, *[pointer] * 5, count, pointer, count, pointer, pointer, pointer)


@lru_cache(maxsize=1)
def _steps_kernel() -> Any:
    count, pointer = ctypes.c_int64, ctypes.c_void_p
    return function("lmkit_wheel_steps", count, *[pointer] * 7, count, *[pointer] * 6)
