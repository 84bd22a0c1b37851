"""Plausibility checks of odometry and gyro: units, signs, axes and clocks; used by all commands.

Both are compared with each other, and with poses from landmarks alone, if there are any.  A contradiction with a
known cause is refused; small errors of scale and delay are estimated by the solvers.
"""

from __future__ import annotations

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.errors import InputError, InputWarning, warn_caller
from lmkit.geometry.planar import between, follow
from lmkit.model.recording import Gyro, Odometry
from lmkit.model.trajectory import Trajectory

WINDOW_S = 1.0  # over which speeds are computed
FASTEST_MPS, FASTEST_RADPS = 40.0, 10.0  # largest speed of a robot that reads landmarks
LARGEST_STEP = 1e4  # m and rad from one row to the next, and rad/s: no measurement
LEAST_PAIRS = 12
LEAST_IN_DEGREES = 4  # a ratio of 57 is no accident
LEAST_TURN_RAD, LEAST_WAY_M = 0.05, 0.05  # root mean squares below which nothing can be compared
LIKE, LAGGED, UNLIKE, OPPOSITE = 0.8, 0.87, 0.4, -0.6  # correlations
OFF_SCALE = 2.0
STILL = 1e-4  # odometry that moves by less than this share of the distance does not move
SLOWEST_STEP_S = 1.5  # between rows of a sensor whose stamps are seconds
# Images of a moving robot follow each other within seconds; those that are further apart may be in another unit.
SELDOM_S, RARE_S, LEAST_SELDOM = 5.0, 30.0, 4
LATEST_S = 1e11  # year 5138
CLOCKS = {1e3: "milliseconds", 1e6: "microseconds", 1e9: "nanoseconds"}
LONGEST_LAG_S, LAG_STEP_S, LEAST_LAG_S = 60.0, 0.1, 0.5
UNITS = {1000.0: "millimeters", 100.0: "centimeters", 39.37: "inches", 3.281: "feet", 0.001: "kilometers"}
DEGREES = float(np.rad2deg(1.0))
NAMED = 3  # gaps in a warning
ALIKE = 0.25  # logarithm of a ratio to that of a unit

Pairs = tuple[FloatArray, FloatArray]


def require_plausible_odometry(odometry: Odometry | Trajectory) -> None:
    """Refuse implausible speeds.

    Raises:
        InputError: ``implausible_odometry``, naming the unit that is likely.
    """
    times = odometry.times_s
    if len(times) < 2:
        return
    if isinstance(odometry, Trajectory):
        way = np.linalg.norm(np.diff(odometry.positions, axis=0, prepend=odometry.positions[:1]), axis=1)
        turn = np.zeros(len(times))
    else:
        way, turn = np.abs(odometry.forward_m), np.abs(odometry.turn_rad)
    worst = int(np.argmax(way + turn))
    if not way[worst] + turn[worst] < LARGEST_STEP:
        raise _refused(
            "implausible_odometry",
            f"odometry moves by {way[worst]:.3g} m and {turn[worst]:.3g} rad at once, at {times[worst]:.3f} s",
            "remove that row, or the fault of the sensor that wrote it",
        )
    if (speed := _usual_rate(times, way)) > FASTEST_MPS:
        raise _refused(
            "implausible_odometry",
            f"odometry moves at {speed:.3g} m/s: are its lengths in millimeters or centimeters?",
        )
    if (rate := _usual_rate(times, turn)) > FASTEST_RADPS:
        raise _refused("implausible_odometry", f"odometry turns at {rate:.3g} rad/s: are its angles in degrees?")


