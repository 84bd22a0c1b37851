"""`calibrate_stereo`: a rig with its errors, from the corners of a board in stereo pairs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from lmkit.arrays import FloatArray
from lmkit.calibration.board_equations import POSE
from lmkit.calibration.bundle_adjustment import NEARBY, ROUGHLY, FitOptions, Solution, StereoProblem
from lmkit.calibration.cross_validation import FOLDS, HeldOut, hold_out
from lmkit.calibration.initialization import (
    AUTO,
    CameraStarts,
    Consensus,
    agreement_with,
    find_consensus,
    models_by_camera,
    start_solution,
)
from lmkit.calibration.intrinsics import KnownIntrinsics, intrinsics_vector, sigma_and_correlation
from lmkit.calibration.mono import calibrate_camera
from lmkit.calibration.outlier_pairs import Disagreement, explain_disagreements
from lmkit.calibration.sanity_checks import (
    CalibrationWarning,
    Declared,
    check_calibration,
    check_known,
    check_rests_on_lenses,
    require_explained,
    require_majority,
    require_rigid,
    require_views,
)
from lmkit.calibration.uncertainty import DepthError, depth_errors
from lmkit.calibration.view_coverage import ViewCoverage, coverage_of, visible_cells
from lmkit.errors import InputError
from lmkit.geometry.camera import CameraModel
from lmkit.geometry.lens_models import LENS_MODELS
from lmkit.geometry.pose import Pose
from lmkit.geometry.stereo_rig import StereoRig
from lmkit.model.board import BoardSpec
from lmkit.model.observation import BoardObservation, PairView
from lmkit.units import counted

MIN_PAIRS = 3
BAD_RMS_RATIO = 4.0
FIRST_STEPS, HOPELESS_RATIO = 12, 5.0  # first steps of a fit, and the ratio to the best error that then ends the fit
CAMERAS_KEPT = FitOptions(intrinsics=False)
Size = tuple[int, int]
FITS = 3 + FOLDS  # largest number per model: consensus, first fit, final fit, and one without each fold


def ignore_steps(done: int, total: int) -> None:
    """Progress callback that does nothing."""


@dataclass(frozen=True, eq=False)
class StereoCalibration:
    """A calibrated rig and the evidence for it.

    Attributes:
        rig: the result, with its covariances.
        solution: the same with the boards' poses, as fitted.
        held_out: errors on held-out pairs; None with fewer than five pairs.
        models: mean reprojection error on held-out pairs, px, of every camera model that was tried.
        rms_px, rms_left_px, rms_right_px: reprojection error of the fit.
        used: the pairs of the fit.
        residuals: per used pair, observed minus projected pixels, left (N,2) and right (M,2).
        rejected: (pair, reason).
        warnings: the most important first.
        baseline_sigma_m: standard deviation of the baseline.
        depth_errors: expected depth errors at some distances.
        coverage: coverage of the views, and the views to take next.
    """

    rig: StereoRig
    solution: Solution
    held_out: HeldOut | None
    models: dict[str, float]
    rms_px: float
    rms_left_px: float
    rms_right_px: float
    used: tuple[PairView, ...]
    residuals: tuple[tuple[FloatArray, FloatArray], ...]
    rejected: tuple[tuple[str, str], ...]
    warnings: tuple[CalibrationWarning, ...]
    baseline_sigma_m: float
    depth_errors: tuple[DepthError, ...]
    coverage: ViewCoverage

    @property
    def held_out_epipolar_px(self) -> float | None:
        """Mean difference in rows of held-out pairs after rectification, or None."""
        return None if self.held_out is None else self.held_out.mean_epipolar_px

    def __repr__(self) -> str:
        unseen = "" if self.held_out is None else f", held out {self.held_out.mean_reprojection_px:.3f} px"
        baseline, sigma = 1000 * self.rig.baseline_m, 1000 * self.baseline_sigma_m
        return (
            f"StereoCalibration({self.rig.models}, {len(self.used)} pairs, {self.rms_px:.3f} px{unseen}, "
            f"baseline {baseline:.2f} ± {sigma:.2f} mm, {counted(len(self.warnings), 'warning')})"
        )

    def to_dict(self) -> dict[str, Any]:
        """The result as JSON values; docs/formats.md lists the keys."""
        return {
            "rms_px": self.rms_px,
            "rms_left_px": self.rms_left_px,
            "rms_right_px": self.rms_right_px,
            "held_out_epipolar_px": self.held_out_epipolar_px,
            "held_out_reprojection_px": None if self.held_out is None else self.held_out.mean_reprojection_px,
            "baseline_m": self.rig.baseline_m,
            "baseline_sigma_m": self.baseline_sigma_m,
            "pairs_used": [view.name for view in self.used],
            "pairs_rejected": [{"pair": name, "reason": reason} for name, reason in self.rejected],
            "warnings": [{"code": w.code, "message": w.message, "pairs": list(w.pairs)} for w in self.warnings],
            "model": self.rig.left.model,
            "model_right": self.rig.right.model,
            "models": self.models,
            "depth_errors": [
                {"depth_m": e.depth_m, "calibration_m": e.calibration_m, "total_m": e.total_m}
                for e in self.depth_errors
            ],
            "coverage": {
                "left": self.coverage.filled(0),
                "right": self.coverage.filled(1),
                "next_views": list(self.coverage.advice),
            },
        }


def calibrate_stereo(
    views: Sequence[PairView],
    board: BoardSpec,
    image_size: Size,
    model: str = AUTO,
    rejected: Sequence[tuple[str, str]] = (),
    declared: Declared | None = None,
    on_step: Callable[[int, int], None] = ignore_steps,
    right_size: Size | None = None,
) -> StereoCalibration:
    """Calibrate a rig jointly from all pairs that agree with each other.

    Args:
        views: pairs in which both cameras see the board.
        image_size: (width, height) of the left camera.
        model: ``pinhole``, ``rational``, ``fisheye`` or ``radtan``; ``auto`` takes one of the first three,
            by the error on held-out pairs. Two names, separated by a comma, are the models of the left and right
            camera.
        rejected: pairs rejected earlier, with reasons; they are added to the result.
        declared: known values, to check against; its cameras are fixed, or with covariances a prior.
        on_step: called with the number of fits done and their largest number.
        right_size: (width, height) of the right camera; None: the left camera's. Cameras with images of unequal sizes
            have different lenses: ``auto`` chooses each camera's model by its own held-out images.

    Raises:
        InputError: too few pairs, they do not agree on any rig, or the two cameras are not a rigid pair.
    """
    require_views(len(views), rejected, MIN_PAIRS, "pairs")
    object_points = board.object_points
    known = declared.cameras if declared is not None else None
    sizes = image_size, right_size or image_size
    if known is None:
        fits = _fits(views, object_points, sizes, _model_pairs(views, board, sizes, model), rejected, on_step)
    else:
        _require_sizes(known, sizes)
        options = _known_lenses(known, declared.covariances if declared is not None else None)
        fits = {
            _name(known[0].model, known[1].model): _fit(
                views,
                object_points,
                known,
                find_consensus(object_points, views, *known),
                rejected,
                np.inf,
                options,
                on_step,
            )
        }
    best = _best(fits)
    kept = [views[k] for k in best.rows]
    turned_away = [*rejected, *((d.pair, d.reason) for d in best.bad)]
    require_majority(best.bad, len(views))
    require_views(len(kept), turned_away, MIN_PAIRS, "pairs")

    s = best.solution
    residuals = StereoProblem(object_points, kept).residuals(s)
    together = float(np.median([_rms(np.concatenate(pair)) for pair in residuals]))
    alone = best.alone_px
    require_explained(alone, sizes[0], s.left.model)
    require_rigid(together, alone, None if best.held_out is None else best.held_out.mean_epipolar_px)
    rig, baseline_sigma = _rig_of(s)
    visible = (visible_cells(s.left), visible_cells(s.right))
    coverage = coverage_of(kept, s.rotations, s.translations, *sizes, visible)
    half = float(np.ptp(object_points[:, :2], axis=0).max()) / 2
    warnings = check_calibration(
        rig,
        coverage,
        best.bad,
        len(views),
        baseline_sigma,
        together,
        alone,
        float(np.abs(s.warp).max()),
        half,
        declared or Declared(),
    )
    if declared is not None and known is not None and declared.covariances is None:
        warnings = [*_check_kept(declared, StereoProblem(object_points, kept), s), *warnings]
    left, right = (np.concatenate([pair[side] for pair in residuals]) for side in (0, 1))
    return StereoCalibration(
        rig=rig,
        solution=s,
        held_out=best.held_out,
        models={name: fit.held_out.mean_reprojection_px for name, fit in fits.items() if fit.held_out is not None},
        rms_px=_rms(np.concatenate([left, right])),
        rms_left_px=_rms(left),
        rms_right_px=_rms(right),
        used=tuple(kept),
        residuals=tuple(residuals),
        rejected=tuple(turned_away),
        warnings=tuple(warnings),
        baseline_sigma_m=baseline_sigma,
        depth_errors=depth_errors(s),
        coverage=coverage,
    )


def _known_lenses(
    cameras: tuple[CameraModel, CameraModel], covariances: tuple[FloatArray, FloatArray] | None
) -> FitOptions:
    """Fixed cameras, or cameras as a prior with covariances."""
    if covariances is None:
        return CAMERAS_KEPT
    mean = np.concatenate([intrinsics_vector(camera) for camera in cameras])
    return FitOptions(known=KnownIntrinsics(mean, block_diag(*covariances)))


def _check_kept(declared: Declared, problem: StereoProblem, s: Solution) -> list[CalibrationWarning]:
    """Warnings about fixed lenses, from a fit of the same images with free lenses."""
    freed, _ = _rig_of(problem.solve(s, FitOptions()))
    assert freed.intrinsics_sigma is not None
    left, right = (np.diag(sigma**2) for sigma in freed.intrinsics_sigma)
    return [*check_known(freed, replace(declared, covariances=(left, right))), *check_rests_on_lenses(freed)]


def _require_sizes(cameras: tuple[CameraModel, CameraModel], sizes: tuple[Size, Size]) -> None:
    for name, camera, size in zip(("left", "right"), cameras, sizes, strict=True):
        if tuple(camera.image_size) != tuple(size):
            (width, height), (w, h) = size, camera.image_size
            raise InputError(
                "other_image_size",
                f"the {name} camera of --intrinsics has images of {w} x {h}, these are {width} x {height}",
                "give the intrinsics of this image size",
            )


def _model_pairs(
    views: Sequence[PairView], board: BoardSpec, sizes: tuple[Size, Size], model: str
) -> list[tuple[str, str]]:
    """Lens models (left, right) to try; the same name twice if both cameras are of one kind."""
    left, right = models_by_camera(model, 2)
    if left == right and (left != AUTO or sizes[0] == sizes[1]):
        return [(name, name) for name in (LENS_MODELS if left == AUTO else (left,))]
    in_left = [(v.name, BoardObservation(v.ids_left, v.left, v.noise_left)) for v in views]
    in_right = [(v.name, BoardObservation(v.ids_right, v.right, v.noise_right)) for v in views]
    if left == AUTO:
        left = calibrate_camera(in_left, board, sizes[0]).rig.left.model
    if right == AUTO:
        right = calibrate_camera(in_right, board, sizes[1]).rig.left.model
    return [(left, right)]


def _name(left: str, right: str) -> str:
    """The lens models of both cameras in one word."""
    return left if left == right else f"{left},{right}"


@dataclass(frozen=True)
class _Fit:
    """One model fitted to the pairs that agree on it; ``alone_px`` is the median error of the single cameras."""

    rows: list[int]
    bad: list[Disagreement]
    alone_px: float
    solution: Solution
    held_out: HeldOut | None


def _fits(
    views: Sequence[PairView],
    object_points: FloatArray,
    sizes: tuple[Size, Size],
    models: Sequence[tuple[str, str]],
    rejected: Sequence[tuple[str, str]],
    on_step: Callable[[int, int], None],
) -> dict[str, _Fit]:
    """Every model that can be fitted.

    Raises:
        InputError: none can.
    """
    fits: dict[str, _Fit] = {}
    consensus: dict[tuple[bool, bool], Consensus] = {}
    failed: InputError | None = None
    in_left = CameraStarts(object_points, [(v.ids_left, v.left) for v in views], sizes[0])
    in_right = CameraStarts(object_points, [(v.ids_right, v.right) for v in views], sizes[1])
    for index, (model_left, model_right) in enumerate(models):

        def on_fit(done: int, _: int, before: int = index) -> None:
            on_step(before * FITS + done, FITS * len(models))

        on_fit(0, FITS)
        try:
            to_beat = min(
                (fit.held_out.mean_reprojection_px for fit in fits.values() if fit.held_out), default=np.inf
            )
            left, right = cameras = in_left.camera(model_left), in_right.camera(model_right)
            # Lens models of one kind start from the same camera.
            kinds = left.lens.is_equidistant, right.lens.is_equidistant
            if kinds not in consensus:
                consensus[kinds] = find_consensus(object_points, views, left, right)
            fit = _fit(views, object_points, cameras, consensus[kinds], rejected, to_beat, FitOptions(), on_fit)
            fits[_name(model_left, model_right)] = fit
        except InputError as error:
            failed = failed or error
        except np.linalg.LinAlgError:
            continue
    if not fits:
        raise failed or InputError("no_fit", "no rig explains the pairs", "take other views")
    return fits


def _best(fits: dict[str, _Fit]) -> _Fit:
    best, *others = fits.values()
    for other in others:
        if best.held_out is not None and other.held_out is not None:
            best = other if other.held_out.clearly_better_than(best.held_out) else best
    return best


def _fit(
    views: Sequence[PairView],
    object_points: FloatArray,
    cameras: tuple[CameraModel, CameraModel],
    consensus: Consensus,
    rejected: Sequence[tuple[str, str]],
    to_beat_px: float,
    options: FitOptions,
    on_step: Callable[[int, int], None],
) -> _Fit:
    """One model, fitted to the pairs that agree.

    Cross-validation is skipped if the error on the fitted pairs exceeds another model's error on held-out pairs.
    The fit stops early if its error after the first steps is far above that error.
    """
    on_step(1, FITS)
    rows = np.flatnonzero(consensus.agrees)
    require_views(len(rows), rejected, MIN_PAIRS, "pairs")
    problem = StereoProblem(object_points, [views[int(k)] for k in rows])
    solution = start_solution(consensus, rows, *cameras)
    flat = replace(options, warp=False, converged=ROUGHLY, covariance=False)
    if np.isfinite(to_beat_px):
        solution = problem.solve(solution, replace(flat, iterations=FIRST_STEPS))
        if problem.mean_error(solution) > HOPELESS_RATIO * to_beat_px:
            return _Fit(rows.tolist(), [], np.nan, solution, None)
    solution = problem.solve(problem.solve(solution, flat), replace(options, damping=NEARBY))
    rms = problem.rms(solution)
    good = rms <= BAD_RMS_RATIO * np.median(rms)
    residual_ratios = {
        int(k): float(ratio) for k, ratio in zip(rows[~good], rms[~good] / np.median(rms), strict=True)
    }
    if residual_ratios:
        rows = rows[good]
        problem = StereoProblem(object_points, [views[int(k)] for k in rows])
        solution = problem.solve(solution.with_poses(np.flatnonzero(good)), options)
    kept = rows.tolist()
    bad = sorted(set(range(len(views))) - set(kept))
    reasons: list[Disagreement] = []
    if bad:
        agreement = agreement_with(object_points, views, solution, kept)
        fair = BAD_RMS_RATIO * float(np.median(problem.rms(solution)))
        reasons = explain_disagreements(object_points, views, agreement, bad, residual_ratios, solution, fair)
    hopeless = problem.mean_error(solution) > to_beat_px
    on_step(FITS - FOLDS, FITS)
    held_out = None
    if not hopeless:
        held_out = hold_out(
            object_points, views, kept, solution, options, lambda fold: on_step(FITS - FOLDS + fold, FITS)
        )
    on_step(FITS, FITS)
    # Cameras that were fitted separately: in the joint fit, lenses change to compensate for a rig that is not rigid.
    alone_px = float(np.median([consensus.relations[k].rms_px for k in kept]))
    return _Fit(kept, reasons, alone_px, solution, held_out)


def _rig_of(s: Solution) -> tuple[StereoRig, float]:
    """The rig with its covariances, and the standard deviation of the baseline, meters."""
    assert s.covariance is not None
    nl, nr = len(intrinsics_vector(s.left)), len(intrinsics_vector(s.right))
    relation = s.covariance[nl + nr : nl + nr + POSE, nl + nr : nl + nr + POSE]
    # The solver's order is rotation, translation; a rig's is translation, rotation.
    order = [3, 4, 5, 0, 1, 2]
    relation = relation[np.ix_(order, order)]
    left, right = (sigma_and_correlation(s.covariance[k, k]) for k in (slice(nl), slice(nl, nl + nr)))
    rig = StereoRig(
        s.left,
        s.right,
        Pose("right", "left", s.R, s.t),
        covariance=relation,
        intrinsics_sigma=(left[0], right[0]),
        intrinsics_correlation=(left[1], right[1]),
    )
    direction = s.t / np.linalg.norm(s.t)
    return rig, float(np.sqrt(direction @ relation[:3, :3] @ direction))


def _rms(residuals: FloatArray) -> float:
    """Root mean square distance over points, as OpenCV reports it."""
    return float(np.sqrt(np.mean(np.sum(residuals**2, axis=1))))


def calibration_lines(result: StereoCalibration) -> list[str]:
    """The result as lines of text."""
    held = result.held_out_epipolar_px
    depths = ", ".join(f"{e.total_m * 1e3:.1f} mm at {e.depth_m:g} m" for e in result.depth_errors)
    lines = [
        f"pairs used             {len(result.used)}, rejected {len(result.rejected)}",
        f"held-out row error     {'unknown' if held is None else f'{held:.3f} px'}",
        f"reprojection error     {result.rms_px:.3f} px "
        f"(left {result.rms_left_px:.3f}, right {result.rms_right_px:.3f})",
        f"camera model           {result.rig.models}",
        f"baseline               {result.rig.baseline_m * 1e3:.3f} ± {result.baseline_sigma_m * 1e3:.3f} mm",
        f"expected depth error   ± {depths}",
    ]
    lines += [f"rejected               {name}: {reason}" for name, reason in result.rejected]
    for warning in result.warnings:
        names = f" ({', '.join(warning.pairs)})" if warning.pairs else ""
        lines.append(f"warning                {warning.message}{names}")
    lines += [f"take next              {view}" for view in result.coverage.advice]
    return lines
