"""`check_rig`: whether an old calibration is still valid for new images.

Lenses get bumped, and rigs deform with temperature.  The old rig is compared on new corners with
rigs that were fitted to the other new pairs: first with a new relative pose of the cameras only, then
also with new lenses.  If a new fit is clearly better on held-out pairs, and by more
than a negligible amount, the old rig is no longer valid.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.calibration.board_equations import POSE
from lmkit.calibration.bundle_adjustment import FitOptions, Solution, StereoProblem
from lmkit.calibration.cross_validation import HeldOut, hold_out
from lmkit.calibration.initialization import board_poses
from lmkit.calibration.intrinsics import intrinsics_vector
from lmkit.errors import InputError
from lmkit.geometry.camera import CameraModel
from lmkit.geometry.pose import Pose
from lmkit.geometry.rotations import rotation_log
from lmkit.geometry.stereo_rig import StereoRig
from lmkit.model.observation import PairView

LEAST_VIEWS = 5
NOTICED_PX = 0.05  # gain on held-out pairs that justifies a new calibration, mean reprojection error
BAD_RATIO = 4.0


@dataclass(frozen=True)
class RigCheck:
    """Result of checking an old rig by new images.

    Attributes:
        state: ``true``, ``moved`` (the relative pose of the cameras has changed) or ``lenses`` (other
            intrinsics, too).
        epipolar_px, reprojection_px: mean errors of the new corners in the old rig.
        moved_epipolar_px, moved_reprojection_px: on held-out pairs, with the relative pose fitted again.
        lenses_reprojection_px: the same with the intrinsics fitted as well; None if the views do not determine them.
        turn_deg, turn_sigma_deg: (3,) rotation of the right camera about its own x, y and z axis since the
            calibration.
        shift_mm, shift_sigma_mm: (3,) shift of the left camera's center in the right camera's frame.
        focal_change: relative change of the left and right focal length, where the state is ``lenses``.
        used: pairs that were used.
        contradicted: pairs whose corners fit neither rig.
    """

    state: str
    epipolar_px: float
    reprojection_px: float
    moved_epipolar_px: float
    moved_reprojection_px: float
    lenses_reprojection_px: float | None
    turn_deg: FloatArray
    turn_sigma_deg: FloatArray
    shift_mm: FloatArray
    shift_sigma_mm: FloatArray
    focal_change: tuple[float, float] | None
    used: tuple[str, ...]
    contradicted: tuple[str, ...]

    @property
    def sentence(self) -> str:
        """The state in words."""
        if self.state == "true":
            return "still valid: no new fit is clearly better on held-out pairs"
        axis = int(np.abs(self.turn_deg).argmax())
        motion = ("pitched", "yawed", "rolled")[axis]
        turned = f"the right camera has {motion} by {self.turn_deg[axis]:+.3f} ± {self.turn_sigma_deg[axis]:.3f} deg"
        if self.state == "moved":
            return f"no longer valid: {turned} to the left one; recalibrate"
        assert self.focal_change is not None
        left, right = (f"{100 * change:+.2f} %" for change in self.focal_change)
        return f"no longer valid: the lenses have changed (focal lengths {left} left, {right} right); recalibrate"


def check_rig(rig: StereoRig, object_points: FloatArray, views: Sequence[PairView], lenses: bool = True) -> RigCheck:
    """Compare a rig with new images of a board, or of landmarks.

    Args:
        object_points: (N,3) of the board, meters; of landmarks, the four corners of each size in use.
        views: board or landmark in both cameras, each view with its own pose.
        lenses: whether the views determine the intrinsics and the board's bow (those of a board do, those of
            landmarks do not).

    Raises:
        InputError: too few views.
    """
    started = [(view, _start(rig, object_points, view)) for view in views]
    known = [(view, pose) for view, pose in started if pose is not None]
    if len(known) < LEAST_VIEWS:
        raise InputError(
            "too_few_views",
            f"{len(known)} views seen by both cameras, at least {LEAST_VIEWS} are needed to check a rig",
            "give more image pairs; for images of a board, add --board",
        )
    kept = [view for view, _ in known]
    old = _solution(rig, [pose for _, pose in known])
    as_is = FitOptions(intrinsics=False, relation=False, warp=lenses)
    turned = FitOptions(intrinsics=False, warp=lenses)
    # Pairs taken at different times fit no rig; they must not count as evidence for a moved rig.
    moved = StereoProblem(object_points, kept).solve(old, turned)
    # If two poses of a board fit one camera, the old relative pose may have selected the wrong one.
    found = replace(rig, T_right_left=Pose("right", "left", moved.R, moved.t))
    chosen = [_start(found, object_points, view) or pose for view, pose in known]
    old = _solution(rig, chosen)
    moved = StereoProblem(object_points, kept).solve(_solution(found, chosen), turned)
    rms = StereoProblem(object_points, kept).rms(moved)
    good = np.flatnonzero(rms <= BAD_RATIO * np.median(rms))
    contradicted = [kept[int(k)].name for k in np.flatnonzero(rms > BAD_RATIO * np.median(rms))]
    kept = [kept[int(k)] for k in good]
    if len(kept) < LEAST_VIEWS:
        raise InputError(
            "too_few_views", f"only {len(kept)} views agree with each other", "give more pairs of images"
        )
    rows = list(range(len(kept)))
    problem = StereoProblem(object_points, kept)
    moved = problem.solve(moved.with_poses(good), turned)
    as_it_was = hold_out(object_points, kept, rows, old.with_poses(good), as_is)
    fitted = hold_out(object_points, kept, rows, moved, turned)
    assert as_it_was is not None
    assert fitted is not None
    state = "moved" if _worth(fitted, as_it_was) else "true"
    anew: HeldOut | None = None
    change: tuple[float, float] | None = None
    if lenses:
        everything = problem.solve(moved, FitOptions())
        anew = hold_out(object_points, kept, rows, everything, FitOptions())
        assert anew is not None
        if _worth(anew, fitted if state == "moved" else as_it_was):
            state = "lenses"
            change = _zoom(rig.left, everything.left), _zoom(rig.right, everything.right)
    assert moved.covariance is not None
    at = len(intrinsics_vector(rig.left)) + len(intrinsics_vector(rig.right))
    sigma = np.sqrt(np.diag(moved.covariance)[at : at + POSE])
    return RigCheck(
        state=state,
        epipolar_px=as_it_was.mean_epipolar_px,
        reprojection_px=as_it_was.mean_reprojection_px,
        moved_epipolar_px=fitted.mean_epipolar_px,
        moved_reprojection_px=fitted.mean_reprojection_px,
        lenses_reprojection_px=None if anew is None else anew.mean_reprojection_px,
        turn_deg=np.rad2deg(rotation_log(moved.R @ rig.T_right_left.R.T)),
        turn_sigma_deg=np.rad2deg(sigma[:3]),
        shift_mm=1000 * (moved.t - rig.T_right_left.t),
        shift_sigma_mm=1000 * sigma[3:],
        focal_change=change,
        used=tuple(view.name for view in kept),
        contradicted=tuple(contradicted),
    )


def _solution(rig: StereoRig, poses: Sequence[tuple[FloatArray, FloatArray]]) -> Solution:
    """The rig with the board's poses (R, t of T_left_board), to start from."""
    return Solution(
        rig.left,
        rig.right,
        rig.T_right_left.R,
        rig.T_right_left.t,
        np.zeros(2),
        np.array([R for R, _ in poses]),
        np.array([t for _, t in poses]),
    )