def require_seconds(times_s: FloatArray) -> None:
    """Refuse image times that are not plausible seconds; warn if images are unusually far apart in time.

    Images a minute apart are possible, so there is only a warning.

    Args:
        times_s: (N,) in any order.

    Raises:
        InputError: ``implausible_times``, with the unit that is likely meant.
    """
    apart = np.diff(np.unique(times_s))
    if len(apart) == 0:
        return
    usual = float(np.median(apart))
    unit = next((name for factor, name in CLOCKS.items() if usual / factor < SELDOM_S), "")
    doubt = (
        f"the images are usually {usual:.4g} s apart, from {times_s.min():.10g} to {times_s.max():.10g} s: "
        f"are their times in {unit or 'milliseconds'}?"
    )
    if float(np.abs(times_s).max()) > LATEST_S:
        raise _refused("implausible_times", doubt, "give time_s in seconds")
    if len(apart) >= LEAST_SELDOM and usual > RARE_S and unit:
        warn_caller(InputWarning(doubt))


def require_plausible_gyro(gyro: Gyro, odometry: Odometry) -> None:
    """Refuse a gyro in degrees, about another axis, of another sign or on another clock than the wheels.

    Raises:
        InputError: ``implausible_gyro`` or ``no_common_times``.

    Warns:
        InputWarning: the gyro starts late, ends early or has gaps.
    """
    start, end = max(gyro.times_s[0], odometry.times_s[0]), min(gyro.times_s[-1], odometry.times_s[-1])
    if start >= end:
        raise _refused(
            "no_common_times",
            f"the gyro runs from {gyro.times_s[0]:.3f} to {gyro.times_s[-1]:.3f} s, odometry from "
            f"{odometry.times_s[0]:.3f} to {odometry.times_s[-1]:.3f} s: they are on different clocks",
            "give both in seconds of the same clock",
        )
    if not (fastest := float(np.abs(gyro.rate_radps).max())) < LARGEST_STEP:
        raise _refused("implausible_gyro", f"the gyro turns at {fastest:.3g} rad/s", "remove that row")
    rate = float(np.percentile(np.abs(gyro.rate_radps), 95))
    if rate > FASTEST_RADPS:
        raise _refused("implausible_gyro", f"the gyro turns at {rate:.3g} rad/s: is it in degrees per second?")
    require_one_clock(gyro.times_s, odometry.times_s, "the gyro", "odometry")
    if missing := _missing(gyro, odometry):
        sentence = f"the gyro has no rates {missing}: the wheels' rotation is used; record both from start to end"
        warn_caller(InputWarning(sentence))
    times = np.arange(start, end, WINDOW_S)
    if len(times) <= LEAST_IN_DEGREES:
        return
    wheels = np.interp(times, odometry.times_s, np.cumsum(odometry.turn_rad))
    own, theirs = np.diff(gyro.turned(times)), np.diff(wheels)
    if _rms(theirs) < LEAST_TURN_RAD:
        return
    scale, like = _compared(own, theirs)
    if len(times) <= LEAST_PAIRS and not _is(scale, DEGREES):
        return
    if like > LIKE and scale > OFF_SCALE:
        unit = "it is in degrees per second" if _is(scale, DEGREES) else "check its unit"
        raise _refused("implausible_gyro", f"the gyro turns {scale:.3g} times as fast as the wheels: {unit}")
    if like < OPPOSITE:
        raise _refused(
            "implausible_gyro",
            "the gyro turns the other way than the wheels: its z axis points down, or the sign is another",
            "give the rate about the upward axis, positive to the left",
        )
    if like < UNLIKE:
        lag = _best_lag(times, theirs, gyro.times_s, gyro.turned(gyro.times_s))
        raise _refused(
            "implausible_gyro",
            "the gyro does not turn when the wheels do: "
            + (f"its clock is {lag:+.1f} s off theirs" if lag is not None else "it is about another axis"),
            "give the rate about the upward axis, positive to the left, in seconds of the odometry's clock; of an "
            "IMU with the axes of an optical frame (z forward, y down) that is minus the rate about y",
        )


