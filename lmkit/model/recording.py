"""A recording: measurements of a robot's cameras and sensors over time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lmkit.arrays import BoolArray, FloatArray, IntArray, frozen
from lmkit.geometry.pose import Pose
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.observation import Detection, RangeBearing
from lmkit.model.trajectory import Trajectory

CLOCKS_APART_S = 5.0  # of odometry and cameras, at most
GYRO_GAP_S = 1.0  # rates are not interpolated over longer gaps


@dataclass(frozen=True, eq=False)
class Odometry:
    """Wheel odometry.

    Attributes:
        times_s: (N,) seconds, increasing.
        forward_m: (N,) traveled since the row before; backwards is negative.
        turn_rad: (N,) turned since the row before, positive to the left.
    """

    times_s: FloatArray
    forward_m: FloatArray
    turn_rad: FloatArray

    def __post_init__(self) -> None:
        _freeze(self, "forward_m", "turn_rad")

    @classmethod
    def from_velocities(cls, times_s: FloatArray, forward_mps: FloatArray, turn_radps: FloatArray) -> Odometry:
        """From velocities, each valid until the next row."""
        seconds = np.diff(times_s, prepend=times_s[:1])
        before = [np.concatenate([[0.0], values[:-1]]) for values in (forward_mps, turn_radps)]
        return cls(times_s, before[0] * seconds, before[1] * seconds)

    @classmethod
    def from_wheels(cls, times_s: FloatArray, left_m: FloatArray, right_m: FloatArray, track_m: float) -> Odometry:
        """From the travel of each wheel since the row before; ``track_m`` is the distance between the wheels."""
        return cls(times_s, (left_m + right_m) / 2, (right_m - left_m) / track_m)

    @classmethod
    def from_poses(cls, times_s: FloatArray, x: FloatArray, y: FloatArray, heading: FloatArray) -> Odometry:
        """From dead reckoning: positions (m) and headings (rad); sideways motion is treated as slip and ignored."""
        turn = np.diff(np.unwrap(heading), prepend=heading[:1])
        middle = np.unwrap(heading) - turn / 2
        step = np.diff(np.column_stack([x, y]), axis=0, prepend=[[x[0], y[0]]])
        return cls(times_s, step[:, 0] * np.cos(middle) + step[:, 1] * np.sin(middle), turn)


@dataclass(frozen=True, eq=False)
class Gyro:
    """Rate of turn about the vertical.

    Attributes:
        times_s: (N,) seconds, increasing.
        rate_radps: (N,) positive to the left.
    """

    times_s: FloatArray
    rate_radps: FloatArray

    def __post_init__(self) -> None:
        _freeze(self, "rate_radps")

    def turned(self, times_s: FloatArray) -> FloatArray:
        """(M,) rad turned up to each time, from the first row on; rates between rows are linear."""
        steps = np.diff(self.times_s) * (self.rate_radps[1:] + self.rate_radps[:-1]) / 2
        total = np.concatenate([[0.0], np.cumsum(steps)])
        return np.asarray(np.interp(times_s, self.times_s, total))

    def gaps(self) -> list[tuple[float, float]]:
        """Times between which no rates came for longer than `GYRO_GAP_S`."""
        late = np.flatnonzero(np.diff(self.times_s) > GYRO_GAP_S)
        return list(zip(self.times_s[late].tolist(), self.times_s[late + 1].tolist(), strict=True))

    def covers(self, times_s: FloatArray) -> BoolArray:
        """(M,) whether rates cover the time from the previous time to each; False for the first, and over a gap."""
        before, after = times_s[:-1], times_s[1:]
        inside = (before >= self.times_s[0]) & (after <= self.times_s[-1])
        for start, end in self.gaps():
            inside &= (after <= start) | (before >= end)
        return np.append(False, inside)


def _freeze(record: Odometry | Gyro, *names: str) -> None:
    count = len(record.times_s)
    if count > 1 and not (np.diff(record.times_s) > 0).all():
        raise ValueError("times_s do not increase")
    for name in ("times_s", *names):
        object.__setattr__(record, name, frozen(getattr(record, name), (count,), name))


@dataclass(frozen=True, eq=False)
class RigFrame:
    """Detections of all cameras of a rig in one frame.

    Attributes:
        time_s: seconds.
        seen: landmarks read in the image of every camera, in the order of the rig's cameras.
        name: of the frame, as of its first image.
        stamps_s: of every camera's image, by that camera's clock; empty: all ``time_s``.
        carried: T_left_left of every camera, from the rig at its exposure to the rig at ``time_s``; empty: no motion
            in between (`mapping/carried_cameras.py`).
    """

    time_s: float
    seen: tuple[tuple[Detection, ...], ...]
    name: str = ""
    stamps_s: tuple[float, ...] = ()
    carried: tuple[Pose, ...] = ()

    @property
    def detections(self) -> tuple[Detection, ...]:
        """The detections of all cameras."""
        return tuple(detection for camera in self.seen for detection in camera)


@dataclass(frozen=True, eq=False)
class Recording:
    """Everything that `survey` and `track` take: observations of landmarks, and odometry.

    Attributes:
        frames: detections of all cameras, in the order of time.
        readings: (time, readings) of a range and bearing sensor, in the order of time; in place of frames.
        odometry: wheel odometry, or poses of visual odometry; None without odometry.
        gyro: yaw rate; only with wheel odometry.

    Raises:
        TypeError: frames that are no RigFrames, or odometry or gyro of another type.
        ValueError: both frames and readings, times that decrease, or a gyro without wheel odometry.

    Examples:
        >>> import lmkit
        >>> lmkit.read_recording(detections="detections.csv", odometry="odometry.csv", gyro="gyro.csv")
        Recording(... frames, ... s, wheel odometry, gyro)
    """

    frames: tuple[RigFrame, ...] = ()
    readings: tuple[tuple[float, tuple[RangeBearing, ...]], ...] = ()
    odometry: Odometry | Trajectory | None = None
    gyro: Gyro | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.frames, list | tuple) or not all(isinstance(f, RigFrame) for f in self.frames[:1]):
            raise TypeError("frames of a recording must be a tuple of RigFrames; see lmkit.read_recording")
        for name, kinds in (("odometry", (Odometry, Trajectory)), ("gyro", (Gyro,))):
            if (value := getattr(self, name)) is not None and not isinstance(value, kinds):
                known = " or ".join(kind.__name__ for kind in kinds)
                raise TypeError(f"{name} of a recording must be {known}, not {type(value).__name__}")
        times = self.times_s
        if (late := np.flatnonzero(np.diff(times) < 0)).size:
            before, after = times[late[0] : late[0] + 2].tolist()
            raise ValueError(
                f"a recording is in the order of time, and {after:g} s follows {before:g} s: sort by time_s, if the "
                "stamps are right"
            )
        if self.frames and self.readings:
            raise ValueError("a recording has frames or readings, not both")
        if self.gyro is not None and not isinstance(self.odometry, Odometry):
            raise ValueError("a gyro needs wheel odometry")

    @property
    def times_s(self) -> FloatArray:
        """(N,) times of the frames or readings, seconds."""
        times = [frame.time_s for frame in self.frames] or [time_s for time_s, _ in self.readings]
        return np.array(times, dtype=np.float64)

    @property
    def ids(self) -> set[LandmarkId]:
        """Landmarks seen."""
        detected = {o.id for frame in self.frames for o in frame.detections}
        return detected | {reading.id for _, seen in self.readings for reading in seen}

    def around(self, frames: tuple[RigFrame, ...]) -> Recording:
        """Some frames in the order of time, with the rows of odometry and gyro from `CLOCKS_APART_S` before to after.

        Fewer than two rows do not determine a motion; they are left out.
        """
        first, last = frames[0].time_s - CLOCKS_APART_S, frames[-1].time_s + CLOCKS_APART_S
        odometry, gyro = self.odometry, self.gyro
        if odometry is not None:
            rows = _rows_around(odometry.times_s, first, last)
            odometry = _chosen(odometry, rows) if len(rows) > 1 else None
        if gyro is not None:
            rows = _rows_around(gyro.times_s, first, last)
            gyro = Gyro(gyro.times_s[rows], gyro.rate_radps[rows]) if odometry is not None and len(rows) > 1 else None
        return Recording(frames, (), odometry, gyro)

    def __repr__(self) -> str:
        times = self.times_s
        what = "readings" if self.readings else "frames"
        parts = [f"{len(times)} {what}", f"{np.ptp(times):.1f} s" if len(times) else "empty"]
        if self.odometry is not None:
            parts.append("wheel odometry" if isinstance(self.odometry, Odometry) else "visual odometry")
        if self.gyro is not None:
            parts.append("gyro")
        return f"Recording({', '.join(parts)})"


def _rows_around(times_s: FloatArray, first_s: float, last_s: float) -> IntArray:
    """Rows from the last one not after ``first_s`` to the first one not before ``last_s``."""
    start = max(int(np.searchsorted(times_s, first_s, side="right")) - 1, 0)
    return np.arange(start, min(int(np.searchsorted(times_s, last_s)) + 1, len(times_s)))


def _chosen(odometry: Odometry | Trajectory, rows: IntArray) -> Odometry | Trajectory:
    if isinstance(odometry, Trajectory):
        return odometry.rows(rows)
    return Odometry(odometry.times_s[rows], odometry.forward_m[rows], odometry.turn_rad[rows])
