"""A site as files, for `lmkit fleet`: halls, robots, recordings of several days, with planted faults.

Detections, odometry and gyro are simulated; there are no images.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.evaluation.trajectory_error import umeyama
from lmkit.geometry.pose import Pose
from lmkit.geometry.rotations import rotation_exp
from lmkit.geometry.stereo_rig import StereoRig
from lmkit.io.recording_tables import detections_to_csv, gyro_to_csv, odometry_to_csv
from lmkit.io.rig import rig_to_yaml
from lmkit.model.landmark_map import LandmarkMap, MappedLandmark, day_of
from lmkit.model.recording import Gyro, Odometry, RigFrame
from lmkit.simulation.recording import T_BASE_LEFT, Drive, WheelErrors, make_drive
from lmkit.simulation.scene import make_rig

DAY_S = 86400.0
MONDAY_S = 1_790_000_000.0  # seconds since 1970
SHIFT_M = 0.4


@dataclass(frozen=True)
class Site:
    """The truth of a site.

    Attributes:
        maps: map of every hall before any landmark is moved.
        moved: by hall, the landmark that is moved before the last day, at its new pose.
    """

    maps: dict[str, LandmarkMap]
    moved: dict[str, MappedLandmark]

    def map_error_m(self, hall: str, found: LandmarkMap) -> float:
        """Root mean square position error of a hall's unmoved landmarks, after the best alignment."""
        moved = self.moved.get(hall)
        still = [m for m in found if moved is None or m.id != moved.id]
        both = [(m.T_map_landmark.t, t.T_map_landmark.t) for m in still if (t := self.maps[hall].find(m.id))]
        a, b = (np.array(points) for points in zip(*both, strict=True))
        R, shift, _ = umeyama(a, b, with_scale=False)
        return float(np.sqrt(((a @ R.T + shift - b) ** 2).sum(axis=1).mean()))


@dataclass(frozen=True)
class Planted:
    """Faults of robots: number and first day of each; ``recalibrated`` is the day of a new rig file."""

    bumped: tuple[int, int] = (-1, 0)
    recalibrated: int = 1000
    clock: tuple[int, int] = (-1, 0)
    bump_deg: float = 0.4
    delay_s: float = 0.9


def day_name(day: int) -> str:
    """Date of a day of the simulated site."""
    return day_of(MONDAY_S + DAY_S * day)


def write_site(
    folder: Path,
    halls: int,
    days: int,
    seconds: float = 40.0,
    count: int = 10,
    moved: int | bool = True,
    robots: int = 2,
    hz: float = 5.0,
    planted: Planted = Planted(),
    rig_error_deg: float = 0.0,
    seed: int = 0,
) -> Site:
    """Write ``logs/HALL/ROBOT/DATE/`` with detections.csv, odometry.csv and gyro.csv, and ``rigs/ROBOT/DATE.yaml``.

    Args:
        moved: halls with a landmark that is moved before the last day.
        rig_error_deg: standard deviation of the right camera's rotation error about each axis, in every rig file.
    """
    rng = np.random.default_rng([seed, 0])
    maps, away_by_hall = {}, {}
    straight = replace(make_rig(), T_base_left=T_BASE_LEFT)
    bumped_rig = turned(straight, np.array([0.0, planted.bump_deg, 0.0]))
    for number in range(robots):
        rigs = folder / "rigs" / f"robot{number}"
        rigs.mkdir(parents=True)
        stated = turned(straight, rng.normal(0.0, rig_error_deg, 3))
        (rigs / f"{day_name(0)}.yaml").write_text(rig_to_yaml(stated))
        if number == planted.bumped[0] and planted.recalibrated < days:
            (rigs / f"{day_name(planted.recalibrated)}.yaml").write_text(rig_to_yaml(bumped_rig))
    for hall in range(halls):
        first = make_drive(100_000 * seed + 100 + hall, seconds, hz, count=count)
        name = f"hall{hall}"
        maps[name] = first.landmarks
        other = most_seen(first.frames, first.landmarks)
        T = other.T_map_landmark
        away = replace(other, T_map_landmark=Pose("map", "landmark", T.R, T.t + SHIFT_M * T.R[:, 0]))
        is_moved = hall < (halls if moved is True else int(moved))
        if is_moved:
            away_by_hall[name] = away
        later = LandmarkMap([away if m.id == other.id else m for m in first.landmarks])
        for day in range(days):
            number = (hall + day) % robots
            is_bumped = number == planted.bumped[0] and day >= planted.bumped[1]
            is_off = number == planted.clock[0] and day >= planted.clock[1]
            drive = make_drive(
                100_000 * seed + 1000 * hall + day, seconds, hz, count=count,
                errors=WheelErrors(delay_s=planted.delay_s) if is_off else None,
                rig=bumped_rig if is_bumped else straight,
                landmarks=later if is_moved and day == days - 1 > 0 else first.landmarks,
            )  # fmt: skip
            _write_recording(folder / "logs" / name / f"robot{number}" / day_name(day), drive, MONDAY_S + DAY_S * day)
    return Site(maps, away_by_hall)


def _write_recording(folder: Path, drive: Drive, start_s: float) -> None:
    folder.mkdir(parents=True)
    frames = [RigFrame(f.time_s + start_s, f.seen, f.name) for f in drive.frames]
    (folder / "detections.csv").write_text(detections_to_csv(frames))
    o, g = drive.odometry, drive.gyro
    (folder / "odometry.csv").write_text(odometry_to_csv(Odometry(o.times_s + start_s, o.forward_m, o.turn_rad)))
    (folder / "gyro.csv").write_text(gyro_to_csv(Gyro(g.times_s + start_s, g.rate_radps)))


def turned(rig: StereoRig, turn_deg: FloatArray) -> StereoRig:
    """The rig with its right camera rotated by a rotation vector (3,)."""
    T = rig.T_right_left
    return replace(rig, T_right_left=Pose(T.to_frame, T.from_frame, rotation_exp(np.deg2rad(turn_deg)) @ T.R, T.t))


def most_seen(frames: tuple[RigFrame, ...], landmarks: LandmarkMap) -> MappedLandmark:
    """The landmark with most detections."""
    counts = {m.id: sum(d.id == m.id for f in frames for d in f.detections) for m in landmarks}
    return next(m for m in landmarks if m.id == max(counts, key=lambda id_: counts[id_]))
