"""Landmarks of a map seen by the eyes of a rig: what many poses at once say of all their corners."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lmkit.arrays import BoolArray, FloatArray, IntArray, covariance_root
from lmkit.geometry.camera import CameraModel
from lmkit.geometry.rotations import turns
from lmkit.geometry.stereo_rig import StereoRig
from lmkit.localization.pose_prior import PosePrior
from lmkit.localization.reprojection import View, through_lens
from lmkit.model.landmark_map import LandmarkMap, MappedLandmark
from lmkit.model.observation import Detection

# Standard deviation added to every corner's own: what lenses, calibration and paper that is not flat leave open.
CORNER_FLOOR_PX = 0.06
CONVERGED = 1e-2  # of the squared misfit: a last step of a tenth of a standard deviation
MOST_DAMPING = 1e6


@dataclass(frozen=True, eq=False)
class Eye:
    """One camera of a rig, and where its sightings stand among all."""

    camera: CameraModel
    R: FloatArray  # from the left camera into this eye
    t: FloatArray
    rows: slice


@dataclass(frozen=True, eq=False)
class Poses:
    """(H,3,3) and (H,3) of T_map_camera of the left camera."""

    R: FloatArray
    p: FloatArray

    def __len__(self) -> int:
        return len(self.p)

    def only(self, rows: IntArray) -> Poses:
        """Some of them."""
        return Poses(self.R[rows], self.p[rows])


@dataclass(frozen=True, eq=False)
class _Errors:
    """Of H poses: whitened residuals (H,S,8) and their derivatives with the pose (H,S,8,6) and the landmark's."""

    residuals: FloatArray
    by_pose: FloatArray
    by_landmark: FloatArray | None


