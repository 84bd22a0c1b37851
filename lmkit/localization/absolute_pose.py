"""`locate_rig`: the pose of a stereo camera, or of one camera, from all corners of all landmarks in view.

1. Every landmark alone gives two poses (a square seen by one camera has a second pose; IPPE, Collins and
   Bartoli 2014).  All of them, carried into the map, are hypotheses.
2. Each hypothesis is fitted to its own landmark in both cameras, then to all landmarks that it comes
   near to, so one wrong code cannot capture the start.
3. Those that are still different poses are refined on all corners of the landmarks they explain,
   weighted by the corners' own covariance.
4. The likelihood ratio of the best to the next pose that is really another one decides whether
   the answer is ``ok`` or ``ambiguous``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lmkit.arrays import BoolArray, FloatArray, IntArray
from lmkit.geometry.camera import CameraModel
from lmkit.geometry.pose_array import PoseArray
from lmkit.geometry.stereo_rig import StereoRig
from lmkit.kernels.square_pose import square_poses
from lmkit.localization.correspondences import CORNER_FLOOR_PX, Correspondences
from lmkit.localization.pose_prior import PosePrior
from lmkit.model.estimate import PoseEstimate
from lmkit.model.landmark_map import LandmarkMap
from lmkit.model.observation import Detection
from lmkit.model.pose_status import PoseStatus

SAME_TURN_RAD = np.deg2rad(2.0)
SAME_PLACE_M = 0.05
LISTED_BELOW = 25.0  # log likelihood ratio of alternatives that are listed
MOST_LISTED = 3
# Iterations: towards its own landmark, towards all it comes near to, and to the end.
TOWARDS_NEAR, TO_THE_END = 2, 8


@dataclass(frozen=True)
class LocateOptions:
    """The few dials of locating.

    Attributes:
        corner_floor_px: standard deviation added to every corner's own: what calibration and flat
            paper leave open.
        ambiguous_below: log likelihood ratio under which a second pose makes the answer ambiguous.
        far_m, far_rad: a pose that other ones so far away explain almost as well is ambiguous, too: far and small
            landmarks leave a valley of poses rather than two.
        outlier_sigma: a landmark is explained when the root mean square of its eight corner
            coordinates stays under this many standard deviations.
        gate_share: before refinement, a landmark is explained when its corners lie within this
            share of its side.
        prior: what is known of the pose beforehand.
    """

    corner_floor_px: float = CORNER_FLOOR_PX
    ambiguous_below: float = 5.0
    far_m: float = 0.5
    far_rad: float = np.deg2rad(5.0)
    outlier_sigma: float = 4.5
    gate_share: float = 0.25
    prior: PosePrior | None = None


def locate_rig(
    left: Sequence[Detection],
    right: Sequence[Detection],
    rig: StereoRig,
    landmarks: LandmarkMap,
    options: LocateOptions | None = None,
) -> PoseEstimate:
    """The pose of the rig's left camera in the map.

    Args:
        left, right: detections in the two images, corners in pixels as delivered.
    """
    cameras = [
        (left, rig.left, np.eye(3), np.zeros(3)),
        (right, rig.right, rig.T_right_left.R, rig.T_right_left.t),
    ]
    options = options or LocateOptions()
    estimate = _locate(cameras, landmarks, options)
    if estimate.status == PoseStatus.INCONSISTENT and left and right:
        swapped = [(right, *cameras[0][1:]), (left, *cameras[1][1:])]
        if _locate(swapped, landmarks, options).T_map_camera is not None:
            return PoseEstimate(PoseStatus.SWAPPED, outliers=estimate.outliers)
    return estimate


def locate_camera(
    observations: Sequence[Detection],
    camera: CameraModel,
    landmarks: LandmarkMap,
    options: LocateOptions | None = None,
) -> PoseEstimate:
    """The pose of a single camera in the map."""
    return _locate([(observations, camera, np.eye(3), np.zeros(3))], landmarks, options or LocateOptions())


_Eye = tuple[Sequence[Detection], CameraModel, FloatArray, FloatArray]


def _locate(cameras: Sequence[_Eye], landmarks: LandmarkMap, options: LocateOptions) -> PoseEstimate:
    seen = Correspondences(cameras, landmarks, options.corner_floor_px)
    if not len(seen):
        return PoseEstimate(PoseStatus.NO_LANDMARKS, outliers=tuple(sorted(seen.twice)))
    hypotheses = _hypotheses(seen)
    if not len(hypotheses[0]):
        return PoseEstimate(PoseStatus.INCONSISTENT, outliers=tuple(sorted({*seen.ids, *seen.twice})))
    found = _candidates(seen, *hypotheses, options)
    poses, cost = found.poses, found.cost
    inliers = found.chi2 < 8 * options.outlier_sigma**2
    ids, explained = set(seen.ids), seen.ids_of(inliers[0])
    # A camera that sees landmarks of the map, but none where it should, is not where the rig says.
    blind = any(eye.rows.stop > eye.rows.start and not inliers[0, eye.rows].any() for eye in seen.cameras)
    if blind or 2 * len(explained) < len(ids) or (len(ids) > 1 and len(explained) < 2):
        return PoseEstimate(PoseStatus.INCONSISTENT, outliers=tuple(sorted(ids | seen.twice)))
    best = poses.only(np.array([0]))
    covariance = _covariance(seen, best, inliers[:1], options.prior)
    # So far along its least known direction may a pose lie that explains the images almost as well.
    widest = np.linalg.eigvalsh(np.stack([covariance[:3, :3], covariance[3:, 3:]]))[:, -1]
    reach_m, reach_rad = np.sqrt(2 * options.ambiguous_below * widest)
    ratios = cost - cost[0]
    wide = bool(reach_m > options.far_m or reach_rad > options.far_rad)
    rivalled = len(cost) > 1 and float(ratios[1]) < options.ambiguous_below
    pixels = seen.chi2_and_pixels(best)[1][0][inliers[0]]
    return PoseEstimate(
        status=PoseStatus.AMBIGUOUS if rivalled else PoseStatus.IMPRECISE if wide else PoseStatus.OK,
        T_map_camera=poses.pose(0),
        covariance=covariance,
        inliers=tuple(sorted(explained)),
        outliers=tuple(sorted((ids - explained) | seen.twice)),
        alternatives=tuple(
            (poses.pose(k), float(ratios[k]))
            for k in range(1, min(len(cost), 1 + MOST_LISTED))
            if ratios[k] < LISTED_BELOW
        ),
        reprojection_error_px=float(np.sqrt(2 * np.mean(pixels**2))),
    )


@dataclass(frozen=True, eq=False)
class _Candidates:
    """H poses with the residuals (H,S) of all observations and their costs (H,)."""

    poses: PoseArray
    chi2: FloatArray
    cost: FloatArray

    @classmethod
    def judged(cls, poses: PoseArray, chi2: FloatArray, options: LocateOptions) -> _Candidates:
        """With negative log likelihoods; an observation that is not explained costs as much as one just explained."""
        cost = np.minimum(chi2, 8 * options.outlier_sigma**2).sum(axis=1) / 2
        if options.prior is not None:
            cost = cost + (options.prior.residuals(poses.R, poses.t) ** 2).sum(axis=1) / 2
        return cls(poses, chi2, cost)

    def only(self, rows: IntArray) -> _Candidates:
        """Some of them."""
        return _Candidates(self.poses.only(rows), self.chi2[rows], self.cost[rows])

    def distinct(self) -> _Candidates:
        """Sorted by cost, without those that are the same pose as a better one."""
        R, p = self.poses.R.reshape(-1, 9), self.poses.t
        turned = 1 + 2 * np.cos(SAME_TURN_RAD) > R @ R.T
        apart = turned | (((p[:, None] - p) ** 2).sum(axis=2) > SAME_PLACE_M**2)
        kept: list[int] = []
        for k in np.argsort(self.cost, kind="stable").tolist():
            if apart[k, kept].all():
                kept.append(k)
        return self.only(np.array(kept))


def _candidates(seen: Correspondences, poses: PoseArray, own: IntArray, options: LocateOptions) -> _Candidates:
    """Poses that are really different, each refined on what it explains; best first."""
    prior, limit = options.prior, 8 * options.outlier_sigma**2
    mine, gate_px = seen.of == own[:, None], options.gate_share * seen.side_px
    near = mine | (seen.chi2_and_pixels(poses)[1] < gate_px)
    poses = seen.refine(poses, near, prior, TOWARDS_NEAR)
    # What a pose does not even come near to it will not explain, however it is refined.
    chi2, pixels = seen.chi2_and_pixels(poses)
    near |= (pixels < gate_px) | (chi2 < limit)
    least = (~near).sum(axis=1) * limit / 2
    found = _Candidates.judged(poses, chi2, options)
    hopeful = least < found.cost.min() + LISTED_BELOW
    found = found.only(np.flatnonzero(hopeful)).distinct()
    used: BoolArray | None = None
    for _ in range(3):
        inliers = found.chi2 < limit
        # A pose that explains nothing stays where its best landmark put it.
        nothing = ~np.asarray(inliers.any(axis=1, keepdims=True))
        inliers |= nothing & (found.chi2 == found.chi2.min(axis=1, keepdims=True))
        if used is not None and (inliers == used).all():
            break
        used = inliers
        poses = seen.refine(found.poses, inliers, prior, TO_THE_END)
        found = _Candidates.judged(poses, seen.chi2(poses), options)
    return found.distinct()


def _hypotheses(seen: Correspondences) -> tuple[PoseArray, IntArray]:
    """Both poses of every landmark, as poses of the left camera in the map, and its index in ``seen.ids``."""
    best: dict[int, int] = {}
    sides = seen.side_px.tolist()
    for row, which in enumerate(seen.of.tolist()):
        # Of the two cameras the one that sees it larger.
        if which not in best or sides[row] > sides[best[which]]:
            best[which] = row
    rows = list(best.values())
    landmarks = [seen.landmarks[row] for row in rows]
    R_eye, t_eye, _ = square_poses(seen.rays[rows], np.array([landmark.size_m for landmark in landmarks]))
    # x_eye = R x_landmark + t, and x_eye = R_eye x_left + t_eye.
    R_left_eye = seen.camera_R[rows].transpose(0, 2, 1)[:, None]
    t_left = R_left_eye @ (t_eye - seen.camera_t[rows][:, None])[..., None]
    R_map = np.array([landmark.T_map_landmark.R for landmark in landmarks])[:, None]
    t_map = np.array([landmark.T_map_landmark.t for landmark in landmarks])[:, None]
    R_map_left = R_map @ (R_left_eye @ R_eye).swapaxes(-1, -2)
    p = t_map - (R_map_left @ t_left)[..., 0]
    finite = np.isfinite(p).all(axis=2).ravel()
    poses = PoseArray("map", "left", R_map_left.reshape(-1, 3, 3)[finite], p.reshape(-1, 3)[finite])
    return poses, np.repeat(seen.of[rows], 2)[finite]


def _covariance(seen: Correspondences, best: PoseArray, used: BoolArray, prior: PosePrior | None) -> FloatArray:
    """(6,6) covariance of the pose.

    A landmark seen head-on determines its tilt poorly, and linearization at an estimate that is off makes the
    covariance too small.  The information is therefore averaged over poses one standard deviation away along the
    least known direction.
    """
    here = np.linalg.inv(seen.equations(best, used, prior)[0][0])
    values, vectors = np.linalg.eigh(here)
    step = np.array([[-1.0], [1.0]]) * np.sqrt(max(values[-1], 0.0)) * vectors[:, -1]
    around = best.only(np.zeros(2, dtype=np.int64)).retract(step)
    there = np.linalg.inv(seen.equations(around, np.repeat(used, 2, axis=0), prior)[0])
    return np.asarray((here + there[0] + there[1]) / 3)