def _missing(gyro: Gyro, odometry: Odometry) -> str:
    """Times of the odometry, in words, without a gyro for over a second."""
    first, last = odometry.times_s[[0, -1]].tolist()
    spans = [(first, float(gyro.times_s[0])), *gyro.gaps(), (float(gyro.times_s[-1]), last)]
    spans = [(start, end) for start, end in spans if end - start > WINDOW_S]
    some = ", ".join(f"from {start:.1f} to {end:.1f} s" for start, end in spans[:NAMED])
    return some + (f" and {len(spans) - NAMED} times more" if len(spans) > NAMED else "")


def require_agreement(odometry: Odometry, times_s: FloatArray, states: FloatArray) -> None:
    """Refuse wheel odometry that poses from landmarks alone contradict, if the cause is known.

    Args:
        times_s: (K,) of the poses, increasing.
        states: (K,3) x, y (m) and heading (rad), without any odometry.

    Raises:
        InputError: ``odometry_contradicts``: backwards, mirrored, another unit or another clock.
    """
    rows = _pairs(times_s)
    if len(rows) < LEAST_PAIRS:
        return
    path = follow(
        np.zeros(3), np.column_stack([odometry.forward_m, np.zeros(len(odometry.times_s)), odometry.turn_rad])
    )
    path = path[1:]
    at = np.column_stack([np.interp(times_s, odometry.times_s, column) for column in path.T])
    seen, said = (
        np.array([between(poses[[a, b]])[0] for a, b in rows.tolist()]) for poses in (_unwrapped(states), at)
    )
    # In a gap or outside its times, odometry gives no information.
    inside = (times_s[rows] >= odometry.times_s[0]).all(axis=1) & (times_s[rows] <= odometry.times_s[-1]).all(axis=1)
    seen, said, rows = seen[inside], said[inside], rows[inside]
    if len(rows) < LEAST_PAIRS:
        return
    _judge_turns(seen[:, 2], said[:, 2], odometry, times_s[rows])
    _judge_way(seen[:, 0], said[:, 0])


def require_one_clock(own_s: FloatArray, other_s: FloatArray, own: str, other: str) -> None:
    """Refuse time stamps in another unit than those of another sensor of the same recording.

    Args:
        own, other: the two sensors in words.

    Raises:
        InputError: ``clock_unit``, naming the unit.
    """
    spans = [float(times[-1] - times[0]) for times in (own_s, other_s)]
    if min(spans) <= 0:
        return
    both = ((own, other, own_s, spans[0] / spans[1]), (other, own, other_s, spans[1] / spans[0]))
    for longer, shorter, times, ratio in both:
        if np.median(np.diff(times)) < SLOWEST_STEP_S:
            continue
        unit = next((name for factor, name in CLOCKS.items() if abs(float(np.log(ratio / factor))) < ALIKE), None)
        if unit is not None:
            raise _refused(
                "clock_unit",
                f"the times of {longer} span {ratio:.4g} times those of {shorter}: are they in {unit}?",
                "give both in seconds of the same clock",
            )


def _judge_way(seen: FloatArray, said: FloatArray) -> None:
    if _rms(seen) < LEAST_WAY_M:
        return
    if _rms(said) < STILL * _rms(seen):
        raise _refused(
            "odometry_contradicts",
            "odometry stands still while the landmarks show that the robot moves",
            "give the columns that move, in meters; leave odometry out if the wheels are not measured",
        )
    scale, like = _compared(said, seen)
    if like < OPPOSITE:
        raise _refused(
            "odometry_contradicts",
            "odometry runs backwards: the robot moves in the opposite direction",
            "negate the way forward (x_m and y_m, forward_mps, left_m and right_m), or turn T_base_left by 180 deg",
        )
    if like > LIKE and not 1 / OFF_SCALE < scale < OFF_SCALE:
        unit = next((f": are these {name}?" for factor, name in UNITS.items() if _is(scale, factor)), "")
        raise _refused("odometry_contradicts", f"odometry moves {scale:.3g} times as far as the landmarks show{unit}")


