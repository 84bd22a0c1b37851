"""Sanity checks of a calibration: warnings, and refusal of unsuitable data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.calibration.intrinsics import intrinsics_vector
from lmkit.calibration.outlier_pairs import Disagreement
from lmkit.calibration.view_coverage import ENOUGH_CELLS, LEAST_VIEWS, ViewCoverage
from lmkit.errors import InputError
from lmkit.geometry.camera import CameraModel
from lmkit.geometry.stereo_rig import StereoRig

# Two cameras that fit separately, but not together, are not a rigid pair.
RIGID_PX = 1.0
RIGID_RATIO = 3.0
USELESS_PX = 2.0
LOOSE_RATIO = 2.0
WRONG_BASELINE = 0.02
WRONG_FIELD = 0.05
UNEQUAL_FOCALS = 0.03
ABSURD_SHARE = 0.01  # of the image's width; a pinhole camera for the corners of a fisheye lens errs by less
CENTRE_SHARE = 0.15
STRONG_WARP = 0.01  # bow over the board's half size
UNSURE_BASELINE = 0.005
BEYOND_MODEL = 0.02
UNSURE_FOCAL = 0.005
UNSURE_ROTATION_DEG = 0.2  # 3 px of disparity at a focal length of 900 px
CONTRADICTED_SIGMAS = 4.0
UNSURE_CENTRE = 0.005  # of the image's width
RESTS_ON_LENSES = ("rests_on_lenses", "lenses_kept")  # whose error is not in the standard deviations
UNDETERMINED = ("unsure_rotation", "unsure_principal_point", "unsure_focal", "unsure_baseline")


@dataclass(frozen=True)
class CalibrationWarning:
    """A warning about a calibration.

    Attributes:
        code: short stable name.
        message: the problem, and what to do.
        pairs: names of the pairs concerned.
    """

    code: str
    message: str
    pairs: tuple[str, ...] = ()


@dataclass(frozen=True)
class Declared:
    """Values that the user declares beforehand, to check against; None if not declared.

    Attributes:
        baseline_m: distance of the cameras.
        field_deg: horizontal field of view, of one camera.
        cameras: left and right camera with known intrinsics, which are kept as they are.
        covariances: of fx fy cx cy and the distortion of each camera; then they are a prior, and fitted as well.
    """

    baseline_m: float | None = None
    field_deg: float | None = None
    cameras: tuple[CameraModel, CameraModel] | None = None
    covariances: tuple[FloatArray, FloatArray] | None = None


def require_rigid(together_px: float, alone_px: float, row_error_px: float | None) -> None:
    """Refuse cameras that move relative to each other.

    Args:
        together_px, alone_px: median reprojection error of the pairs in the joint fit, and of each camera alone.
        row_error_px: of held-out pairs, if known.

    Raises:
        InputError: they are not a rigid, synchronized pair.
    """
    apart = together_px > max(RIGID_PX, RIGID_RATIO * alone_px)
    useless = row_error_px is not None and row_error_px > max(USELESS_PX, RIGID_RATIO * alone_px)
    if apart or useless:
        rows = "" if row_error_px is None else f" (the held-out row error is {row_error_px:.1f} px)"
        raise InputError(
            "not_rigid",
            f"each camera alone explains its images to {alone_px:.2f} px, both together only to {together_px:.2f} px"
            f"{rows}: images of a pair are not taken at the same time, or the cameras move relative to each other",
            "synchronize the cameras, or hold the board still for every pair; fasten the rig; check the file pairs",
        )


def require_explained(rms_px: float, image_size: tuple[int, int], model: str) -> None:
    """Refuse a camera that does not explain its own images.

    Args:
        rms_px: reprojection error of the fit.
        model: its lens model.

    Raises:
        InputError: the error is absurd.
    """
    if not rms_px <= ABSURD_SHARE * image_size[0]:
        raise InputError(
            "no_fit",
            f"the best {model} camera misses the corners by {rms_px:.0f} px",
            "take another --model (auto finds one), check the board specification, and take views with more tilt",
        )


def require_majority(bad: Sequence[Disagreement], total: int) -> None:
    """Refuse a set of pairs if half of them or more disagree.

    Raises:
        InputError: half of them or more disagree.
    """
    if 2 * len(bad) >= total:
        first = "; ".join(f"{d.pair}: {d.reason}" for d in bad[:2])
        raise InputError(
            "no_consensus",
            f"{len(bad)} of {total} pairs do not agree with the others on any rig ({first})",
            "check that left and right files pair up by sorted name, and that the rig and its lenses did not move",
        )


def check_calibration(
    rig: StereoRig,
    coverage: ViewCoverage,
    bad: Sequence[Disagreement],
    total: int,
    baseline_sigma_m: float,
    together_px: float,
    alone_px: float,
    bow_m: float,
    board_half_m: float,
    declared: Declared,
) -> list[CalibrationWarning]:
    """All warnings, the most important first.

    Args:
        rig: with its covariances.
        bad, total: the rejected pairs, and the number of all pairs.
        together_px, alone_px: see :func:`require_rigid`.
        bow_m, board_half_m: the board's bow and half its length.
    """
    warnings = []
    if bad:
        causes = "; ".join(_cause_in_words(cause, bad) for cause in dict.fromkeys(d.cause for d in bad))
        message = f"{len(bad)} of {total} pairs do not agree with the other pairs ({causes}); take them again"
        warnings.append(CalibrationWarning("pairs_disagree", message, tuple(sorted(d.pair for d in bad))))
    if together_px > LOOSE_RATIO * alone_px:
        message = (
            f"both cameras together fit {together_px / alone_px:.1f} times worse than each alone: the rig is not "
            "rigid, or the board moves while the cameras do not expose together (hold it still, or trigger them)"
        )
        warnings.append(CalibrationWarning("loose", message))
    warnings += check_known(rig, declared)
    warnings += _check_rotation(rig)
    warnings += _check_scale(rig, baseline_sigma_m, declared)
    for name, camera, sigma in zip(("left", "right"), (rig.left, rig.right), rig.intrinsics_sigma or (), strict=True):
        warnings += check_camera(name, camera, sigma, declared.field_deg)
    t = rig.T_right_left.t
    if abs(t[0]) > abs(t[1]) and t[0] > 0:
        message = "the right camera is to the left of the left camera: are LEFT and RIGHT swapped?"
        warnings.append(CalibrationWarning("swapped", message))
    if bow_m > STRONG_WARP * board_half_m:
        message = f"the board is bowed by {bow_m * 1000:.1f} mm: mount it on something flat"
        warnings.append(CalibrationWarning("bowed_board", message))
    if len(coverage.distances_m) < LEAST_VIEWS:
        message = f"only {len(coverage.distances_m)} pairs; take {LEAST_VIEWS} to 30"
        warnings.append(CalibrationWarning("few_pairs", message))
    for index, name in enumerate(("left", "right")):
        if (filled := coverage.filled(index)) < ENOUGH_CELLS:
            message = (
                f"the board covers {100 * filled:.0f} % of the {name} image; distortion is extrapolated elsewhere"
            )
            warnings.append(CalibrationWarning("coverage", message))
    return warnings


def _cause_in_words(cause: str, bad: Sequence[Disagreement]) -> str:
    names = ", ".join(d.pair for d in bad if d.cause == cause)
    words = {
        "swapped": "images swapped between pairs",
        "moved": "the rig was moved",
        "blur": "blurred",
        "distorted": "no flat board in one camera",
        "residual": "corners that do not fit",
        "other_time": "images taken at different times",
    }
    return f"{words[cause]}: {names}"


def _check_scale(rig: StereoRig, baseline_sigma_m: float, declared: Declared) -> list[CalibrationWarning]:
    baseline = rig.baseline_m
    if declared.baseline_m is not None:
        ratio = baseline / declared.baseline_m
        if abs(ratio - 1) > WRONG_BASELINE + 3 * baseline_sigma_m / baseline:
            message = (
                f"the baseline is estimated as {baseline * 1000:.1f} mm, {ratio:.3f} times the "
                f"{declared.baseline_m * 1000:g} mm declared, and so are all depths; measure the board (--measured)"
            )
            return [CalibrationWarning("scale", message)]
    if baseline_sigma_m > UNSURE_BASELINE * baseline:
        message = (
            f"the standard deviation of the baseline, and of every depth, is "
            f"{100 * baseline_sigma_m / baseline:.1f} %; take nearer and more tilted views"
        )
        return [CalibrationWarning("unsure_baseline", message)]
    return []


def check_known(rig: StereoRig, declared: Declared) -> list[CalibrationWarning]:
    """Warnings about known lenses that the images contradict.

    Args:
        rig: with fitted lenses.
        declared: the known lenses with their covariances; those of the fit if the lenses were fixed.
    """
    if declared.cameras is None or declared.covariances is None:
        return []
    warnings = []
    sides = zip(("left", "right"), (rig.left, rig.right), declared.cameras, declared.covariances, strict=True)
    for name, found, known, covariance in sides:
        off = np.abs(intrinsics_vector(found) - intrinsics_vector(known)) / np.sqrt(np.diag(covariance))
        worst = int(np.argmax(off))
        if off[worst] > CONTRADICTED_SIGMAS:
            number = ("fx", "fy", "cx", "cy")[worst] if worst < 4 else f"distortion coefficient {worst - 3}"
            message = (
                f"the images contradict the {name} camera of --intrinsics: {number} is off by "
                f"{off[worst]:.1f} standard deviations; is it the same lens, focus and image size?"
            )
            warnings.append(CalibrationWarning("intrinsics_contradicted", message))
    return warnings


def check_rests_on_lenses(freed: StereoRig) -> list[CalibrationWarning]:
    """Warning that the result depends on fixed lenses.

    Args:
        freed: rig of the same views with fitted lenses.
    """
    sigma_deg = _rotation_sigma_deg(freed)
    if sigma_deg <= UNSURE_ROTATION_DEG:
        message = (
            "the stated deviations are valid only if the lenses of --intrinsics are exact, which these images cannot "
            "show; give --intrinsics-sigma to include their error"
        )
        return [CalibrationWarning("lenses_kept", message)]
    message = (
        f"the views alone determine the rotation between the cameras to {sigma_deg:.1f} deg only: the stated "
        "deviations are valid only if the lenses of --intrinsics are exact; give --intrinsics-sigma to include "
        "their error"
    )
    return [CalibrationWarning("rests_on_lenses", message)]


def _rotation_sigma_deg(rig: StereoRig) -> float:
    """Largest standard deviation of the rotation about an axis, degrees; 0 where it is not known."""
    return 0.0 if rig.covariance is None else float(np.rad2deg(np.sqrt(np.diag(rig.covariance)[3:].max())))


def _check_rotation(rig: StereoRig) -> list[CalibrationWarning]:
    sigma_deg = _rotation_sigma_deg(rig)
    if sigma_deg <= UNSURE_ROTATION_DEG:
        return []
    message = (
        f"the rotation between the cameras is known to {sigma_deg:.1f} deg only (standard deviation): take views of "
        "the whole board at several distances and tilts, or calibrate each camera alone and give --intrinsics"
    )
    return [CalibrationWarning("unsure_rotation", message)]


def check_camera(
    name: str, camera: CameraModel, sigma: FloatArray, field_deg: float | None
) -> list[CalibrationWarning]:
    """Warnings about one camera.

    Args:
        name: of the camera, such as ``left``; empty for a single camera.
        sigma: standard deviations of fx fy cx cy and the distortion.
        field_deg: declared horizontal field of view.
    """
    which = f"the {name} camera" if name else "the camera"
    width, height = camera.image_size
    fx, fy, cx, cy = camera.K[0, 0], camera.K[1, 1], camera.K[0, 2], camera.K[1, 2]
    warnings = []
    field = horizontal_field_deg(camera)
    if field_deg is not None and field is not None and abs(field / field_deg - 1) > WRONG_FIELD:
        message = (
            f"the field of view of {which} is {field:.1f} deg, not the {field_deg:g} deg declared: "
            "images cropped or scaled, another lens, or a wrong calibration"
        )
        warnings.append(CalibrationWarning("field_of_view", message))
    if sigma[0] > UNSURE_FOCAL * fx:
        message = (
            f"{which}'s focal length is known to {100 * sigma[0] / fx:.1f} % only: "
            "take views with the board tilted by 30 to 45 deg, each edge nearer in turn"
        )
        warnings.append(CalibrationWarning("unsure_focal", message))
    if max(sigma[2:4]) > UNSURE_CENTRE * width:
        message = (
            f"{which}'s principal point is known to {max(sigma[2:4]):.0f} px only (standard deviation): "
            "take views of the whole board, tilted in both directions, at several distances"
        )
        warnings.append(CalibrationWarning("unsure_principal_point", message))
    if abs(fx / fy - 1) > UNEQUAL_FOCALS:
        message = f"focal lengths of {which} differ by {100 * abs(fx / fy - 1):.1f} %: images stretched?"
        warnings.append(CalibrationWarning("unequal_focals", message))
    if (ends := end_of_lens(camera, which)) is not None:
        warnings.append(CalibrationWarning("lens_ends", ends))
    if abs(cx - (width - 1) / 2) > CENTRE_SHARE * width or abs(cy - (height - 1) / 2) > CENTRE_SHARE * height:
        message = f"{which}'s principal point ({cx:.0f}, {cy:.0f}) is far from the image center: cropped images?"
        warnings.append(CalibrationWarning("principal_point", message))
    return warnings


def end_of_lens(camera: CameraModel, which: str) -> str | None:
    """Warning if a camera's distortion is not monotonic inside the image; None if it is.  ``which``: its name."""
    beyond = beyond_model(camera)
    if beyond <= BEYOND_MODEL:
        return None
    other = "pinhole" if camera.lens.is_equidistant else "fisheye"
    return (
        f"{which}'s distortion model is not valid over {100 * beyond:.0f} % of the image (it folds back there): "
        f"calibrate with the board in the image's corners, or with another lens model (--model {other})"
    )


