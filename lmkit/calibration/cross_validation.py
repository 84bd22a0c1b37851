"""Cross-validation of a calibration: k folds, each evaluated on pairs that its fit did not use.

The training error does not show how much noise a model with more parameters has fitted; only held-out pairs
do (Stone 1974).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from lmkit.arrays import FloatArray, IntArray
from lmkit.calibration.bundle_adjustment import NEARBY, FitOptions, Solution, StereoProblem
from lmkit.geometry.pose import Pose
from lmkit.geometry.rectification import epipolar_errors
from lmkit.geometry.stereo_rig import StereoRig
from lmkit.model.observation import PairView

FOLDS = 5
FOLD_CONVERGED = 1e-5  # relative gain of the last step
# A model with more parameters must be better by this number of standard errors, and by this share.
CLEAR_ERRORS = 1.0
CLEAR_SHARE = 0.01


def in_fold(options: FitOptions) -> FitOptions:
    """Options of a fit that starts from the fit of all pairs, and serves for its errors on unseen pairs alone."""
    return replace(options, converged=FOLD_CONVERGED, damping=NEARBY, covariance=False)


POSES_ONLY = in_fold(FitOptions(intrinsics=False, relation=False, warp=False))


@dataclass(frozen=True)
class HeldOut:
    """Errors on held-out pairs; one entry per pair.

    Attributes:
        rows: which pairs.
        epipolar_px: mean difference in rows after rectification.
        reprojection_px: mean distance of the corners from their projections with the board's best pose.
        common: corners that both cameras see.
        corners: of both cameras.
    """

    rows: IntArray
    epipolar_px: FloatArray
    reprojection_px: FloatArray
    common: FloatArray
    corners: FloatArray

    @property
    def mean_epipolar_px(self) -> float:
        """Over all corners."""
        return float(np.average(self.epipolar_px, weights=self.common))

    @property
    def mean_reprojection_px(self) -> float:
        """Over all corners."""
        return float(np.average(self.reprojection_px, weights=self.corners))

    def clearly_better_than(self, other: HeldOut) -> bool:
        """Whether this is clearly better, compared pair by pair on the pairs of both."""
        _, own, others = np.intersect1d(self.rows, other.rows, return_indices=True)
        before = other.reprojection_px[others]
        gain = before - self.reprojection_px[own]
        error = float(gain.std(ddof=1)) / np.sqrt(len(gain))
        return bool(gain.mean() > max(CLEAR_ERRORS * error, CLEAR_SHARE * float(before.mean())))


def hold_out(
    object_points: FloatArray,
    views: Sequence[PairView],
    rows: Sequence[int],
    solution: Solution,
    options: FitOptions | None = None,
    on_fold: Callable[[int], None] = lambda fold: None,
) -> HeldOut | None:
    """The errors of the solution's kind of rig on held-out pairs; None with fewer than five pairs.

    Args:
        views: all pairs.
        rows: those that are used.
        solution: fitted to these; the folds start from it.
        options: what each fold fits; everything by default.
        on_fold: called with the number of folds done.
    """
    views = [views[k] for k in rows]
    count = len(views)
    if count < FOLDS:
        return None
    options = in_fold(options or FitOptions())
    fold = np.arange(count) % FOLDS
    errors = np.zeros((count, 4))
    for k in range(FOLDS):
        seen, unseen = np.flatnonzero(fold != k), np.flatnonzero(fold == k)
        fitted = StereoProblem(object_points, [views[int(i)] for i in seen]).solve(solution.with_poses(seen), options)
        errors[unseen] = errors_on(
            object_points, [views[int(i)] for i in unseen], fitted, solution.with_poses(unseen)
        )
        on_fold(k + 1)
    return HeldOut(np.array(rows), *errors.T)


def errors_on(object_points: FloatArray, views: Sequence[PairView], rig: Solution, poses: Solution) -> FloatArray:
    """(P,4) as the attributes of :class:`HeldOut`; the boards' poses are fitted, from those of ``poses``."""
    problem = StereoProblem(object_points, views)
    start = Solution(rig.left, rig.right, rig.R, rig.t, rig.warp, poses.rotations, poses.translations)
    placed = problem.solve(start, POSES_ONLY)
    stereo = StereoRig(rig.left, rig.right, Pose("right", "left", rig.R, rig.t))
    rows = []
    for view, both in zip(views, problem.residuals(placed), strict=True):
        off = np.linalg.norm(np.concatenate(both), axis=1)
        left, right = common_corners(view)
        rows.append((np.abs(epipolar_errors(stereo, left, right)).mean(), off.mean(), len(left), len(off)))
    return np.array(rows)


def common_corners(view: PairView) -> tuple[FloatArray, FloatArray]:
    """(N,2) and (N,2) pixels of the corners that both cameras see."""
    _, in_left, in_right = np.intersect1d(view.ids_left, view.ids_right, return_indices=True)
    return view.left[in_left], view.right[in_right]