def _judge_turns(seen: FloatArray, said: FloatArray, odometry: Odometry, times_s: FloatArray) -> None:
    if _rms(seen) < LEAST_TURN_RAD or _rms(said) == 0.0:
        return
    scale, like = _compared(said, seen)
    if like < LIKE:
        lag = _best_lag(times_s, seen, odometry.times_s, np.cumsum(odometry.turn_rad))
        if lag is not None:
            raise _refused(
                "odometry_contradicts",
                f"odometry agrees with the landmarks only if it is shifted by {-lag:+.1f} s: its clock is another",
                "give both in seconds of the same clock",
            )
    if like < OPPOSITE:
        raise _refused(
            "odometry_contradicts",
            "odometry turns the other way than the landmarks show",
            "turns and bearings are positive to the left (counter-clockwise from above); check the wheels' order",
        )
    if like > LIKE and scale > OFF_SCALE:
        unit = "its angles are in degrees" if _is(scale, DEGREES) else "check the unit of its angles"
        raise _refused(
            "odometry_contradicts", f"odometry turns {scale:.3g} times as far as the landmarks show: {unit}"
        )


def _pairs(times_s: FloatArray) -> FloatArray:
    """(P,2) rows that are between one and four windows apart."""
    later = np.searchsorted(times_s, times_s + WINDOW_S)
    rows = np.column_stack([np.arange(len(times_s)), later])[later < len(times_s)]
    return np.asarray(rows[np.diff(times_s[rows], axis=1)[:, 0] < 4 * WINDOW_S])


def _best_lag(times_s: FloatArray, turns: FloatArray, own_s: FloatArray, turned: FloatArray) -> float | None:
    """Seconds by which a clock is ahead, if the rotations agree only with that offset; None if they never agree.

    Args:
        times_s: (P+1,) or (P,2) between which ``turns`` (P,) happened.
        own_s, turned: time and angle of the other sensor.
    """
    pairs = times_s if times_s.ndim == 2 else np.column_stack([times_s[:-1], times_s[1:]])
    best: tuple[float, float] | None = None
    for lag in np.arange(-LONGEST_LAG_S, LONGEST_LAG_S, LAG_STEP_S).tolist():
        there = pairs + lag
        inside = (there[:, 0] >= own_s[0]) & (there[:, 1] <= own_s[-1])
        # Rotations of a few seconds correlate by chance.
        if inside.sum() < max(LEAST_PAIRS, len(turns) / 2) or _rms(turns[inside]) < LEAST_TURN_RAD:
            continue
        other = np.diff(np.interp(there[inside], own_s, turned), axis=1)[:, 0]
        like = _compared(other, turns[inside])[1]
        if best is None or like > best[0]:
            best = like, lag
    return best[1] if best is not None and best[0] > LAGGED and abs(best[1]) > LEAST_LAG_S else None


def _compared(own: FloatArray, other: FloatArray) -> tuple[float, float]:
    """Scale of one against the other, and their correlation, through the origin."""
    a, b = _rms(own), _rms(other)
    like = float(np.mean(own * other) / (a * b)) if a * b > 0 else 0.0
    return a / b if b > 0 else 1.0, like


def _unwrapped(states: FloatArray) -> FloatArray:
    return np.column_stack([states[:, :2], np.unwrap(states[:, 2])])


def _usual_rate(times_s: FloatArray, amounts: FloatArray) -> float:
    """95 % of a recording's windows are slower."""
    marks = np.arange(times_s[0], times_s[-1], WINDOW_S)
    marks = np.append(marks, times_s[-1])
    total = np.interp(marks, times_s, np.cumsum(amounts))
    return float(np.percentile(np.diff(total) / np.diff(marks), 95))


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else 0.0


def _is(ratio: float, factor: float) -> bool:
    return abs(float(np.log(ratio / factor))) < ALIKE


def _refused(code: str, message: str, hint: str = "convert the file to seconds, meters and radians") -> InputError:
    return InputError(code, message, hint)
