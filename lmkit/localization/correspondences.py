"""Correspondences of mapped landmarks in the cameras of a rig, evaluated for many poses at once."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lmkit.arrays import BoolArray, FloatArray, IntArray, covariance_root, stacked
from lmkit.geometry.camera import CameraModel
from lmkit.geometry.pose import Pose
from lmkit.geometry.pose_array import PoseArray
from lmkit.geometry.rig import AnyRig, cameras_carried
from lmkit.kernels.pose_search import CONVERGED, MOST_DAMPING, Search, pose_covariance, search_poses
from lmkit.kernels.pose_update import Update, Updated, update_planar, update_space
from lmkit.kernels.reprojection import (
    NO_PRIOR,
    Corners,
    corner_chi2,
    pose_equations,
    refine_poses,
)
from lmkit.localization.pose_prior import PosePrior
from lmkit.localization.reprojection import sides_px, through_lenses
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import LandmarkMap, MappedLandmark
from lmkit.model.observation import Detection

# Standard deviation added to every corner's own, for errors of lens, calibration and paper that is not flat.
CORNER_FLOOR_PX = 0.06
# T_camera_left of the left camera itself.
NO_TURN, NO_SHIFT = np.eye(3), np.zeros(3)
TINY = 1e-12  # px^2


@dataclass(frozen=True, eq=False)
class RigCamera:
    """One camera of a rig, and the range of its observations among all."""

    camera: CameraModel
    R: FloatArray  # from the left camera into this camera
    t: FloatArray
    rows: slice


class Correspondences:
    """All observations of mapped landmarks, camera by camera.

    Attributes:
        landmarks: (S) of every observation.
        observations: (S) the detections.
        ids: the landmarks seen.
        of: (S,) index into ``ids`` of every observation.
        rays: (S,4,2) the corners as x/z and y/z, without distortion.
        corners: the same, for the kernels.
        camera_R, camera_t: (S,3,3), (S,3) from the left camera into the camera that saw it.
        cameras: the cameras.
        twice: mapped landmarks that are in one image more than once: which one is the mapped one is unknown.
    """

    def __init__(
        self,
        cameras: Sequence[tuple[Sequence[Detection], CameraModel, FloatArray, FloatArray]],
        landmarks: LandmarkMap,
        corner_floor_px: float,
    ) -> None:
        self.twice: set[LandmarkId] = set()
        self._floor_px = corner_floor_px
        listed: list[tuple[Detection, MappedLandmark]] = []
        counts = []
        for observations, *_ in cameras:
            before = len(listed)
            listed += self._mapped(observations, landmarks)
            counts.append(len(listed) - before)
        looked = through_lenses(
            [o for o, _ in listed], [camera for _, camera, *_ in cameras], counts, corner_floor_px
        )
        if len(looked.kept) < len(listed):
            listed = [listed[k] for k in looked.kept]
            counts = np.bincount(
                np.repeat(np.arange(len(counts)), counts)[looked.kept], minlength=len(counts)
            ).tolist()
        self.observations = [o for o, _ in listed]
        self.landmarks = [landmark for _, landmark in listed]
        self.cameras: list[RigCamera] = []
        end = 0
        for (_, camera, R, t), count in zip(cameras, counts, strict=True):
            self.cameras.append(RigCamera(camera, R, t, slice(end, end + count)))
            end += count
        self.ids: tuple[LandmarkId, ...] = tuple(sorted({landmark.id for landmark in self.landmarks}))
        if not listed:
            return
        number = {id_: k for k, id_ in enumerate(self.ids)}
        self.of = np.array([number[landmark.id] for landmark in self.landmarks])
        self.points = stacked([landmark.corners_map for landmark in self.landmarks], (4, 3))
        self.observed, self.rays, self._stated_px2 = looked.corners, looked.rays, looked.variances
        self.camera_R, self.camera_t = np.empty((len(listed), 3, 3)), np.empty((len(listed), 3))
        for one in self.cameras:
            self.camera_R[one.rows], self.camera_t[one.rows] = one.R, one.t
        uncertain = any(landmark.covariance is not None for landmark in self.landmarks)
        errors = self._landmark_errors() if uncertain else (None, None, None)
        self.corners = Corners(
            self.points, self.rays, looked.by_ray, looked.whitener, self.camera_R, self.camera_t, *errors
        )

    def _mapped(
        self, observations: Sequence[Detection], landmarks: LandmarkMap
    ) -> list[tuple[Detection, MappedLandmark]]:
        """Observations of mapped landmarks; ids that are in the image more than once go into ``twice``."""
        found = [(o, m) for o in observations if (m := landmarks.find(o.id)) is not None]
        if len({o.id for o, _ in found}) < len(found):
            seen = Counter(o.id for o, _ in found)
            self.twice |= {id_ for id_, count in seen.items() if count > 1}
            found = [(o, m) for o, m in found if seen[o.id] == 1]
        return found

    def _landmark_errors(self) -> tuple[FloatArray, FloatArray, IntArray]:
        """Arms, roots and groups as of `Corners`: observations of one landmark share the error of its place."""
        zero = np.zeros((6, 6))
        roots = [zero if m.covariance is None else covariance_root(m.covariance) for m in self.landmarks]
        arms = self.points - np.array([m.T_map_landmark.t for m in self.landmarks])[:, None]
        numbers: dict[int, int] = {}
        group = [-1 if m.covariance is None else numbers.setdefault(id(m), len(numbers)) for m in self.landmarks]
        return arms, np.array(roots), np.array(group)

    @classmethod
    def of_rig(
        cls,
        seen: Sequence[Sequence[Detection]],
        rig: AnyRig,
        landmarks: LandmarkMap,
        corner_floor_px: float,
        carried: Sequence[Pose] = (),
    ) -> Correspondences:
        """Correspondences of all cameras of a rig, with the detections of each; `carried` as of `RigFrame`."""
        cameras = [
            (detections, camera.model, camera.T_camera_left.R, camera.T_camera_left.t)
            for detections, camera in zip(seen, cameras_carried(rig, carried), strict=True)
        ]
        return cls(cameras, landmarks, corner_floor_px)

    def __len__(self) -> int:
        return len(self.landmarks)

    @property
    def side_px(self) -> FloatArray:
        """(S,) mean side in the image; needed for a search, not for an update."""
        return sides_px(self.observed)

    def ids_of(self, rows: BoolArray) -> set[LandmarkId]:
        """The landmarks of some observations, given as a mask (S,)."""
        return {self.ids[k] for k in self.of[rows].tolist()}

    def chi2(self, poses: PoseArray) -> FloatArray:
        """(H,S) squared error of each observation on its own, in standard deviations, over its eight coordinates."""
        return corner_chi2(self.corners, poses.R, poses.t)[0]

    def chi2_and_pixels(self, poses: PoseArray) -> tuple[FloatArray, FloatArray]:
        """The chi2 (H,S), and root mean squares (H,S) of pixel coordinates; huge behind the camera."""
        chi2, pixels = corner_chi2(self.corners, poses.R, poses.t)
        return chi2, np.sqrt(pixels / 8)

    def search(self, search: Search, prior: PosePrior | None) -> tuple[PoseArray, FloatArray, FloatArray]:
        """Different poses, the likeliest first, the chi2 (K,S) of all observations, and costs (K,)."""
        R, t, chi2, cost = search_poses(self.corners, self.of, self.side_px, _numbers(prior), search)
        return PoseArray("map", "left", R, t), chi2, cost

    def covariance(self, poses: PoseArray, used: BoolArray, prior: PosePrior | None) -> FloatArray:
        """(6,6) covariance of the first pose, from the observations used (S,)."""
        return pose_covariance(self.corners, _numbers(prior), poses.R[0], poses.t[0], used)

    def update_space(self, before: FloatArray, R: FloatArray, p: FloatArray, update: Update) -> Updated:
        """Update of a predicted pose with covariance ``before`` (6,6) (`pose_update.update_space`)."""
        return update_space(self.corners, self.of, before, R, p, update)

    def update_planar(
        self, before: FloatArray, lean: FloatArray, base: tuple[FloatArray, FloatArray], x: FloatArray, update: Update
    ) -> Updated:
        """Update of a predicted state on a floor, with T_base_left (`pose_update.update_planar`)."""
        return update_planar(self.corners, self.of, before, lean, *base, x, update)

    @property
    def views(self) -> list[tuple[LandmarkId, int]]:
        """(S) landmark and number of the camera of every observation."""
        ids = [landmark.id for landmark in self.landmarks]
        return [(id_, number) for number, camera in enumerate(self.cameras) for id_ in ids[camera.rows]]

    @property
    def lens_shares(self) -> FloatArray:
        """(S,) share of the corners' variance due to the floor (lens, calibration, paper)."""
        floor = self._floor_px**2
        return floor / (self._stated_px2 + floor + TINY)

    def equations(
        self, poses: PoseArray, used: BoolArray, prior: PosePrior | None
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Normal matrices (H,6,6), gradients (H,6) and chi2 (H,) of the observations used (H,S)."""
        return pose_equations(self.corners, _numbers(prior), poses.R, poses.t, used)

    def refine(self, poses: PoseArray, used: BoolArray, prior: PosePrior | None, iterations: int) -> PoseArray:
        """Levenberg-Marquardt on the whitened corners of the observations used (H,S), every pose on its own."""
        R, t = poses.R, poses.t
        R, t = refine_poses(self.corners, _numbers(prior), R, t, used, iterations, CONVERGED, MOST_DAMPING)
        return PoseArray(poses.to_frame, poses.from_frame, R, t)


def _numbers(prior: PosePrior | None) -> tuple[float, ...]:
    return NO_PRIOR if prior is None else prior.numbers
