"""Reasons why a pair does not agree with the other pairs: swapped, moved rig, blur, another frame."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.calibration.bundle_adjustment import FitOptions, Solution, StereoProblem
from lmkit.calibration.initialization import Consensus, board_poses
from lmkit.geometry.camera import CameraModel
from lmkit.geometry.rotations import rotation_angle
from lmkit.model.observation import PairView

BLUR_RATIO = 4.0  # noise of an image's corners over the median's
ONE_CAMERA_RATIO = 6.0  # a board's error in one camera alone over the median's
MATE_SHARE = 0.15  # of the board's size in the image: largest distance of a swapped image's corners
LEAST_GROUP = 2
MOST_TRIED = 12
MUCH_BETTER = 0.1  # a pair has its own rig if its error there is below this share of that in the others' rig
RELATION_ONLY = FitOptions(intrinsics=False, warp=False)
POSES_ONLY = FitOptions(intrinsics=False, relation=False, warp=False)


@dataclass(frozen=True)
class Disagreement:
    """One pair that was rejected.

    Attributes:
        pair: its name.
        cause: ``swapped``, ``moved``, ``blur``, ``distorted``, ``residual`` or ``other_time``.
        reason: in words.
    """

    pair: str
    cause: str
    reason: str


def explain_disagreements(
    object_points: FloatArray,
    views: Sequence[PairView],
    agreement: Consensus,
    bad: Sequence[int],
    residual_ratios: Mapping[int, float],
    solution: Solution,
    fair_px: float,
) -> list[Disagreement]:
    """A reason for each of the pairs ``bad``.

    Args:
        residuals: of pairs that agreed with the consensus, but then did not fit: how many times worse they
            fit than the median.
        agreement: how every pair's own relation of the cameras compares with the fitted one.
        solution: the rig as fitted to the others.
        fair_px: reprojection error, as :meth:`StereoProblem.rms` has it, up to which a pair fits.
    """
    middle_noise = np.median([n for v in views for n in (v.noise_left, v.noise_right) if n is not None] or [np.inf])
    middle_rms = float(np.median([r.rms_px for r in agreement.relations]))
    moved = _moved_together(object_points, views, solution, bad, fair_px)
    mates = _swapped_with(object_points, views, agreement, [k for k in bad if k not in moved], solution.right)
    result = []
    for k in bad:
        view = views[k]
        degrees, shift = agreement.off(k)
        off = f"its relative pose is off by {degrees:.1f} deg and {shift * 1000:.0f} mm from the other pairs"
        noise = max(view.noise_left or 0.0, view.noise_right or 0.0)
        if k in mates:
            cause = ("swapped", f"its right image matches the left image of {views[mates[k]].name}: swapped")
        elif k in moved:
            group, turned = moved[k]
            others = ", ".join(views[j].name for j in group if j != k)
            cause = ("moved", f"in it and {others}, the cameras are rotated by {turned:.1f} deg: the rig was moved")
        elif noise > BLUR_RATIO * middle_noise:
            cause = (
                "blur",
                f"its corner noise is {noise:.2f} px, {noise / middle_noise:.0f} times that of the others: blurred",
            )
        elif agreement.relations[k].rms_px > ONE_CAMERA_RATIO * middle_rms:
            rms = agreement.relations[k].rms_px
            cause = (
                "distorted",
                f"one camera's corners are {rms:.2f} px off a flat board: a reflection, a warped or another board",
            )
        elif k in residual_ratios:
            cause = ("residual", f"its residuals are {residual_ratios[k]:.0f} times those of the other pairs")
        else:
            cause = ("other_time", f"{off}: its two images are taken at different times, or of a mirror image")
        result.append(Disagreement(view.name, *cause))
    return result


def _swapped_with(
    object_points: FloatArray,
    views: Sequence[PairView],
    agreement: Consensus,
    bad: Sequence[int],
    right: CameraModel,
) -> dict[int, int]:
    """For each bad pair, the pair whose left image its right image goes with, if any."""
    mates: dict[int, int] = {}
    for k in bad:
        seen = {int(i): p for i, p in zip(views[k].ids_right, views[k].right, strict=True)}
        off = np.full(len(views), np.inf)
        for j, relation in enumerate(agreement.relations):
            R, t = relation.board
            expected = right.project((object_points @ R.T + t) @ agreement.R.T + agreement.t)
            both = np.array([(expected[i], seen[i]) for i in range(len(expected)) if i in seen])
            # A chessboard may have been counted from its other end.
            straight = np.linalg.norm(both[:, 0] - both[:, 1], axis=1)
            turned = np.linalg.norm(both[:, 0] - both[::-1, 1], axis=1)
            size = float(np.linalg.norm(np.ptp(both[:, 1], axis=0)))
            off[j] = min(float(np.median(straight)), float(np.median(turned))) / max(size, 1e-9)
        best = int(off.argmin())
        if best != k and off[best] < min(MATE_SHARE, off[k] / 2):
            mates[k] = best
    return mates


def _moved_together(
    object_points: FloatArray, views: Sequence[PairView], solution: Solution, bad: Sequence[int], fair_px: float
) -> dict[int, tuple[list[int], float]]:
    """For each bad pair that fits one other rig together with other bad ones: all of these, and the turn in deg.

    Args:
        solution: the rig of the other pairs; the cameras are fixed.
        fair_px: reprojection error up to which a pair fits.
    """
    groups: dict[int, tuple[list[int], float]] = {}
    bad = bad[:MOST_TRIED]
    before = {j: _rms_in(object_points, views[j], solution) for j in bad}
    for k in bad:
        if k in groups:
            continue
        own = StereoProblem(object_points, [views[k]])
        alone = own.solve(_started(solution, object_points, views[k]), RELATION_ONLY)
        fits = {j: _rms_in(object_points, views[j], alone) for j in bad}
        alike = [j for j in bad if fits[j] < max(fair_px, MUCH_BETTER * before[j])]
        if k in alike and len(alike) >= LEAST_GROUP:
            turned = float(np.rad2deg(rotation_angle(alone.R @ solution.R.T)))
            groups |= dict.fromkeys(alike, (alike, turned))
    return groups


def _rms_in(object_points: FloatArray, view: PairView, rig: Solution) -> float:
    """Reprojection error of a pair in a given rig, px; only the board's pose is fitted."""
    problem = StereoProblem(object_points, [view])
    return float(problem.rms(problem.solve(_started(rig, object_points, view), POSES_ONLY))[0])


def _started(rig: Solution, object_points: FloatArray, view: PairView) -> Solution:
    """The rig, with the board at its pose from the left camera alone."""
    poses = board_poses(rig.left, object_points[view.ids_left], view.left)
    R, t, _ = poses[0] if poses else (np.eye(3), np.array([0, 0, 1.0]), np.inf)
    return replace(rig, rotations=R[None], translations=t[None])