def _zoom(old: CameraModel, new: CameraModel) -> float:
    """Relative change of the focal length."""
    return float(new.K[0, 0] / old.K[0, 0] - 1)


def _worth(new: HeldOut, old: HeldOut) -> bool:
    gain = old.mean_reprojection_px - new.mean_reprojection_px
    return gain > NOTICED_PX and new.clearly_better_than(old)


def _start(rig: StereoRig, object_points: FloatArray, view: PairView) -> tuple[FloatArray, FloatArray] | None:
    """R, t of T_left_board: the pose allowed by the left camera that fits the right camera best."""
    poses = board_poses(rig.left, object_points[view.ids_left], view.left)
    best: tuple[float, tuple[FloatArray, FloatArray]] | None = None
    for R, t, _ in poses:
        in_right = (object_points[view.ids_right] @ R.T + t) @ rig.T_right_left.R.T + rig.T_right_left.t
        off = float(np.median(np.linalg.norm(rig.right.project(in_right) - view.right, axis=1)))
        if best is None or off < best[0]:
            best = (off, (R, t))
    return None if best is None else best[1]


def check_dict(checked: RigCheck) -> dict[str, Any]:
    """The JSON result (docs/formats.md)."""
    return {
        "state": checked.state,
        "sentence": checked.sentence,
        "epipolar_px": checked.epipolar_px,
        "reprojection_px": checked.reprojection_px,
        "refitted_epipolar_px": checked.moved_epipolar_px,
        "refitted_reprojection_px": checked.moved_reprojection_px,
        "turn_deg": checked.turn_deg.tolist(),
        "turn_sigma_deg": checked.turn_sigma_deg.tolist(),
        "shift_mm": checked.shift_mm.tolist(),
        "shift_sigma_mm": checked.shift_sigma_mm.tolist(),
        "focal_change": None if checked.focal_change is None else list(checked.focal_change),
        "views_used": list(checked.used),
        "views_contradicted": list(checked.contradicted),
    }


def check_lines(checked: RigCheck) -> list[str]:
    """The result as lines of text, without the state."""
    lines = []
    for name, old_px, new_px in (
        ("row error", checked.epipolar_px, checked.moved_epipolar_px),
        ("reprojection error", checked.reprojection_px, checked.moved_reprojection_px),
    ):
        lines.append(f"{name:<22} {old_px:.3f} px with this rig, {new_px:.3f} px with a new fit of the relative pose")
    bad = (
        f", {len(checked.contradicted)} match no rig ({', '.join(checked.contradicted)})"
        if checked.contradicted
        else ""
    )
    return [*lines, f"views                  {len(checked.used)} used{bad}"]