def beyond_model(camera: CameraModel) -> float:
    """Share of the image, 0..1, beyond the radius up to which the distortion is monotonic.

    In every model, pixels of a wide fisheye lens 90 deg and more off its axis have no ray in front of the camera;
    these are not counted.
    """
    width, height = camera.image_size
    u, v = np.meshgrid(np.linspace(0, width - 1, 24), np.linspace(0, height - 1, 18))
    pixels = np.column_stack([u.ravel(), v.ravel()])
    return float((~camera.reaches(pixels) & camera.is_ahead(pixels)).mean())


def horizontal_field_deg(camera: CameraModel) -> float | None:
    """Horizontal field of view through the middle row; None if the model is not valid up to the edges."""
    width = camera.image_size[0]
    edges = np.array([[-0.5, camera.K[1, 2]], [width - 0.5, camera.K[1, 2]]])
    x = camera.unproject(edges)[:, 0]
    if not np.isfinite(x).all() or not x[0] < 0 < x[1]:
        return None
    return float(np.rad2deg(np.arctan(x[1]) - np.arctan(x[0])))


def require_views(count: int, rejected: Sequence[tuple[str, str]], least: int, what: str) -> None:
    """Refuse too few usable views.

    Args:
        count: usable ones.
        rejected: names and reasons of the others.
        least: how many are needed.
        what: ``images`` or ``pairs``.

    Raises:
        InputError: there are fewer; the first rejected one is named.
    """
    if count >= least:
        return
    first = f"; first rejected: {rejected[0][0]}: {rejected[0][1]}" if rejected else ""
    raise InputError(
        f"too_few_{what}",
        f"only {count} usable {what} of {count + len(rejected)}, at least {least} are needed{first}",
        f"check the board specification, take 10 to 30 {what} with the whole board sharp",
    )
