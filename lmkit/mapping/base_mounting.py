"""Poses of a robot's cameras on its base, and their clocks, from a recording with wheel odometry in a mapped room.

The unknowns are the robot's path on the floor, the errors of its odometry, the pose of the floor in the map, the pose
and the clock of every camera, and the landmarks within the map's covariance.  One least-squares problem has all
corners and all motions (`mounting_problem.py`).  The base is the point without sideways motion: its x axis is the
direction in which the robot drives, its origin the point that turns without moving.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.geometry.pose import Pose
from lmkit.geometry.rig import AnyRig, MountedCamera, Rig, mounted_cameras
from lmkit.geometry.rotations import orthonormal
from lmkit.geometry.stereo_rig import StereoRig
from lmkit.mapping.base_mounting_start import find_mounting_start
from lmkit.mapping.carried_cameras import are_synchronous, exposures, split_by_exposure, synchronous
from lmkit.mapping.mounting_problem import Group, MountingProblem
from lmkit.model.landmark_map import LandmarkMap
from lmkit.model.recording import RigFrame
from lmkit.odometry.wheel_odometry import PARAMETERS, MotionModel

KNOWN_M, KNOWN_RAD = 0.01, np.deg2rad(1.0)  # a position with a larger standard deviation is named
CLOCK_SIGMA = 3.0  # standard deviations by which a clock must differ from the rig file to be another


@dataclass(frozen=True, eq=False)
class CameraClock:
    """Clock offset of a camera, estimated from a recording.

    Attributes:
        offset_s, sigma_s: seconds to add to its stamps for the first camera's clock, and standard deviation.
        differs: the rig file has another offset, by more than chance.
    """

    offset_s: float
    sigma_s: float
    differs: bool


@dataclass(frozen=True, eq=False)
class CameraOnBase:
    """Pose of one camera on the robot.

    Attributes:
        name: of the camera.
        T_base_camera: its pose.
        covariance: (6,6) of x y z (m) and the rotation about the base's axes (rad).
        frames: number of frames in which it saw landmarks of the map.
        unobserved: what the recording does not determine, in words.
        clock: relative to the first camera's; None for the first camera.
    """

    name: str
    T_base_camera: Pose
    covariance: FloatArray
    frames: int
    unobserved: tuple[str, ...]
    clock: CameraClock | None = None


@dataclass(frozen=True, eq=False)
class BaseMounting:
    """The result.

    Attributes:
        rig: with its cameras' poses on the base, and their clock offsets where these differ from the rig file.
        cameras: every camera; for a stereo pair only the left one.
        floor: tilts about the map's x and y (rad), and height of the base's origin (m).
        parameters: errors of the odometry, as `lmkit.odometry.wheel_odometry.PARAMETERS`.
        rms_px: of the corners of inliers.
        outliers: number of observations that do not fit.
        states: (N,3) x, y (m), heading (rad) of the base on the floor, in the order of time.
    """

    rig: AnyRig
    cameras: tuple[CameraOnBase, ...]
    floor: FloatArray
    parameters: FloatArray
    rms_px: float
    outliers: int
    states: FloatArray

    def to_dict(self) -> dict[str, Any]:
        """JSON of ``lmkit calibrate --base`` (docs/formats.md)."""
        return {
            "cameras": [
                {
                    "name": camera.name,
                    "T_base_camera": {"R": camera.T_base_camera.R.tolist(), "t": camera.T_base_camera.t.tolist()},
                    "covariance": camera.covariance.tolist(),
                    "frames": camera.frames,
                    "unobserved": list(camera.unobserved),
                    "clock": None if camera.clock is None else asdict(camera.clock),
                }
                for camera in self.cameras
            ],
            "floor": {"tilt_rad": self.floor[:2].tolist(), "height_m": float(self.floor[2])},
            "odometry": dict(zip(PARAMETERS, self.parameters.tolist(), strict=True)),
            "rms_px": self.rms_px,
            "outliers": self.outliers,
        }

    def __repr__(self) -> str:
        places = [(camera.name, *camera.T_base_camera.t) for camera in self.cameras]
        cameras = ", ".join(f"{name} at x {x:z.3f} y {y:z.3f} z {z:z.3f} m" for name, x, y, z in places)
        return f"BaseMounting({cameras}, {self.rms_px:.2f} px, {self.outliers} outliers)"


def find_base_mounting(
    frames: Sequence[RigFrame],
    rig: AnyRig,
    landmarks: LandmarkMap,
    motion: MotionModel,
    height_m: float | None = None,
) -> BaseMounting:
    """Estimate the pose of every camera on the robot, together with its clock offset.

    Clock offsets that agree with the rig file keep its values, and the poses are solved again.

    Args:
        frames: of the recording; detections of every camera.
        rig: cameras, with intrinsics and time offsets.  A stereo pair keeps its baseline and its offset; cameras of
            other rigs are found one by one.
        motion: wheel odometry.
        height_m: of the first camera above the base's origin; None: the base is assumed to be at z = 0 of the map,
            and the standard deviations of heights are at least that of the floor.

    Raises:
        InputError: a camera sees too little of the map, or odometry of another time.
    """
    motion.require_overlap(np.array([frame.time_s for frame in frames]))
    groups = _groups(rig)
    clocks: list[CameraClock] = []
    if len(groups) > 1:
        stated = np.array([camera.time_offset_s for camera in mounted_cameras(rig)[1:]])
        problem = _solved_with_clocks(frames, groups, rig, landmarks, motion, height_m)
        clocks = _clocks(problem, stated)
        if any(clock.differs for clock in clocks):
            return _answer(problem, rig, clocks)
    if not are_synchronous(frames, rig):
        frames = split_by_exposure(frames, rig)
    start = find_mounting_start(frames, groups, landmarks, motion)
    one_clock, none = np.zeros(len(frames), dtype=np.int64), np.zeros(0)
    problem = MountingProblem(frames, groups, landmarks, motion, start, one_clock, none, height_m)
    problem.optimize()
    return _answer(problem, rig, clocks)


def _groups(rig: AnyRig) -> list[Group]:
    """Groups of cameras with fixed relative poses: name, rig, and indices of their lists of detections."""
    if isinstance(rig, StereoRig):
        return [("left", replace(rig, T_base_left=None), [0, 1])]
    return [(c.name, Rig.of_one(c.model, name=c.name), [k]) for k, c in enumerate(rig.cameras)]


def _solved_with_clocks(
    frames: Sequence[RigFrame],
    groups: Sequence[Group],
    rig: AnyRig,
    landmarks: LandmarkMap,
    motion: MotionModel,
    height_m: float | None,
) -> MountingProblem:
    """Solution with one pose per exposure; the rig file's offsets are a prior."""
    stamps = exposures(frames, synchronous(rig))
    single, clocks = [], []
    for k in range(len(groups)):
        for frame, stamp in zip(frames, stamps[:, k].tolist(), strict=True):
            if frame.seen[k]:
                seen = tuple(frame.seen[k] if j == k else () for j in range(len(groups)))
                single.append(RigFrame(stamp, seen, frame.name))
                clocks.append(k)
    start = find_mounting_start(single, groups, landmarks, motion, np.array(clocks))
    stated = np.array([camera.time_offset_s for camera in mounted_cameras(rig)[1:]])
    problem = MountingProblem(single, groups, landmarks, motion, start, np.array(clocks), stated, height_m)
    problem.optimize()
    return problem


