"""The calibration report: one self-contained HTML file with its images."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from html import escape

import cv2
import numpy as np

from lmkit.arrays import ByteArray, FloatArray
from lmkit.calibration.intrinsics import intrinsics_vector
from lmkit.calibration.sanity_checks import RESTS_ON_LENSES, UNDETERMINED
from lmkit.calibration.stereo import StereoCalibration
from lmkit.calibration.uncertainty import MATCHING_PX, NEAR_M, projection_uncertainty
from lmkit.calibration.view_coverage import TILTED_DEG
from lmkit.geometry.rectification import rectification, rectify_pair, with_lines_across
from lmkit.model.board import BoardSpec
from lmkit.reports import calibration_plots as plots
from lmkit.visualization.html import columns_table, figure, grid, headline, listed, page, table
from lmkit.visualization.overlay import side_by_side

GOOD_EPIPOLAR_PX = 0.2
FAIR_EPIPOLAR_PX = 0.5
FAR_RATIO, MOST_NAMED = 12.0, 5  # ratio to the median residual: the loss leaves about 4 % of a corner's weight


def calibration_report(
    result: StereoCalibration, board: BoardSpec, images: Mapping[str, tuple[ByteArray, ByteArray]]
) -> str:
    """HTML report of a stereo calibration.

    Args:
        images: left and right image of the pairs to show, by pair name.
    """
    parts = [
        f"<p>{escape(str(board))}, {len(result.used)} pairs used, {len(result.rejected)} rejected</p>",
        headline(*calibration_summary(result)),
        listed("Warnings", [w.message for w in result.warnings]),
        _figures(result),
        _depth(result),
        _coverage(result),
        _residual_plots(result),
        _uncertainty(result),
        _cameras(result),
        _space(result, board),
        _pair_table(result),
    ]
    shown = [name for name in (view.name for view in result.used) if name in images]
    if shown:
        parts.append("<h2>A rectified pair</h2>")
        parts.append(_rectified(result, shown[0], images[shown[0]]))
        parts.append("<h2>Corners as detected</h2><div class='grid'>")
        parts += [_detections(result, name, images[name]) for name in shown]
        parts.append("</div>")
    return page("Stereo calibration", parts)


def calibration_summary(result: StereoCalibration) -> tuple[str, str, str]:
    """Tone (``good``, ``fair``, ``poor``), headline and its reason, from held-out errors and warnings."""
    error = result.held_out_epipolar_px
    if error is None:
        return (
            "poor",
            "Too few pairs to judge the calibration.",
            "The held-out error needs ten or more pairs. Take more pairs.",
        )
    size = f"Held-out epipolar error: {error:.3f} px (mean)"
    loose = [warning.message for warning in result.warnings if warning.code in UNDETERMINED]
    if loose:
        # A small error of the fit does not show which parameters these views leave undetermined.
        return "poor", "Not determined by these views.", f"{size}, but {loose[0]}."
    contradicted = [w.message for w in result.warnings if w.code == "intrinsics_contradicted"]
    if contradicted:
        return "poor", "The images contradict the known lenses.", f"{size}, but {contradicted[0]}."
    if error > FAIR_EPIPOLAR_PX:
        reason = f"{size}. Depths are unreliable. See the warnings and the pairs with large errors."
        return "poor", "Poor.", reason
    kept = [warning.message for warning in result.warnings if warning.code in RESTS_ON_LENSES]
    if kept:
        return "fair", "Only as good as the lenses given.", f"{size}, but {kept[0]}."
    doubts = len(result.warnings)
    if error <= GOOD_EPIPOLAR_PX and not doubts:
        return "good", "Good.", f"{size}. No warnings."
    if error <= GOOD_EPIPOLAR_PX:
        count = "1 warning" if doubts == 1 else f"{doubts} warnings"
        return "fair", f"Good fit, {count}.", f"{size}. Fix the causes of the warnings and calibrate again."
    return "fair", "Usable.", f"{size}. Sharp images of a flat board reach less than {GOOD_EPIPOLAR_PX} px."


def _figures(result: StereoCalibration) -> str:
    held = result.held_out
    rows = [
        ("Held-out epipolar (row) error, mean", "unknown" if held is None else f"{held.mean_epipolar_px:.3f} px"),
        ("Held-out reprojection error, mean", "unknown" if held is None else f"{held.mean_reprojection_px:.3f} px"),
        ("Reprojection error (RMS), both cameras", f"{result.rms_px:.3f} px"),
        ("Reprojection error (RMS), left", f"{result.rms_left_px:.3f} px"),
        ("Reprojection error (RMS), right", f"{result.rms_right_px:.3f} px"),
        ("Baseline", f"{result.rig.baseline_m * 1000:.3f} ± {result.baseline_sigma_m * 1000:.3f} mm"),
        ("Bow of the board along x / y", " / ".join(f"{w * 1000:.2f}" for w in result.solution.warp) + " mm"),
        ("Camera model", result.rig.models),
    ]
    if len(result.models) > 1:
        rows += [(f"Held-out error of the {name} model", f"{error:.3f} px") for name, error in result.models.items()]
    note = "Held out: measured on image pairs that the fit did not use (five folds). ± is one standard deviation."
    return f"<h2>Key numbers</h2>{table((), rows)}<p class='note'>{note}</p>"


def _depth(result: StereoCalibration) -> str:
    rows = [
        (f"{e.depth_m:g} m", f"± {e.calibration_m * 1000:.1f} mm", f"± {e.total_m * 1000:.1f} mm")
        for e in result.depth_errors
    ]
    note = (
        "Standard deviation for a point straight ahead: from the calibration alone, and together with matching "
        f"errors of {MATCHING_PX:g} px in each camera. A wrong square size is not included: it scales "
        "all depths alike."
    )
    head = ("depth", "calibration alone", "with matching")
    return f"<h2>Expected depth error</h2>{table(head, rows)}<p class='note'>{note}</p>"


def _coverage(result: StereoCalibration) -> str:
    c, sizes = result.coverage, (result.rig.left.image_size, result.rig.right.image_size)
    figures = [
        (
            plots.corner_cover(
                np.concatenate([getattr(v, side) for v in result.used]), c.cells[k] | ~c.visible[k], sizes[k], color
            ),
            f"{side.capitalize()} camera: corners of all pairs. Red: no corner there. "
            f"{100 * c.filled(k):.0f}\u00a0% of the image covered.",
        )
        for k, (side, color) in enumerate((("left", plots.LEFT), ("right", plots.RIGHT)))
    ]
    near, far = c.distances_m.min(), c.distances_m.max()
    figures.append(
        (
            plots.tilt_plot(c.tilts_deg, TILTED_DEG),
            f"Tilt of the board in every view. Inside the dashed square it is tilted by less than "
            f"{TILTED_DEG:g} deg: such views hardly determine the focal length. Distances {near:.2f} to {far:.2f} m.",
        )
    )
    if c.advice:
        advice = (
            "<p><b>Take these views next:</b></p><ul>" + "".join(f"<li>{escape(a)}</li>" for a in c.advice) + "</ul>"
        )
    else:
        advice = "<p class='note'>The views cover enough of the image, and enough tilts and distances.</p>"
    return f"<h2>Coverage</h2>{advice}{grid(figures)}"


def _uncertainty(result: StereoCalibration) -> str:
    s = result.solution
    assert s.covariance is not None
    nl, nr = len(intrinsics_vector(s.left)), len(intrinsics_vector(s.right))
    maps = [
        (side, depth, camera, projection_uncertainty(camera, s.covariance[at : at + count, at : at + count], depth))
        for side, camera, at, count in (("Left", s.left, 0, nl), ("Right", s.right, nl, nr))
        for depth in (NEAR_M, None)
    ]
    largest = max(float(np.nanpercentile(values, 90)) for *_, values in maps)
    figures = [
        (
            plots.heat_map(values, camera.image_size, largest),
            f"{side} camera, {'far away' if depth is None else f'at {depth:g} m'}: "
            f"{np.nanmin(values):.3f} to {np.nanmax(values):.3f} px.",
        )
        for side, depth, camera, values in maps
    ]
    note, bar = plots.UNCERTAINTY, plots.color_bar(largest)
    return f"<h2>Projection uncertainty</h2>{note}{bar}{grid(figures, 'two')}"


def _cameras(result: StereoCalibration) -> str:
    rig = result.rig
    assert rig.intrinsics_sigma is not None
    names = [("fx", "fy", "cx", "cy", *camera.lens.coefficients) for camera in (rig.left, rig.right)]
    columns = [
        (intrinsics_vector(camera), sigma)
        for camera, sigma in zip((rig.left, rig.right), rig.intrinsics_sigma, strict=True)
    ]
    rows = [("image size", *("{} x {}".format(*camera.image_size) for camera in (rig.left, rig.right)))]
    for k in range(max(len(values) for values, _ in columns)):
        digits = 2 if k < 4 else 5
        cells = [
            f"{values[k]:.{digits}f} ± {sigma[k]:.{digits}f}" if k < len(values) else "" for values, sigma in columns
        ]
        rows.append((" / ".join(dict.fromkeys(known[k] for known in names if k < len(known))), *cells))
    relation = np.zeros(6) if rig.covariance is None else np.sqrt(np.diag(rig.covariance))
    shift, rotation = rig.T_right_left.t * 1000, np.rad2deg(rig.T_right_left.rvec)
    pose = [
        (f"translation {axis}", f"{value:.3f} ± {sigma:.3f} mm")
        for axis, value, sigma in zip("xyz", shift, relation[:3] * 1000, strict=True)
    ] + [
        (f"rotation about {axis}", f"{value:.4f} ± {sigma:.4f} deg")
        for axis, value, sigma in zip("xyz", rotation, np.rad2deg(relation[3:]), strict=True)
    ]
    return (
        f"<h2>Cameras</h2>{table((rig.models, 'left, px', 'right, px'), rows)}"
        f"<h2>Pose of the left camera in the right camera's frame (T_right_left)</h2>{table((), pose)}"
    )


def _residual_plots(result: StereoCalibration) -> str:
    left = np.concatenate([pair[0] for pair in result.residuals])
    right = np.concatenate([pair[1] for pair in result.residuals])
    at_left = np.concatenate([view.left for view in result.used])
    at_right = np.concatenate([view.right for view in result.used])
    left_size, right_size = result.rig.left.image_size, result.rig.right.image_size
    figures = [
        (
            plots.residual_scatter(left, right),
            "All residuals, x and y. Left blue, right orange; half of them lie in the circle.",
        ),
        (
            plots.residual_histogram(left, right),
            "Histogram of x and y. Dashed: normal distribution with the same robust standard deviation.",
        ),
        (plots.residual_arrows(at_left, left, left_size, plots.LEFT), f"Left camera. {plots.ARROWS}"),
        (plots.residual_arrows(at_right, right, right_size, plots.RIGHT), f"Right camera. {plots.ARROWS}"),
    ]
    columns = [_statistics(name, values) for name, values in (("left", left), ("right", right))]
    numbers = columns_table(plots.STATISTICS, columns)
    return f"<h2>Residuals</h2>{plots.RESIDUAL}{numbers}{_far_corners(result)}{grid(figures, 'two')}"


def _far_corners(result: StereoCalibration) -> str:
    """Corners with little weight in the fit because of large residuals, the largest first; empty if none."""
    far = []
    for view, residuals in zip(result.used, result.residuals, strict=True):
        for side, at, off in zip(("left", "right"), (view.left, view.right), residuals, strict=True):
            far += [
                (float(size), f"{view.name}, {side} camera, at {x:.0f}, {y:.0f}")
                for size, (x, y) in zip(np.linalg.norm(off, axis=1), at, strict=True)
            ]
    limit = FAR_RATIO * float(np.median([size for size, _ in far]))
    far = sorted(((size, where) for size, where in far if size > limit), reverse=True)
    if not far:
        return ""
    named = "; ".join(f"{escape(where)}: {size:.2f} px" for size, where in far[:MOST_NAMED])
    more = f"; and {len(far) - MOST_NAMED} more" if len(far) > MOST_NAMED else ""
    return (
        f"<p class='note'>Outliers, more than {limit:.2f} px ({FAR_RATIO:g} times the median) from where the fit "
        f"expects them. The robust loss gives them almost no weight. {named}{more}.</p>"
    )


def _statistics(name: str, residuals: FloatArray) -> list[str]:
    off = np.linalg.norm(residuals, axis=1)
    figures = [*residuals.mean(axis=0), *residuals.std(axis=0), np.median(off), np.percentile(off, 95), off.max()]
    return [name, str(len(residuals)), *(f"{value:z.3f}" for value in figures)]


def _space(result: StereoCalibration, board: BoardSpec) -> str:
    s = result.solution
    outlines = plots.board_outlines(board.object_points, s.rotations, s.translations)
    poses = [(np.eye(3), np.zeros(3)), (s.R, s.t)]
    drawing = plots.scene([s.left, s.right], poses, outlines, [view.name for view in result.used])
    caption = (
        "The cameras (left blue, right orange) with their fields of view, and the board of every pair, seen from "
        "behind and above."
    )
    return f"<h2>Cameras and boards in space</h2>{figure(drawing, caption)}"


def _pair_table(result: StereoCalibration) -> str:
    rows = []
    for view, residuals in zip(result.used, result.residuals, strict=True):
        rms = (f"{np.sqrt(np.mean(np.sum(r**2, axis=1))):.3f}" for r in residuals)
        rows.append((view.name, str(len(view.left)), *rms))
    rejected = listed("Rejected pairs", [f"{name}: {why}" for name, why in result.rejected])
    note = "<p class='note'>Reprojection error of each pair, RMS.</p>"
    return f"<h2>Pairs</h2>{note}{table(('pair', 'corners', 'left, px', 'right, px'), rows)}{rejected}"


def _detections(result: StereoCalibration, name: str, images: tuple[ByteArray, ByteArray]) -> str:
    view = next(v for v in result.used if v.name == name)
    marked = []
    for image, points in zip(images, (view.left, view.right), strict=True):
        canvas = image.copy()
        # The circles stay visible after the image is scaled down to 560 px.
        radius, width = canvas.shape[1] / 110, max(1, round(canvas.shape[1] / 320))
        for k, (x, y) in enumerate(points):
            hue = int(150 * k / max(1, len(points) - 1))
            color = cv2.cvtColor(np.array([[[hue, 255, 255]]], dtype=np.uint8), cv2.COLOR_HSV2BGR)[0, 0]
            center = (round(float(x) * 16), round(float(y) * 16))
            cv2.circle(canvas, center, round(radius * 16), tuple(int(c) for c in color), width, cv2.LINE_AA, 4)
        marked.append(canvas)
    return figure(_img(side_by_side(*marked), 560), escape(name))


def _rectified(result: StereoCalibration, name: str, images: tuple[ByteArray, ByteArray]) -> str:
    both = with_lines_across(*rectify_pair(result.rig, *images), rectification(result.rig).along)
    caption = f"Pair {escape(name)}, rectified: matching points lie on the same line."
    return figure(_img(both, 1100), caption)


def _img(image: ByteArray, width: int) -> str:
    if image.shape[1] > width:
        size = (width, round(image.shape[0] * width / image.shape[1]))
        image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    _, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 80])
    text = base64.b64encode(bytes(data)).decode("ascii")
    return f"<img alt='' width='{image.shape[1]}' height='{image.shape[0]}' src='data:image/jpeg;base64,{text}'>"
