"""Recordings for the Rerun viewer: landmarks, the trajectory, observations and 95 % ellipsoids."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from importlib.util import find_spec
from typing import Any

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.errors import EXTRA, InputError
from lmkit.geometry.pose import Pose
from lmkit.geometry.rig import AnyRig, T_map_cameras, mounted_cameras
from lmkit.mapping.survey_results import Survey
from lmkit.model.landmark_map import LandmarkMap
from lmkit.model.recording import RigFrame
from lmkit.model.tracked_trajectory import TrackedTrajectory

TIMELINE = "recording"
THICK_M = 0.005
SIGMAS_95 = 2.796  # radius of the 95 % ellipsoid, in standard deviations
SEEN, SURE, UNSURE, UNCERTAIN = (237, 28, 36), (226, 120, 20), (140, 144, 150), (47, 111, 222, 60)


def require_rerun() -> None:
    """Refuse early if the viewer's package is missing.

    Raises:
        InputError: it is missing.
    """
    if find_spec("rerun") is None:
        raise InputError("no_rerun", "recordings need the package rerun-sdk", EXTRA.format("viewer"))


def survey_recording(survey: Survey, rig: AnyRig, frames: Sequence[RigFrame]) -> bytes:
    """A surveyed recording, as the bytes of an .rrd file.

    Args:
        frames: as given to the survey.
    """
    bundle, recording = survey.bundle, _Recording("lmkit survey")
    recording.landmarks(survey.landmarks)
    positions_mm = 1000 * np.sqrt(np.einsum("nii->n", bundle.covariances[:, :3, :3]))
    for k, pose in enumerate(bundle.left_poses()):
        recording.at(bundle.times_s[k])
        recording.robot(pose, bundle.covariances[k], True)
        recording.seen(frames[survey.rows[k]], rig, pose)
        recording.value("sigma/position_mm", positions_mm[k])
    for row in np.unique(bundle.frames):
        recording.at(bundle.times_s[row])
        recording.value("residual", float(np.median(bundle.residuals[bundle.frames == row])))
    return recording.bytes()


def track_recording(
    tracked: TrackedTrajectory, landmarks: LandmarkMap, rig: AnyRig | None, frames: Sequence[RigFrame]
) -> bytes:
    """A robot tracked through a map, as the bytes of an .rrd file.

    Args:
        rig, frames: rig and frames of the recording; None and empty for ranges and bearings.
    """
    recording = _Recording("lmkit track")
    recording.landmarks(landmarks)
    seen = {frame.time_s: frame for frame in frames}
    for k, time_s in enumerate(tracked.times_s.tolist()):
        recording.at(time_s)
        C, looking = tracked.covariances[k], tracked.looking(k)
        recording.robot(looking, C, tracked.statuses[k] == "ok")
        if rig is not None and time_s in seen:
            left = tracked.poses[k] if rig.T_base_left is None else tracked.poses[k] @ rig.T_base_left
            recording.seen(seen[time_s], rig, left)
        recording.value("sigma/position_mm", 1000 * np.sqrt(np.trace(C[:3, :3])))
        recording.value("sigma/heading_deg", np.rad2deg(np.sqrt(max(C[5, 5], 0.0))))
        squared, dof = tracked.nis[k]
        if dof:
            recording.value("innovation", squared / dof)
    return recording.bytes()


class _Recording:
    """Rerun's calls in one place."""

    def __init__(self, name: str) -> None:
        require_rerun()
        self._rerun = rerun = import_module("rerun")
        self._to = rerun.RecordingStream(name)
        self._stream = self._to.binary_stream()
        self._trajectory: list[FloatArray] = []
        self._log("map", rerun.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)

    def at(self, time_s: float) -> None:
        """Set the time of the following entries."""
        self._rerun.set_time(TIMELINE, duration=float(time_s), recording=self._to)

    def landmarks(self, landmarks: LandmarkMap) -> None:
        """Each as a flat box with its code and the 95 % ellipsoid of its position."""
        mounted = list(landmarks)
        self._log(
            "map/landmarks",
            self._rerun.Boxes3D(
                centers=[m.T_map_landmark.t for m in mounted],
                half_sizes=[[m.size_m / 2, m.size_m / 2, THICK_M / 2] for m in mounted],
                quaternions=[self._quaternion(m.T_map_landmark) for m in mounted],
                labels=[str(m.code) for m in mounted],
                colors=[SEEN] * len(mounted),
            ),
            static=True,
        )
        self._ellipsoids(
            "map/landmarks/uncertainty",
            [(m.T_map_landmark.t, m.covariance[:3, :3]) for m in mounted if m.covariance is not None],
            static=True,
        )

    def robot(self, looking: Pose, covariance: FloatArray, sure: bool) -> None:
        """Position and direction (along the camera's z), and the ellipsoid."""
        color = SURE if sure else UNSURE
        self._trajectory.append(looking.t)
        self._log(
            "map/robot", self._rerun.Arrows3D(origins=[looking.t], vectors=[0.4 * looking.R[:, 2]], colors=[color])
        )
        self._ellipsoids("map/robot/uncertainty", [(looking.t, covariance[:3, :3])], static=False)

    def seen(self, frame: RigFrame, rig: AnyRig, T_map_left: Pose) -> None:
        """The cameras, and the outlines of the detections in their images."""
        poses = T_map_cameras(rig, T_map_left)
        for mounted, pose, seen in zip(mounted_cameras(rig), poses, frame.seen, strict=True):
            path, camera = f"map/cameras/{mounted.name}", mounted.model
            self._log(path, self._rerun.Transform3D(translation=pose.t, mat3x3=pose.R))
            self._log(
                path,
                self._rerun.Pinhole(
                    image_from_camera=camera.K, resolution=camera.image_size, image_plane_distance=0.3
                ),
            )
            outlines = [np.vstack([o.corners, o.corners[:1]]) for o in seen]
            labels = [str(o.code) for o in seen]
            self._log(f"{path}/read", self._rerun.LineStrips2D(outlines, labels=labels, colors=[SEEN] * len(seen)))

    def value(self, name: str, value: float) -> None:
        """One value of a curve."""
        self._log(name, self._rerun.Scalars(float(value)))

    def bytes(self) -> bytes:
        """Bytes of the file; the whole path is drawn last."""
        self._log(
            "map/trajectory", self._rerun.LineStrips3D([np.array(self._trajectory)], colors=[SURE]), static=True
        )
        return bytes(self._stream.read() or b"")

    def _ellipsoids(self, path: str, ones: Sequence[tuple[FloatArray, FloatArray]], static: bool) -> None:
        if not ones:
            return
        values, axes = zip(*(np.linalg.eigh((C + C.T) / 2) for _, C in ones), strict=True)
        turned = [V * np.sign(np.linalg.det(V)) for V in axes]
        self._log(
            path,
            self._rerun.Ellipsoids3D(
                centers=[center for center, _ in ones],
                half_sizes=[SIGMAS_95 * np.sqrt(np.maximum(v, 1e-10)) for v in values],
                quaternions=[self._quaternion(Pose("map", "axes", V, np.zeros(3))) for V in turned],
                colors=[UNCERTAIN] * len(ones),
            ),
            static=static,
        )

    def _quaternion(self, pose: Pose) -> Any:
        return self._rerun.Quaternion(xyzw=pose.quaternion_xyzw)

    def _log(self, path: str, what: Any, static: bool = False) -> None:
        self._rerun.log(path, what, static=static, recording=self._to)