def _clocks(problem: MountingProblem, stated_s: FloatArray) -> list[CameraClock]:
    rows = np.arange(problem.first_offset, problem.first_landmark)
    sigmas = np.sqrt(np.diag(problem.covariance())[rows])
    found = zip(problem.state.offsets.tolist(), sigmas.tolist(), stated_s.tolist(), strict=True)
    return [CameraClock(offset, s, abs(offset - by_file) > CLOCK_SIGMA * s) for offset, s, by_file in found]


def _answer(problem: MountingProblem, rig: AnyRig, clocks: Sequence[CameraClock]) -> BaseMounting:
    """Camera poses with covariances, and the rig with these poses."""
    shared, s = problem.covariance(), problem.state
    cameras = []
    for k, name in enumerate(problem.names):
        rows = slice(problem.mounts + 6 * k, problem.mounts + 6 * k + 6)
        C = shared[rows, rows]
        T = Pose("base", "left", orthonormal(s.mount_R[k]), s.mount_t[k])
        frames = len(np.unique(problem.seen[k].at[problem.used[k]]))
        unobserved = _unobserved(C, problem.height_m is None)
        cameras.append(CameraOnBase(name, T, C, frames, unobserved, clocks[k - 1] if k and clocks else None))
    used = np.concatenate(problem.used)
    pixels = np.concatenate([pixels for _, pixels in problem.squared_errors()])[used]
    rms = float(np.sqrt(pixels.mean() / 4)) if len(pixels) else float("nan")
    return BaseMounting(
        _mounted(rig, cameras), tuple(cameras), s.floor, s.parameters, rms, int((~used).sum()), s.path
    )


def _unobserved(C: FloatArray, height_is_assumed: bool) -> tuple[str, ...]:
    """Components of a camera's pose that the recording does not determine."""
    sigma = np.sqrt(np.diag(C))
    words = []
    if height_is_assumed:
        words.append(
            "height (a robot on a level floor does not show it; the base is taken to be at z = 0 of the map)"
        )
    if sigma[0] > KNOWN_M:
        words.append("place along x (turn more)")
    if sigma[1] > KNOWN_M:
        words.append(
            "place along y (drive curves to both sides: one direction alone leaves it mixed with odometry's scale)"
        )
    if sigma[5] > KNOWN_RAD:
        words.append("direction (drive farther)")
    if sigma[3] > KNOWN_RAD or sigma[4] > KNOWN_RAD:
        words.append("tilt (turn more)")
    return tuple(words)


def _mounted(rig: AnyRig, cameras: Sequence[CameraOnBase]) -> AnyRig:
    """The rig with the estimated poses."""
    first = cameras[0].T_base_camera
    if isinstance(rig, StereoRig):
        return replace(rig, T_base_left=first)
    back = first.inverse()
    mounted = []
    for k, (camera, found) in enumerate(zip(rig.cameras, cameras, strict=True)):
        T = back @ found.T_base_camera if k else None
        T_camera_left = Pose.identity("camera", "left")
        if T is not None:
            inverse = T.inverse()
            T_camera_left = Pose("camera", "left", inverse.R, inverse.t)
        known = camera.intrinsics_sigma, camera.intrinsics_correlation
        offset = found.clock.offset_s if found.clock and found.clock.differs else camera.time_offset_s
        mounted.append(MountedCamera(camera.name, camera.model, T_camera_left, None, *known, offset))
    return Rig(tuple(mounted), first)
