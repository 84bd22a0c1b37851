"""Landmarks of a map seen by the eyes of a rig: what many poses at once say of all their corners.

Corners are undistorted once, and what they are off by is carried back into pixels by the lens's own
derivative, so that no pose needs the lens again.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lmkit.arrays import BoolArray, FloatArray, IntArray, covariance_root
from lmkit.locate.prior import PosePrior
from lmkit.locate.turns import turns
from lmkit.model.camera import REACHED_PX, CameraModel
from lmkit.model.landmark_map import LandmarkMap, MappedLandmark
from lmkit.model.observation import LandmarkObservation
from lmkit.model.stereo_rig import StereoRig

# Standard deviation added to every corner's own: what lenses, calibration and paper that is not flat leave open.
CORNER_FLOOR_PX = 0.06
NEAREST_M = 0.02  # corners nearer than that, or behind the camera, are seen nowhere
NOWHERE = 1e2  # as x/z
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
class EyeSightings:
    """What one camera saw, looked through its lens.

    Attributes:
        kept: of the observations, those that the lens model reaches.
        rays: (S,4,2) corners as x/z and y/z, without distortion.
        by_ray: (S,4,2,2) how pixels change with them.
        whitener: (S,8,8) from errors of rays to standard deviations of the corners.
    """

    kept: list[int]
    rays: FloatArray
    by_ray: FloatArray
    whitener: FloatArray


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


class Sightings:
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
        eyes: Sequence[tuple[Sequence[LandmarkObservation], CameraModel, FloatArray, FloatArray]],
        landmarks: LandmarkMap,
        corner_floor_px: float,
    ) -> None:
        self.landmarks: list[MappedLandmark] = []
        self.observations: list[LandmarkObservation] = []
        self.eyes: list[Eye] = []
        self.twice: set[int] = set()
        parts = []
        for observations, camera, R, t in eyes:
            seen = Counter((o.family, o.code) for o in observations)
            start = len(self.landmarks)
            listed: list[tuple[LandmarkObservation, MappedLandmark]] = []
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
        # Sightings of one landmark share what is not known of its place.
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
        left: Sequence[LandmarkObservation],
        right: Sequence[LandmarkObservation],
        rig: StereoRig,
        landmarks: LandmarkMap,
        corner_floor_px: float,
    ) -> Sightings:
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
        errors = self._project(poses, False)[0].reshape(len(poses), -1, 4, 2, 1)
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
        rays, G, offset = self._project(poses, derivatives)
        residuals = (self._whitener @ rays[..., None])[..., 0]
        if G is None:
            return _Errors(residuals, np.zeros(0), None)
        shape = (len(poses), len(self), 8, 6)
        # x_left = R' exp(-turn) (X - p - shift); g' skew(o) = g x o.
        J = np.concatenate([-G, _cross(G, offset[:, :, :, None])], axis=4).reshape(shape)
        by_landmark = None
        if self._roots is not None:
            moved = np.concatenate([G, -_cross(G, self._arms[None, :, :, None])], axis=4).reshape(shape)
            by_landmark = self._whitener @ moved @ self._roots
        return _Errors(residuals, self._whitener @ J, by_landmark)

    def _project(self, poses: Poses, derivatives: bool) -> tuple[FloatArray, FloatArray | None, FloatArray]:
        """Errors of the rays (H,S,8), their derivatives with the map point (H,S,4,2,3), points from the camera."""
        offset = self.points[None] - poses.p[:, None, None]
        turn = self.eye_R @ poses.R.transpose(0, 2, 1)[:, None]
        seen = offset @ turn.transpose(0, 1, 3, 2) + self.eye_t[:, None]
        depth = np.maximum(seen[..., 2:], NEAREST_M)
        rays = seen[..., :2] / depth
        errors = (self.rays - rays).reshape(len(poses), len(self), 8)
        errors[(seen[..., 2] < NEAREST_M).any(axis=2)] = NOWHERE
        if not derivatives:
            return errors, None, offset
        G = (turn[:, :, None, :2] - rays[..., None] * turn[:, :, None, 2:]) / depth[..., None]
        return errors, G, offset


def through_lens(
    observations: Sequence[LandmarkObservation], camera: CameraModel, corner_floor_px: float
) -> EyeSightings:
    """Corners as rays, each with its own covariance and that of the floor."""
    corners = np.array([o.corners for o in observations]).reshape(-1, 2)
    if len(corners) == 0:
        return EyeSightings([], np.zeros((0, 4, 2)), np.zeros((0, 4, 2, 2)), np.zeros((0, 8, 8)))
    rays = np.nan_to_num(camera.unproject(corners), posinf=0.0, neginf=0.0)
    pixels, by_point, _ = camera.project_with_jacobian(np.column_stack([rays, np.ones(len(rays))]))
    reached = (((pixels - corners) ** 2).sum(axis=1) < REACHED_PX**2).reshape(-1, 4).all(axis=1)
    by_ray = by_point[:, :, :2].reshape(-1, 4, 2, 2)[reached]
    covariance = np.array(
        [np.zeros((8, 8)) if o.covariance is None else o.covariance for o in observations], dtype=np.float64
    )[reached]
    whitener = np.linalg.inv(np.linalg.cholesky(covariance + corner_floor_px**2 * np.eye(8)))
    return EyeSightings(
        np.flatnonzero(reached).tolist(),
        rays.reshape(-1, 4, 2)[reached],
        by_ray,
        (whitener.reshape(-1, 8, 4, 1, 2) @ by_ray[:, None]).reshape(-1, 8, 8),
    )


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Like np.cross over the last axis, without its overhead."""
    a0, a1, a2 = a[..., 0], a[..., 1], a[..., 2]
    b0, b1, b2 = b[..., 0], b[..., 1], b[..., 2]
    return np.stack([a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0], axis=-1)
