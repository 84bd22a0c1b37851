"""Compensation of the rig's motion between the exposures of cameras that are not synchronized.

A camera that exposes later than its frame sees from the rig's pose at that time.  There are two methods to get the
pose of the frame.  With odometry, every exposure is a frame of its own (`split_by_exposure`), and odometry, with its
noise, connects them.  Without odometry, the motion is interpolated from the rig's poses (`carry_frames`), without
noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.geometry.pose import Pose
from lmkit.geometry.rig import AnyRig, mounted_cameras, with_time_offsets
from lmkit.geometry.rotations import orthonormal
from lmkit.model.observation import Detection
from lmkit.model.recording import RigFrame
from lmkit.odometry.motion_model import Motion

TOGETHER_S = 2e-4  # motion of the rig in a shorter time is neglected


def exposures(frames: Sequence[RigFrame], rig: AnyRig) -> FloatArray:
    """(N,C) times of exposure of every frame and camera on the first camera's clock, seconds."""
    offsets = np.array([camera.time_offset_s for camera in mounted_cameras(rig)])
    stamps = np.array([frame.stamps_s or (frame.time_s,) * len(offsets) for frame in frames])
    return np.asarray(stamps.reshape(-1, len(offsets)) + offsets)


def are_synchronous(frames: Sequence[RigFrame], rig: AnyRig) -> bool:
    """Whether all cameras expose at the time of their frame."""
    times = np.array([frame.time_s for frame in frames])
    return not (np.abs(exposures(frames, rig) - times[:, None]) >= TOGETHER_S).any()


def motion_to(
    times_s: FloatArray, then_s: FloatArray, rig: AnyRig, motion: Motion, parameters: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(N,3,3), (N,3) motion of the rig's first camera between pairs of times, in its frame at the first time.

    Args:
        times_s, then_s: (N,), in either order.
        parameters: errors of the odometry.
    """
    return to_camera(*motion.between(times_s, then_s, parameters), rig)


def to_camera(R: FloatArray, t: FloatArray, rig: AnyRig) -> tuple[FloatArray, FloatArray]:
    """(N,3,3), (N,3) motion of the rig's first camera for a motion R, t of the base."""
    T = rig.T_base_left
    if T is None:
        return R, t
    return T.R.T @ R @ T.R, (t + R @ T.t - T.t) @ T.R


def carried_from(
    time_s: float, then_s: Sequence[float], rig: AnyRig, motion: Motion, parameters: FloatArray
) -> tuple[Pose, ...]:
    """T_left_left: motion of the rig from one time to each of several others."""
    return carried_by(*motion.between(np.full(len(then_s), time_s), np.array(then_s), parameters), rig)


def carried_by(R: FloatArray, t: FloatArray, rig: AnyRig) -> tuple[Pose, ...]:
    """T_left_left for motions R (N,3,3), t (N,3) of the base."""
    moves = zip(*to_camera(R, t, rig), strict=True)
    return tuple(Pose("left", "left", orthonormal(turn), way) for turn, way in moves)


def carry_frames(frames: Sequence[RigFrame], rig: AnyRig, motion: Motion, parameters: FloatArray) -> list[RigFrame]:
    """The frames, with the motion of the rig until each camera's exposure."""
    times, then = np.array([frame.time_s for frame in frames]), exposures(frames, rig)
    by_camera = [motion_to(times, column, rig, motion, parameters) for column in then.T]
    return [
        replace(frame, carried=tuple(Pose("left", "left", orthonormal(R[k]), t[k]) for R, t in by_camera))
        for k, frame in enumerate(frames)
    ]


def synchronous(rig: AnyRig) -> AnyRig:
    """The rig with zero time offsets, as needed for the frames of `split_by_exposure`."""
    return with_time_offsets(rig, [0.0] * (len(mounted_cameras(rig)) - 1))


def split_by_exposure(frames: Sequence[RigFrame], rig: AnyRig) -> list[RigFrame]:
    """Frames of the cameras that expose together, in the order of time.

    Every frame keeps one at its own time, even if no camera exposes then.
    """
    parts: dict[float, tuple[list[tuple[Detection, ...]], str]] = {}
    cameras = len(mounted_cameras(rig))
    for frame, times in zip(frames, exposures(frames, rig).tolist(), strict=True):
        parts.setdefault(frame.time_s, ([()] * cameras, frame.name))
        for k, (time_s, seen) in enumerate(zip(times, frame.seen, strict=True)):
            at = frame.time_s if abs(time_s - frame.time_s) < TOGETHER_S else time_s
            if seen:
                parts.setdefault(at, ([()] * cameras, frame.name))[0][k] += seen
    return [RigFrame(time_s, tuple(seen), name) for time_s, (seen, name) in sorted(parts.items())]
