"""`calibrate_camera`: a rig of one camera, with its errors, from the corners of a board in images.

The fit is that of a stereo pair (`bundle_adjustment.py`) whose right camera has no views.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from lmkit.arrays import BoolArray, FloatArray, IntArray
from lmkit.calibration.bundle_adjustment import NEARBY, ROUGHLY, FitOptions, Solution, StereoProblem
from lmkit.calibration.cross_validation import FOLDS, POSES_ONLY, HeldOut, in_fold
from lmkit.calibration.initialization import CameraStarts, board_poses
from lmkit.calibration.intrinsics import intrinsics_vector, sigma_and_correlation
from lmkit.calibration.sanity_checks import (
    STRONG_WARP,
    CalibrationWarning,
    Declared,
    check_camera,
    require_explained,
    require_views,
)
from lmkit.calibration.view_coverage import ENOUGH_CELLS, LEAST_VIEWS, camera_coverage, covered_share
from lmkit.errors import InputError
from lmkit.geometry.camera import CameraModel
from lmkit.geometry.lens_models import LENS_MODELS
from lmkit.geometry.pose import Pose
from lmkit.geometry.rig import MountedCamera, Rig
from lmkit.model.board import BoardSpec
from lmkit.model.observation import BoardObservation, PairView
from lmkit.units import counted

MIN_VIEWS = 3
BAD_RMS_RATIO = 4.0


@dataclass(frozen=True, eq=False)
class CameraCalibration:
    """A calibrated camera and the evidence for it.

    Attributes:
        rig: a rig of this one camera, with the standard deviations of its intrinsics.
        held_out_px: mean reprojection error on held-out images; None with fewer than five images.
        models: held-out error, px, of every camera model that was tried.
        rms_px: reprojection error of the fit.
        used: names of the images of the fit.
        rejected: (image, reason).
        warnings: the most important first.
        coverage: (5,5) cells of the image in which corners were seen.
        advice: views to take next.
    """

    rig: Rig
    held_out_px: float | None
    models: dict[str, float]
    rms_px: float
    used: tuple[str, ...]
    rejected: tuple[tuple[str, str], ...]
    warnings: tuple[CalibrationWarning, ...]
    coverage: BoolArray
    advice: tuple[str, ...]

    def __repr__(self) -> str:
        unseen = "" if self.held_out_px is None else f", held out {self.held_out_px:.3f} px"
        return (
            f"CameraCalibration({self.rig.left.model}, {len(self.used)} images, {self.rms_px:.3f} px{unseen}, "
            f"{counted(len(self.warnings), 'warning')})"
        )

    @property
    def covered(self) -> float:
        """Share of the image in which corners were seen; parts that cannot show a board are not counted."""
        return covered_share(self.coverage, self.rig.left)

    def to_dict(self) -> dict[str, Any]:
        """The result as JSON values; docs/formats.md lists the keys."""
        return {
            "rms_px": self.rms_px,
            "held_out_reprojection_px": self.held_out_px,
            "images_used": list(self.used),
            "images_rejected": [{"image": name, "reason": reason} for name, reason in self.rejected],
            "warnings": [{"code": w.code, "message": w.message, "images": list(w.pairs)} for w in self.warnings],
            "model": self.rig.left.model,
            "models": self.models,
            "coverage": {"image": self.covered, "next_views": list(self.advice)},
        }


@dataclass(frozen=True)
class _Fit:
    """One model, fitted to the images that agree on it."""

    rows: list[int]
    ratios: dict[int, float]  # error of each other image over the median error
    rms_px: float
    solution: Solution
    held_out: HeldOut | None


def calibrate_camera(
    views: Sequence[tuple[str, BoardObservation]],
    board: BoardSpec,
    image_size: tuple[int, int],
    model: str = "auto",
    rejected: Sequence[tuple[str, str]] = (),
    declared: Declared | None = None,
) -> CameraCalibration:
    """Calibrate one camera from all images that agree with each other.

    Args:
        views: names of images, and the board in them.
        image_size: (width, height).
        model: ``pinhole``, ``rational`` or ``fisheye``; ``auto`` takes the best one on held-out images.
        rejected: images rejected earlier, with reasons; they are added to the result.
        declared: nominal field of view, to check against.

    Raises:
        InputError: too few images, or no camera explains them.
    """
    require_views(len(views), rejected, MIN_VIEWS, "images")
    alone = [_alone(name, seen) for name, seen in views]
    fits: dict[str, _Fit] = {}
    failed: InputError | None = None
    starts = CameraStarts(board.object_points, [(v.ids_left, v.left) for v in alone], image_size)
    for name in LENS_MODELS if model == "auto" else (model,):
        try:
            fits[name] = _fit(alone, board.object_points, starts.camera(name))
        except InputError as error:
            failed = failed or error
        except np.linalg.LinAlgError:
            continue
    if not fits:
        raise failed or InputError("no_fit", "no camera explains the images", "take other views")
    best, *others = fits.values()
    for other in others:
        # A later model must be clearly better on held-out images.
        if best.held_out is not None and other.held_out is not None:
            best = other if other.held_out.clearly_better_than(best.held_out) else best
    bad = [
        (
            alone[k].name,
            f"corners fit {ratio:.0f} times worse than in the median image: blurred, or the board is warped",
        )
        for k, ratio in best.ratios.items()
    ]
    require_views(len(best.rows), [*rejected, *bad], MIN_VIEWS, "images")
    kept = [alone[k] for k in best.rows]
    s = best.solution
    cells, advice = camera_coverage([view.left for view in kept], s.rotations, s.translations, s.left)
    assert s.covariance is not None
    count = len(intrinsics_vector(s.left))
    known = sigma_and_correlation(s.covariance[:count, :count])
    mounted = MountedCamera("camera", s.left, Pose.identity("camera", "left"), None, *known)
    bow_share = float(np.abs(s.warp).max()) / (float(np.ptp(board.object_points[:, :2], axis=0).max()) / 2)
    warnings = _warnings(mounted, bad, len(views), bow_share, cells, len(kept), declared or Declared())
    return CameraCalibration(
        rig=Rig((mounted,)),
        held_out_px=None if best.held_out is None else best.held_out.mean_reprojection_px,
        models={name: fit.held_out.mean_reprojection_px for name, fit in fits.items() if fit.held_out is not None},
        rms_px=best.rms_px,
        used=tuple(view.name for view in kept),
        rejected=(*rejected, *bad),
        warnings=tuple(warnings),
        coverage=cells,
        advice=advice,
    )


def _alone(name: str, seen: BoardObservation) -> PairView:
    """A view without corners in the right camera."""
    none: IntArray = np.zeros(0, dtype=np.int64)
    return PairView(name, seen.ids, seen.image_points, none, np.zeros((0, 2)), seen.noise_px)


def _fit(views: Sequence[PairView], object_points: FloatArray, camera: CameraModel) -> _Fit:
    started = [board_poses(camera, object_points[v.ids_left], v.left)[:1] for v in views]
    rows = [k for k, poses in enumerate(started) if poses]
    require_views(len(rows), (), MIN_VIEWS, "images")
    start = Solution(
        camera,
        camera,
        np.eye(3),
        np.zeros(3),
        np.zeros(2),
        np.array([started[k][0][0] for k in rows]),
        np.array([started[k][0][1] for k in rows]),
    )
    problem = StereoProblem(object_points, [views[k] for k in rows])
    flat = problem.solve(start, FitOptions(warp=False, converged=ROUGHLY, covariance=False))
    solution = problem.solve(flat, FitOptions(damping=NEARBY))
    rms = problem.rms(solution)
    require_explained(float(np.median(rms)), camera.image_size, camera.model)
    good = rms <= BAD_RMS_RATIO * np.median(rms)
    ratios = {k: float(r / np.median(rms)) for k, r, ok in zip(rows, rms, good, strict=True) if not ok}
    if ratios:
        rows = [k for k, ok in zip(rows, good, strict=True) if ok]
        problem = StereoProblem(object_points, [views[k] for k in rows])
        solution = problem.solve(solution.with_poses(np.flatnonzero(good)), FitOptions())
    left = np.concatenate([pair[0] for pair in problem.residuals(solution)])
    rms_px = float(np.sqrt(np.mean(np.sum(left**2, axis=1))))
    return _Fit(rows, ratios, rms_px, solution, _hold_out(object_points, [views[k] for k in rows], rows, solution))


def _hold_out(
    object_points: FloatArray, views: Sequence[PairView], rows: Sequence[int], solution: Solution
) -> HeldOut | None:
    """Errors on held-out images, fold by fold; None with fewer than five images."""
    count = len(views)
    if count < FOLDS:
        return None
    fold, errors = np.arange(count) % FOLDS, np.zeros((count, 2))
    for k in range(FOLDS):
        seen, unseen = np.flatnonzero(fold != k), np.flatnonzero(fold == k)
        fitted = StereoProblem(object_points, [views[int(i)] for i in seen]).solve(
            solution.with_poses(seen), in_fold(FitOptions())
        )
        problem = StereoProblem(object_points, [views[int(i)] for i in unseen])
        there = solution.with_poses(unseen)
        start = Solution(
            fitted.left, fitted.right, fitted.R, fitted.t, fitted.warp, there.rotations, there.translations
        )
        placed = problem.solve(start, POSES_ONLY)
        off = [np.linalg.norm(left, axis=1) for left, _ in problem.residuals(placed)]
        errors[unseen] = [(values.mean(), len(values)) for values in off]
    none = np.zeros(count)
    return HeldOut(np.array(rows), none, errors[:, 0], none, errors[:, 1])


def _warnings(
    camera: MountedCamera,
    bad: Sequence[tuple[str, str]],
    total: int,
    bow_share: float,
    cells: BoolArray,
    count: int,
    declared: Declared,
) -> list[CalibrationWarning]:
    warnings = []
    if bad:
        message = f"{len(bad)} of {total} images do not agree with the others; take them again"
        warnings.append(CalibrationWarning("images_disagree", message, tuple(name for name, _ in bad)))
    assert camera.intrinsics_sigma is not None
    warnings += check_camera("", camera.model, camera.intrinsics_sigma, declared.field_deg)
    if bow_share > STRONG_WARP:
        message = f"the board is bowed by {100 * bow_share:.1f} % of its half size: mount it on something flat"
        warnings.append(CalibrationWarning("bowed_board", message))
    if count < LEAST_VIEWS:
        warnings.append(CalibrationWarning("few_images", f"only {count} images; take {LEAST_VIEWS} to 30"))
    if (covered := covered_share(cells, camera.model)) < ENOUGH_CELLS:
        message = f"the board covers {100 * covered:.0f} % of the image; distortion is extrapolated elsewhere"
        warnings.append(CalibrationWarning("coverage", message))
    return warnings


def camera_lines(result: CameraCalibration) -> list[str]:
    """The result as lines of text."""
    held = result.held_out_px
    camera, sigma = result.rig.left, result.rig.cameras[0].intrinsics_sigma
    assert sigma is not None
    lines = [
        f"images used            {len(result.used)}, rejected {len(result.rejected)}",
        f"held-out error         {'unknown' if held is None else f'{held:.3f} px (mean)'}",
        f"reprojection error     {result.rms_px:.3f} px",
        f"camera model           {camera.model}",
        f"focal length           {camera.K[0, 0]:.2f} ± {sigma[0]:.2f} px",
    ]
    lines += [f"rejected               {name}: {reason}" for name, reason in result.rejected]
    for warning in result.warnings:
        names = f" ({', '.join(warning.pairs)})" if warning.pairs else ""
        lines.append(f"warning                {warning.message}{names}")
    return [*lines, *(f"take next              {view}" for view in result.advice)]
