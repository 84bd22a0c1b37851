"""A simulated robot with five cameras that share no view: poses of cameras by driving, localization and tracking.

Corners, wheels and gyro are simulated, not images.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.geometry.pose import Pose
from lmkit.geometry.rig import MountedCamera, Rig
from lmkit.geometry.rotations import rotation_angle, rotation_exp
from lmkit.geometry.stereo_rig import ahead_of
from lmkit.io.files import write_file
from lmkit.io.landmark_map import map_to_yaml
from lmkit.io.recording_tables import detections_to_csv, gyro_to_csv, odometry_to_csv
from lmkit.io.rig import rig_to_yaml
from lmkit.io.trajectory import poses_to_tum
from lmkit.localization.absolute_pose import locate_rig
from lmkit.localization.base_pose import with_base
from lmkit.mapping.base_mounting import BaseMounting, find_base_mounting
from lmkit.model.pose_status import PoseStatus
from lmkit.model.tracked_trajectory import TrackedTrajectory
from lmkit.odometry.wheel_odometry import MotionModel
from lmkit.simulation.recording import T_BASE_LEFT, Drive, WheelErrors, make_drive
from lmkit.simulation.scene import make_rig
from lmkit.tracking.batch import track_images
from lmkit.visualization.plan_view import FAINT, Found, Polyline, draw_plan

NAMES = ("front", "left", "rear_left", "rear_right", "right")
CALIBRATION_S, SPINS, TRACK_S = 30.0, 1, 20.0
DRAWN, LOCATED_EVERY = 10, 5
ROOM_M = (8.0, 5.0)


@dataclass(frozen=True)
class CameraError:
    """Error of one camera's pose on the robot.

    Attributes:
        name: of the camera.
        place_mm, turn_deg: position and rotation error.
        sigma_mm, sigma_deg: stated standard deviations, the root of the sum of three variances.
    """

    name: str
    place_mm: float
    turn_deg: float
    sigma_mm: float
    sigma_deg: float


@dataclass(frozen=True)
class RigDemo:
    """Errors of all steps.

    Attributes:
        cameras: errors of the poses found by driving.
        located, frames: number of located single frames of the second recording, and of all.
        locate_mm, locate_deg: root mean square errors of the base in located frames.
        track_mm, track_deg: root mean square errors of the tracked base.
    """

    cameras: tuple[CameraError, ...]
    located: int
    frames: int
    locate_mm: float
    locate_deg: float
    track_mm: float
    track_deg: float

    @property
    def table(self) -> list[str]:
        """The errors as lines of text."""
        lines = ["camera      place mm  (stated)   turn deg  (stated)"]
        lines += [
            f"{c.name:10s} {c.place_mm:9.2f} {c.sigma_mm:9.2f} {c.turn_deg:10.3f} {c.sigma_deg:9.3f}"
            for c in self.cameras
        ]
        return [
            *lines,
            "",
            f"located by single frames, {self.located} of {self.frames:3d}    "
            f"{self.locate_mm:6.2f} mm {self.locate_deg:7.3f} deg",
            f"tracked, cameras and wheels, every frame  {self.track_mm:6.2f} mm {self.track_deg:7.3f} deg",
        ]


def run_rig_demo(folder: Path, seed: int, count: int) -> RigDemo:
    """Calibrate by driving, locate, track, and compare with the truth; everything is written into ``folder``.

    Args:
        count: landmarks on the walls.
    """
    rig = ring_of_cameras(np.random.default_rng([seed, 9]))
    assert rig.T_base_left is not None
    wheels = WheelErrors(track_m=0.3)
    first = make_drive(
        seed, CALIBRATION_S, count=count, rig=rig, eights=True, size_m=ROOM_M, errors=wheels, spins=SPINS
    )
    # Unknown camera poses: only the lenses and the height of the first camera are given.
    lenses = Rig(tuple(MountedCamera(c.name, c.model, Pose.identity("camera", "left")) for c in rig.cameras))
    height_m = float(rig.T_base_left.t[2])
    motion = MotionModel(first.odometry, first.gyro)
    mounted = find_base_mounting(first.frames, lenses, first.landmarks, motion, height_m)
    second = make_drive(
        seed + 1, TRACK_S, rig=rig, landmarks=first.landmarks, size_m=ROOM_M, errors=WheelErrors(slips=1)
    )
    located = _located(second, mounted)
    tracked = track_images(second.frames, mounted.rig, second.landmarks, MotionModel(second.odometry, second.gyro))
    _write(folder, first, second, mounted, tracked)
    at_frames = [_error(pose, second.pose(k)) for k, pose in located]
    all_along = [_error(pose, second.pose(k)) for k, pose in enumerate(tracked.poses)]
    tried = len(range(0, len(second.frames), LOCATED_EVERY))
    return RigDemo(_camera_errors(mounted, rig), len(located), tried, *_rms(at_frames), *_rms(all_along))


def ring_of_cameras(rng: np.random.Generator) -> Rig:
    """Five cameras in a ring, 72 deg apart and each 63 deg wide, tilted a little; the first looks ahead."""
    model, places, cameras = make_rig(focal_px=560.0).left, [], []
    for k, name in enumerate(NAMES):
        yaw = 2 * np.pi * k / len(NAMES) + (rng.uniform(-0.05, 0.05) if k else 0.0)
        turn = rotation_exp(np.array([[0, 0, yaw], rng.normal(0, 0.05, 3)]))
        arm = np.array([0.15 * np.cos(yaw), 0.15 * np.sin(yaw), rng.uniform(0.6, 1.0)]) + rng.normal(0, 0.02, 3)
        places.append(Pose("base", "left", turn[0] @ turn[1] @ T_BASE_LEFT.R, arm))
        T = places[k].inverse() @ places[0]
        own = Pose("camera", "left", T.R, T.t) if k else Pose.identity("camera", "left")
        cameras.append(MountedCamera(name, model, own))
    return Rig(tuple(cameras), places[0])


def _located(drive: Drive, mounted: BaseMounting) -> list[tuple[int, Pose]]:
    """(frame, T_map_base) of single frames that were located by all cameras together, without odometry."""
    poses = []
    for k in range(0, len(drive.frames), LOCATED_EVERY):
        found = with_base(locate_rig(drive.frames[k].seen, mounted.rig, drive.landmarks), mounted.rig)
        if found.status is PoseStatus.OK and found.T_map_base is not None:
            poses.append((k, found.T_map_base))
    return poses


def _camera_errors(mounted: BaseMounting, rig: Rig) -> tuple[CameraError, ...]:
    assert rig.T_base_left is not None
    errors = []
    for found, camera in zip(mounted.cameras, rig.cameras, strict=True):
        true = rig.T_base_left @ camera.T_camera_left.inverse()
        place_m, turn_rad = _error(found.T_base_camera, true)
        variances = np.diag(found.covariance)
        errors.append(
            CameraError(
                found.name,
                1000 * place_m,
                float(np.rad2deg(turn_rad)),
                1000 * float(np.sqrt(variances[:3].sum())),
                float(np.rad2deg(np.sqrt(variances[3:].sum()))),
            )
        )
    return tuple(errors)


def _error(found: Pose, true: Pose) -> tuple[float, float]:
    """Distance (m) and angle (rad)."""
    return float(np.linalg.norm(found.t - true.t)), rotation_angle(found.R.T @ true.R)


def _rms(errors: list[tuple[float, float]]) -> tuple[float, float]:
    """Root mean squares, mm and deg; NaN without values."""
    if not errors:
        return float("nan"), float("nan")
    place, turn = np.sqrt(np.mean(np.square(errors), axis=0))
    return 1000 * float(place), float(np.rad2deg(turn))


def _write(folder: Path, first: Drive, second: Drive, mounted: BaseMounting, tracked: TrackedTrajectory) -> None:
    poses = list(zip(tracked.times_s.tolist(), tracked.poses, strict=True))
    truth = [(float(t), second.pose(k)) for k, t in enumerate(second.times_s)]
    for name, text in (
        ("rig.yaml", rig_to_yaml(mounted.rig)),
        ("map.yaml", map_to_yaml(second.landmarks)),
        ("detections.csv", detections_to_csv(second.frames, NAMES)),
        ("odometry.csv", odometry_to_csv(second.odometry)),
        ("gyro.csv", gyro_to_csv(second.gyro)),
        ("trajectory.tum", poses_to_tum(poses)),
        ("truth.tum", poses_to_tum(truth)),
    ):
        write_file(folder / name, text.encode(), True)
    write_file(folder / "plan.png", _plan(first, second, tracked), True)


def _plan(first: Drive, second: Drive, tracked: TrackedTrajectory) -> bytes:
    """The room, the path of the calibration, and the tracked base with its true places."""
    rows = range(0, len(tracked.poses), max(1, len(tracked.poses) // DRAWN))
    found = [
        Found(f"{tracked.times_s[k]:.0f} s", ahead_of(tracked.poses[k]), tracked.covariances[k][:2, :2]) for k in rows
    ]
    path: FloatArray = first.truth[:, :2]
    line = Polyline(path, FAINT, "path of the calibration")
    return draw_plan(
        second.landmarks,
        found,
        [ahead_of(second.pose(k)) for k in rows],
        ROOM_M,
        "Five cameras: placed by driving, then tracked",
        polylines=[line],
    )
