"""`locate_rig`: the pose of a stereo camera, or of one camera, from all corners of all landmarks in view.

1. Every landmark alone gives two poses per eye (a square seen by one camera has a twin; IPPE,
   Collins and Bartoli 2014).  All of them, carried into the map, are hypotheses.
2. Each hypothesis is fitted to its own landmark in both eyes and scored by how many landmarks it
   explains, so one wrong code cannot capture the start.
3. The best are refined by Gauss-Newton on all corners of the landmarks they explain, weighted by
   the corners' own covariance.
4. The likelihood ratio of the best to the next pose that is really another one decides whether
   the answer is ``ok`` or ``ambiguous``.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np

from lmkit.arrays import FloatArray, covariance_root
from lmkit.model.camera import CameraModel
from lmkit.model.estimate import PoseEstimate
from lmkit.model.landmark import family_named
from lmkit.model.landmark_map import LandmarkMap, MappedLandmark
from lmkit.model.observation import LandmarkObservation
from lmkit.model.pose import Pose, rotation_angle, rotation_exp, skew
from lmkit.model.stereo_rig import StereoRig

PRIOR_STEP = 1e-6


@dataclass(frozen=True)
class PosePrior:
    """What is known of the camera before it has seen anything; None where nothing is.

    Of a robot on a level floor the camera's height and its tilt are known; a gyro or compass tells the heading.

    Attributes:
        heading_rad, heading_sigma: where the camera's optical axis points, seen from above, from the map's x
            towards its y.
        height_m, height_sigma: of the camera.
        down: (3,) the map's -z axis in the camera, as the camera is mounted: (0, 1, 0) when it looks level.
        tilt_sigma: rad, by which the floor and the mounting may lean.
    """

    heading_rad: float | None = None
    heading_sigma: float = np.deg2rad(2.0)
    height_m: float | None = None
    height_sigma: float = 0.005
    down: tuple[float, float, float] | None = None
    tilt_sigma: float = np.deg2rad(0.3)

    def residuals(self, R: FloatArray, p: FloatArray) -> FloatArray:
        """(K,) known minus actual, in standard deviations; R, p of T_map_camera."""
        rows = []
        if self.heading_rad is not None:
            off = self.heading_rad - np.arctan2(R[1, 2], R[0, 2])
            rows.append(np.arctan2(np.sin(off), np.cos(off)) / self.heading_sigma)
        if self.height_m is not None:
            rows.append((self.height_m - p[2]) / self.height_sigma)
        if self.down is not None:
            # The map's down as the pose has it, in the map: its x and y are what it leans.
            leaning = R @ np.array(self.down) / np.linalg.norm(self.down)
            rows += [-leaning[0] / self.tilt_sigma, -leaning[1] / self.tilt_sigma]
            if leaning[2] > 0:
                rows.append(np.pi / self.tilt_sigma)  # upside down
        return np.array(rows)

    def jacobian(self, R: FloatArray, p: FloatArray) -> FloatArray:
        """(K,6) of the actual values with a shift and a turn in the map, in standard deviations; by differences."""
        here = self.residuals(R, p)
        J = np.zeros((len(here), 6))
        for k in range(6):
            step = np.zeros(6)
            step[k] = PRIOR_STEP
            J[:, k] = (here - self.residuals(rotation_exp(step[3:]) @ R, p + step[:3])) / PRIOR_STEP
        return J


@dataclass(frozen=True)
class LocateOptions:
    """The few dials of locating.

    Attributes:
        corner_floor_px: standard deviation added to every corner's own: what calibration and flat
            paper leave open.
        ambiguous_below: log likelihood ratio under which a second pose makes the answer ambiguous.
        far_m: a pose that other ones so far away explain almost as well is ambiguous, too: far and small
            landmarks leave a valley of poses rather than two.
        outlier_sigma: a landmark is explained when the root mean square of its eight corner
            coordinates stays under this many standard deviations.
        gate_share: before refinement, a landmark is explained when its corners lie within this
            share of its side.
        prior: what is known of the pose beforehand.
    """

    corner_floor_px: float = 0.08
    ambiguous_below: float = 5.0
    far_m: float = 0.5
    outlier_sigma: float = 4.5
    gate_share: float = 0.25
    prior: PosePrior | None = None


@dataclass(frozen=True, eq=False)
class _Sighting:
    """One mapped landmark in one eye.

    Attributes:
        R_eye, t_eye: from the left camera into this eye.
        points: (4,3) corners in the map.
        whitener: (8,8) that turns corner residuals into unit variance.
    """

    landmark: MappedLandmark
    observation: LandmarkObservation
    camera: CameraModel
    R_eye: FloatArray
    t_eye: FloatArray
    points: FloatArray
    whitener: FloatArray
    side_px: float

    @property
    def code(self) -> int:
        return self.landmark.code


@dataclass(frozen=True, eq=False)
class _Camera:
    """Pose of the left camera as bare arrays: R, p of T_map_camera."""

    R: FloatArray
    p: FloatArray
    cost: float = field(default=np.inf)


def locate_rig(
    left: Sequence[LandmarkObservation],
    right: Sequence[LandmarkObservation],
    rig: StereoRig,
    landmarks: LandmarkMap,
    options: LocateOptions | None = None,
) -> PoseEstimate:
    """The pose of the rig's left camera in the map.

    Args:
        left, right: detections in the two pictures, corners in pixels as delivered.
    """
    eyes = [
        (left, rig.left, np.eye(3), np.zeros(3)),
        (right, rig.right, rig.T_right_left.R, rig.T_right_left.t),
    ]
    return _locate(eyes, landmarks, options or LocateOptions())


def locate_camera(
    observations: Sequence[LandmarkObservation],
    camera: CameraModel,
    landmarks: LandmarkMap,
    options: LocateOptions | None = None,
) -> PoseEstimate:
    """The pose of a single camera in the map."""
    return _locate([(observations, camera, np.eye(3), np.zeros(3))], landmarks, options or LocateOptions())


_Eye = tuple[Sequence[LandmarkObservation], CameraModel, FloatArray, FloatArray]


def _locate(eyes: Sequence[_Eye], landmarks: LandmarkMap, options: LocateOptions) -> PoseEstimate:
    sightings = [s for eye in eyes for s in _sightings(eye, landmarks, options)]
    twice = _seen_twice(eyes, landmarks)
    if not sightings:
        return PoseEstimate("no_landmarks", outlier_codes=twice)
    poses = [_explained_fit(pose, sightings, options) for pose in _hypotheses(sightings)]
    ranked = _distinct(sorted(poses, key=lambda found: found[0].cost))
    best, inliers = ranked[0]
    codes = {s.code for s in sightings}
    explained = {s.code for s in inliers}
    if 2 * len(explained) < len(codes) or (len(codes) > 1 and len(explained) < 2):
        return PoseEstimate("inconsistent", outlier_codes=tuple(sorted(codes.union(twice))))
    ratios = [(pose, pose.cost - best.cost) for pose, _ in ranked[1:]]
    covariance = np.linalg.inv(_equations(best, inliers, options.prior).normal)
    # So far along its least known direction may a pose lie that explains the pictures almost as well.
    reach = float(np.sqrt(2 * options.ambiguous_below * np.linalg.eigvalsh(covariance[:3, :3])[-1]))
    doubtful = reach > options.far_m or (bool(ratios) and ratios[0][1] < options.ambiguous_below)
    squared = np.concatenate([_pixel_errors(best, s) for s in inliers]) ** 2
    return PoseEstimate(
        status="ambiguous" if doubtful else "ok",
        T_map_camera=Pose("map", "camera", best.R, best.p),
        covariance=covariance,
        inlier_codes=tuple(sorted(explained)),
        outlier_codes=tuple(sorted((codes - explained).union(twice))),
        alternatives=tuple(
            (Pose("map", "camera", pose.R, pose.p), ratio) for pose, ratio in ratios[:3] if ratio < 25
        ),
        reprojection_error_px=float(np.sqrt(squared.reshape(-1, 2).sum(axis=1).mean())),
    )


def _seen_twice(eyes: Sequence[_Eye], landmarks: LandmarkMap) -> tuple[int, ...]:
    """Mapped codes that are in one picture more than once: which is the mapped one cannot be told."""
    twice = set()
    for observations, *_ in eyes:
        seen = Counter((o.family, o.code) for o in observations)
        twice |= {code for (family, code), n in seen.items() if n > 1 and landmarks.find(code, family) is not None}
    return tuple(sorted(twice))


def _sightings(eye: _Eye, landmarks: LandmarkMap, options: LocateOptions) -> list[_Sighting]:
    observations, camera, R_eye, t_eye = eye
    # The same code twice in one picture: which is the mapped one cannot be told.
    seen = Counter((o.family, o.code) for o in observations)
    result = []
    for o in observations:
        landmark = landmarks.find(o.code, o.family)
        if landmark is None or seen[o.family, o.code] > 1:
            continue
        covariance = np.zeros((8, 8)) if o.covariance is None else o.covariance
        covariance = covariance + options.corner_floor_px**2 * np.eye(8)
        whitener = np.linalg.inv(np.linalg.cholesky(covariance))
        side = float(np.linalg.norm(np.roll(o.corners, -1, axis=0) - o.corners, axis=1).mean())
        result.append(_Sighting(landmark, o, camera, R_eye, t_eye, landmark.corners_map, whitener, side))
    return result


def _hypotheses(sightings: Sequence[_Sighting]) -> list[tuple[_Camera, _Sighting]]:
    """Both poses of every landmark in every eye, as poses of the left camera in the map."""
    poses = []
    for s in sightings:
        object_points = family_named(s.landmark.family).object_points(s.landmark.size_m)
        rays = s.camera.unproject(s.observation.corners).reshape(4, 1, 2)
        _, rvecs, tvecs, _ = cv2.solvePnPGeneric(object_points, rays, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE_SQUARE)
        T = s.landmark.T_map_landmark
        for rvec, tvec in zip(rvecs, tvecs, strict=True):
            # x_eye = R x_landmark + t, and x_eye = R_eye x_left + t_eye.
            R, t = rotation_exp(np.ravel(rvec)), np.ravel(tvec)
            R_left_landmark = s.R_eye.T @ R
            t_left_landmark = s.R_eye.T @ (t - s.t_eye)
            R_map_left = T.R @ R_left_landmark.T
            poses.append((_Camera(R_map_left, T.t - R_map_left @ t_left_landmark), s))
    return poses


def _explained_fit(
    hypothesis: tuple[_Camera, _Sighting], sightings: Sequence[_Sighting], options: LocateOptions
) -> tuple[_Camera, list[_Sighting]]:
    """The hypothesis refined on what it explains, its cost over all sightings, and what it explains."""
    pose, own = hypothesis
    prior = options.prior
    pose = _refine(pose, [s for s in sightings if s.code == own.code], prior)
    near = [s for s in sightings if _root_mean_square(_pixel_errors(pose, s)) < options.gate_share * s.side_px]
    if near:
        pose = _refine(pose, near, prior)
    limit = 8 * options.outlier_sigma**2
    for _ in range(2):
        inliers = [s for s in sightings if _squared_misfit(pose, s) < limit]
        if not inliers:
            break
        pose = _refine(pose, inliers, prior)
    inliers = [s for s in sightings if _squared_misfit(pose, s) < limit]
    # What is not explained costs as much as it could at the border of being explained.
    cost = sum(min(_squared_misfit(pose, s), limit) for s in sightings) / 2
    if prior is not None:
        cost += float(np.sum(prior.residuals(pose.R, pose.p) ** 2)) / 2
    return _Camera(pose.R, pose.p, cost), inliers


def _root_mean_square(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _distinct(ranked: list[tuple[_Camera, list[_Sighting]]]) -> list[tuple[_Camera, list[_Sighting]]]:
    """Without those that are the same pose as a better one."""
    kept: list[tuple[_Camera, list[_Sighting]]] = []
    for pose, inliers in ranked:
        far = [
            rotation_angle(pose.R.T @ k.R) > np.deg2rad(2) or float(np.linalg.norm(pose.p - k.p)) > 0.05
            for k, _ in kept
        ]
        if all(far):
            kept.append((pose, inliers))
    return kept


def _pixel_errors(pose: _Camera, s: _Sighting) -> FloatArray:
    """(8,) observed minus projected corners; huge when behind the camera."""
    in_left = (s.points - pose.p) @ pose.R
    in_eye = in_left @ s.R_eye.T + s.t_eye
    if in_eye[:, 2].min() < 0.02:
        return np.full(8, 1e4)
    return (s.observation.corners - s.camera.project(in_eye)).ravel()


def _whitened(pose: _Camera, s: _Sighting) -> FloatArray:
    return np.asarray(s.whitener @ _pixel_errors(pose, s))


def _jacobian(pose: _Camera, s: _Sighting) -> FloatArray:
    """(8,6) of the projected corners with a shift and a turn of the camera, both in the map frame."""
    offset = s.points - pose.p
    in_eye = offset @ pose.R @ s.R_eye.T + s.t_eye
    _, by_point, _ = s.camera.project_with_jacobian(in_eye)
    # x_left = R' exp(-turn) (X - p - shift).
    turning = np.stack([skew(o) for o in offset])
    to_left = np.concatenate([np.broadcast_to(-np.eye(3), (4, 3, 3)), turning], axis=2)
    return np.asarray(by_point @ (s.R_eye @ pose.R.T) @ to_left).reshape(8, 6)


@dataclass(frozen=True, eq=False)
class _Equations:
    """Normal equations of the pose, and the squared misfit, of landmarks whose own places are uncertain."""

    normal: FloatArray
    gradient: FloatArray
    squared: float


def _equations(pose: _Camera, sightings: Sequence[_Sighting], prior: PosePrior | None = None) -> _Equations:
    """Summed over landmarks, and the prior.

    Where the map says how well a landmark's place is known, its error is shared by all its corners in
    both eyes and enters their common covariance.
    """
    normal, gradient, squared = np.zeros((6, 6)), np.zeros(6), 0.0
    for landmark in dict.fromkeys(s.landmark for s in sightings):
        own = [s for s in sightings if s.landmark is landmark]
        J = np.concatenate([s.whitener @ _jacobian(pose, s) for s in own])
        r = np.concatenate([_whitened(pose, s) for s in own])
        normal += J.T @ J
        gradient += J.T @ r
        squared += float(r @ r)
        if landmark.covariance is not None:
            # Woodbury: (1 + K K')^-1 = 1 - K (1 + K'K)^-1 K', with K K' what the landmark's error does.
            by_landmark = np.concatenate([s.whitener @ _jacobian_of_landmark(pose, s) for s in own])
            K = by_landmark @ covariance_root(landmark.covariance)
            share = np.linalg.inv(np.eye(6) + K.T @ K)
            normal -= (J.T @ K) @ share @ (K.T @ J)
            gradient -= J.T @ K @ share @ (K.T @ r)
            squared -= float(r @ K @ share @ (K.T @ r))
    if prior is not None:
        J, r = prior.jacobian(pose.R, pose.p), prior.residuals(pose.R, pose.p)
        normal, gradient, squared = normal + J.T @ J, gradient + J.T @ r, squared + float(r @ r)
    return _Equations(normal, gradient, squared)


def _squared_misfit(pose: _Camera, s: _Sighting) -> float:
    """Of one landmark in one eye, in standard deviations, over its eight corner coordinates."""
    return _equations(pose, [s]).squared


def _refine(
    pose: _Camera, sightings: Sequence[_Sighting], prior: PosePrior | None = None, iterations: int = 12
) -> _Camera:
    """Levenberg-Marquardt on the whitened corners."""
    damping = 1e-4
    here = _equations(pose, sightings, prior)
    for _ in range(iterations):
        step = np.linalg.solve(here.normal + damping * np.diag(np.diag(here.normal)), here.gradient)
        trial = _Camera(rotation_exp(step[3:]) @ pose.R, pose.p + step[:3])
        there = _equations(trial, sightings, prior)
        if not there.squared < here.squared:
            damping *= 100
            if damping > 1e6:
                break
            continue
        done = here.squared - there.squared < 1e-6 * here.squared
        pose, here, damping = trial, there, max(damping / 10, 1e-9)
        if done:
            break
    return pose


def _jacobian_of_landmark(pose: _Camera, s: _Sighting) -> FloatArray:
    """(8,6) of the projected corners with a shift and a turn of the landmark about its middle, in the map frame."""
    in_eye = (s.points - pose.p) @ pose.R @ s.R_eye.T + s.t_eye
    _, by_point, _ = s.camera.project_with_jacobian(in_eye)
    arms = s.points - s.landmark.T_map_landmark.t
    turning = np.stack([-skew(arm) for arm in arms])
    moves = np.concatenate([np.broadcast_to(np.eye(3), (4, 3, 3)), turning], axis=2)
    return np.asarray(by_point @ (s.R_eye @ pose.R.T) @ moves).reshape(8, 6)


def covariance_at_base(estimate: PoseEstimate, T_camera_base: Pose) -> FloatArray | None:
    """(6,6) covariance of T_map_base, carried over from that of T_map_camera."""
    if estimate.T_map_camera is None or estimate.covariance is None:
        return None
    J = np.eye(6)
    J[:3, 3:] = -skew(estimate.T_map_camera.R @ T_camera_base.t)
    return np.asarray(J @ estimate.covariance @ J.T)