class Correspondences:
    """All sightings of mapped landmarks, eye by eye.

    Attributes:
        landmarks: (S) of every sighting.
        observations: (S) what was seen.
        codes: (S,) their codes.
        side_px: (S,) mean side in the picture.
        rays: (S,4,2) the corners as x/z and y/z, without distortion.
        eye_R, eye_t: (S,3,3), (S,3) from the left camera into the eye that saw it.
        eyes: the cameras.
        twice: mapped codes that are in one picture more than once: which is the mapped one cannot be told.
    """

    def __init__(
        self,
        eyes: Sequence[tuple[Sequence[Detection], CameraModel, FloatArray, FloatArray]],
        landmarks: LandmarkMap,
        corner_floor_px: float,
    ) -> None:
        self.landmarks: list[MappedLandmark] = []
        self.observations: list[Detection] = []
        self.eyes: list[Eye] = []
        self.twice: set[int] = set()
        parts = []
        for observations, camera, R, t in eyes:
            seen = Counter((o.family, o.code) for o in observations)
            start = len(self.landmarks)
            listed: list[tuple[Detection, MappedLandmark]] = []
            for o in observations:
                landmark = landmarks.find(o.code, o.family)
                if landmark is not None and seen[o.family, o.code] > 1:
                    self.twice.add(o.code)
                elif landmark is not None:
                    listed.append((o, landmark))
            looked = through_lens([o for o, _ in listed], camera, corner_floor_px)
            for k in looked.kept:
                self.observations.append(listed[k][0])
                self.landmarks.append(listed[k][1])
            turned, moved = np.repeat(R[None], len(looked.kept), axis=0), np.tile(t, (len(looked.kept), 1))
            parts.append((looked.rays, looked.by_ray, looked.whitener, turned, moved))
            self.eyes.append(Eye(camera, R, t, slice(start, len(self.landmarks))))
        if not self.landmarks:
            return
        self.codes = np.array([landmark.code for landmark in self.landmarks])
        self.points = np.array([landmark.corners_map for landmark in self.landmarks])
        self.observed = np.array([o.corners for o in self.observations])
        steps = np.roll(self.observed, -1, axis=1) - self.observed
        self.side_px = np.sqrt((steps**2).sum(axis=2)).mean(axis=1)
        self.rays, self._by_ray, self._whitener, self.eye_R, self.eye_t = (
            np.concatenate(column) for column in zip(*parts, strict=True)
        )
        # Correspondences of one landmark share what is not known of its place.
        self._uncertain: list[IntArray] = []
        self._roots: FloatArray | None = None
        if any(landmark.covariance is not None for landmark in self.landmarks):
            zero = np.zeros((6, 6))
            self._roots = np.array(
                [zero if m.covariance is None else covariance_root(m.covariance) for m in self.landmarks]
            )
            groups: dict[int, list[int]] = {}
            for row, landmark in enumerate(self.landmarks):
                if landmark.covariance is not None:
                    groups.setdefault(id(landmark), []).append(row)
            self._uncertain = [np.array(rows) for rows in groups.values()]
            self._arms = self.points - np.array([m.T_map_landmark.t for m in self.landmarks])[:, None]

    @classmethod
    def of_rig(
        cls,
        left: Sequence[Detection],
        right: Sequence[Detection],
        rig: StereoRig,
        landmarks: LandmarkMap,
        corner_floor_px: float,
    ) -> Correspondences:
        """What both eyes of a rig saw."""
        eyes = [
            (left, rig.left, np.eye(3), np.zeros(3)),
            (right, rig.right, rig.T_right_left.R, rig.T_right_left.t),
        ]
        return cls(eyes, landmarks, corner_floor_px)

    def __len__(self) -> int:
        return len(self.landmarks)

    def pixel_errors(self, poses: Poses) -> FloatArray:
        """(H,S,8) observed minus projected corners; huge where a corner lies behind the camera."""
        errors = self._view(poses).errors(self.rays).reshape(len(poses), -1, 4, 2, 1)
        return np.asarray((self._by_ray @ errors).reshape(len(poses), -1, 8))

    def misfits(self, poses: Poses) -> FloatArray:
        """(H,S) squared error of each sighting on its own, in standard deviations, over its eight coordinates."""
        errors = self._errors(poses, self._roots is not None)
        squared = (errors.residuals**2).sum(axis=2)
        if errors.by_landmark is not None:
            # Woodbury: (1 + K K')^-1 = 1 - K (1 + K'K)^-1 K', with K K' what the landmark's error does.
            K = errors.by_landmark
            pull = np.einsum("hsik,hsi->hsk", K, errors.residuals)
            inner = np.eye(6) + K.transpose(0, 1, 3, 2) @ K
            squared = squared - (pull * np.linalg.solve(inner, pull[..., None])[..., 0]).sum(axis=2)
        return np.asarray(squared)

    def equations(
        self, poses: Poses, used: BoolArray, prior: PosePrior | None
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Normal matrices (H,6,6), gradients (H,6) and squared misfits (H,) of the sightings used (H,S)."""
        errors = self._errors(poses, True)
        count = len(poses)
        r = errors.residuals * used[:, :, None]
        J = errors.by_pose * used[:, :, None, None]
        flat, rows = J.reshape(count, -1, 6), r.reshape(count, -1)
        back = flat.transpose(0, 2, 1)
        normal, gradient = back @ flat, (back @ rows[:, :, None])[:, :, 0]
        squared = (rows**2).sum(axis=1)
        for group in self._uncertain:
            assert errors.by_landmark is not None
            K = (errors.by_landmark[:, group] * used[:, group, None, None]).reshape(count, -1, 6)
            own, rest = J[:, group].reshape(count, -1, 6), r[:, group].reshape(count, -1, 1)
            across, pull = K.transpose(0, 2, 1) @ own, K.transpose(0, 2, 1) @ rest
            share = np.linalg.solve(np.eye(6) + K.transpose(0, 2, 1) @ K, np.concatenate([across, pull], axis=2))
            normal = normal - across.transpose(0, 2, 1) @ share[:, :, :6]
            gradient = gradient - (across.transpose(0, 2, 1) @ share[:, :, 6:])[:, :, 0]
            squared = squared - (pull * share[:, :, 6:]).sum(axis=(1, 2))
        if prior is not None:
            known, by_pose = prior.residuals(poses.R, poses.p), prior.jacobian(poses.R, poses.p)
            normal = normal + by_pose.transpose(0, 2, 1) @ by_pose
            gradient = gradient + (by_pose.transpose(0, 2, 1) @ known[:, :, None])[:, :, 0]
            squared = squared + (known**2).sum(axis=1)
        return normal, gradient, squared

    def refine(self, poses: Poses, used: BoolArray, prior: PosePrior | None, iterations: int) -> Poses:
        """Levenberg-Marquardt on the whitened corners of the sightings used (H,S), every pose on its own."""
        damping = np.full(len(poses), 1e-6)
        normal, gradient, squared = self.equations(poses, used, prior)
        diagonal = np.arange(6)
        for _ in range(iterations):
            damped = normal.copy()
            damped[:, diagonal, diagonal] *= 1 + damping[:, None]
            damped[:, diagonal, diagonal] += 1e-9
            step = np.linalg.solve(damped, gradient[:, :, None])[:, :, 0]
            trial = Poses(turns(step[:, 3:]) @ poses.R, poses.p + step[:, :3])
            # What the step promises to gain, before it is tried.
            small = (step * gradient).sum(axis=1) < CONVERGED
            if small.all():
                return trial
            there = self.equations(trial, used, prior)
            better = there[2] < squared
            poses = Poses(
                np.where(better[:, None, None], trial.R, poses.R), np.where(better[:, None], trial.p, poses.p)
            )
            normal = np.where(better[:, None, None], there[0], normal)
            gradient = np.where(better[:, None], there[1], gradient)
            squared = np.where(better, there[2], squared)
            damping = np.where(better, np.maximum(damping / 10, 1e-9), damping * 300)
            if (damping > MOST_DAMPING).all():
                break
        return poses

    def _errors(self, poses: Poses, derivatives: bool) -> _Errors:
        view = self._view(poses)
        residuals = (self._whitener @ view.errors(self.rays)[..., None])[..., 0]
        if not derivatives:
            return _Errors(residuals, np.zeros(0), None)
        moved = None if self._roots is None else self._whitener @ view.by_landmark(self._arms) @ self._roots
        return _Errors(residuals, self._whitener @ view.by_rig(), moved)

    def _view(self, poses: Poses) -> View:
        offset = self.points[None] - poses.p[:, None, None]
        return View(offset, self.eye_R @ poses.R.transpose(0, 2, 1)[:, None], self.eye_t)
