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
from lmkit.visualization.html import figure, grid, headline, listed, page
from lmkit.visualization.overlay import side_by_side

GOOD_EPIPOLAR_PX = 0.2
FAIR_EPIPOLAR_PX = 0.5
FAR_RATIO, MOST_NAMED = 12.0, 5  # over the median residual the loss leaves about 4 % of a corner's weight

_STATISTICS = ("corners", "mean x", "mean y", "std x", "std y", "median", "95 %", "largest")


def calibration_report(
    result: StereoCalibration, board: BoardSpec, images: Mapping[str, tuple[ByteArray, ByteArray]]
) -> str:
    """HTML report of a stereo calibration.

    Args:
        images: left and right image by pair name, of the pairs to show.
    """
    parts = [
        f"<p>{escape(str(board))}, {len(result.used)} pairs used, {len(result.rejected)} left out</p>",
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
    """Tone (``good``, ``fair``, ``poor``), headline and its reason; it follows the intervals, not the fit."""
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
        # A small error of the fit says nothing of what these views leave open.
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
        (
            "Held-out epipolar error (five folds), mean",
            "unknown" if held is None else f"{held.mean_epipolar_px:.3f} px",
        ),
        ("Held-out reprojection error, mean", "unknown" if held is None else f"{held.mean_reprojection_px:.3f} px"),
        ("Reprojection error of the fit, root mean square: both / left / right",
         f"{result.rms_px:.3f} / {result.rms_left_px:.3f} / {result.rms_right_px:.3f} px"),
        ("Baseline", f"{result.rig.baseline_m * 1000:.3f} ± {result.baseline_sigma_m * 1000:.3f} mm"),
        ("Bow of the board, along x / y", " / ".join(f"{w * 1000:.2f}" for w in result.solution.warp) + " mm"),
    ]  # fmt: skip
    if len(result.models) > 1:
        tried = ", ".join(f"{name} {error:.3f}" for name, error in result.models.items())
        rows.append(("Camera model (reprojection error on pairs held out)", f"{result.rig.models} ({tried})"))
    body = "".join(f"<tr><td>{a}</td><td class='n'>{escape(b)}</td></tr>" for a, b in rows)
    return f"<h2>Figures</h2><table>{body}</table>"


def _depth(result: StereoCalibration) -> str:
    rows = "".join(
        f"<tr><td class='n'>{e.depth_m:g} m</td><td class='n'>± {e.calibration_m * 1000:.1f} mm</td>"
        f"<td class='n'>± {e.total_m * 1000:.1f} mm</td></tr>"
        for e in result.depth_errors
    )
    note = (
        f"Standard deviations for a point straight ahead: from this calibration alone, and with corners matched to "
        f"{MATCHING_PX:g} px in each camera. A wrong square size is not in them: it scales every depth alike."
    )
    head = "<tr><th class='n'>depth</th><th class='n'>calibration</th><th class='n'>in all</th></tr>"
    return f"<h2>Depth error to expect</h2><table>{head}{rows}</table><p class='note'>{note}</p>"


def _coverage(result: StereoCalibration) -> str:
    c, sizes = result.coverage, (result.rig.left.image_size, result.rig.right.image_size)
    figures = [
        (
            plots.corner_cover(np.concatenate([getattr(v, side) for v in result.used]), c.cells[k], sizes[k], color),
            f"{side.capitalize()} camera: all corners; red: empty cells. {100 * c.filled(k):.0f}\u00a0% filled.",
        )
        for k, (side, color) in enumerate((("left", plots.LEFT), ("right", plots.RIGHT)))
    ]
    near, far = c.distances_m.min(), c.distances_m.max()
    figures.append(
        (
            plots.tilt_plot(c.tilts_deg, TILTED_DEG),
            f"Tilt of every view; dashed: less than {TILTED_DEG:g} deg, which tells little of the focal length. "
            f"Distances {near:.2f} to {far:.2f} m.",
        )
    )
    if c.advice:
        advice = (
            "<p><b>Take these views next:</b></p><ul>" + "".join(f"<li>{escape(a)}</li>" for a in c.advice) + "</ul>"
        )
    else:
        advice = "<p class='note'>The views cover the image, the tilts and the distances sufficiently.</p>"
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
    note = (
        "Standard deviation of a projected point, px, from the covariance of the intrinsics. "
        "Show the board where the value is large. Gray: the lens model is not valid there."
    )
    return (
        f"<h2>Projection uncertainty</h2><p class='note'>{note}</p>{plots.color_bar(largest)}{grid(figures, 'two')}"
    )


def _cameras(result: StereoCalibration) -> str:
    rig = result.rig
    assert rig.intrinsics_sigma is not None
    names = [("fx", "fy", "cx", "cy", *camera.lens.coefficients) for camera in (rig.left, rig.right)]
    columns = [
        (intrinsics_vector(camera), sigma)
        for camera, sigma in zip((rig.left, rig.right), rig.intrinsics_sigma, strict=True)
    ]
    rows = []
    for k in range(max(len(values) for values, _ in columns)):
        digits = 2 if k < 4 else 5
        cells = "".join(
            f"<td class='n'>{values[k]:.{digits}f}</td><td class='n'>± {sigma[k]:.{digits}f}</td>"
            if k < len(values)
            else "<td></td><td></td>"
            for values, sigma in columns
        )
        named = " / ".join(dict.fromkeys(known[k] for known in names if k < len(known)))
        rows.append(f"<tr><td>{named}</td>{cells}</tr>")
    sizes = ("{} x {}".format(*camera.image_size) for camera in (rig.left, rig.right))
    sides = "".join(
        f"<th class='n'>{side}</th><th>{size}</th>" for side, size in zip(("left", "right"), sizes, strict=True)
    )
    head = f"<tr><th>{escape(rig.models)}</th>{sides}</tr>"
    table = f"<h2>Cameras, pixels</h2><table>{head}{''.join(rows)}</table>"
    relation = np.zeros(6) if rig.covariance is None else np.sqrt(np.diag(rig.covariance))
    shift, rotation = rig.T_right_left.t * 1000, np.rad2deg(rig.T_right_left.rvec)
    lines = [
        (f"shift {axis}", f"{value:.3f}", f"± {sigma:.3f} mm")
        for axis, value, sigma in zip("xyz", shift, relation[:3] * 1000, strict=True)
    ] + [
        (f"rotation about {axis}", f"{value:.4f}", f"± {sigma:.4f} deg")
        for axis, value, sigma in zip("xyz", rotation, np.rad2deg(relation[3:]), strict=True)
    ]
    body = "".join(f"<tr><td>{a}</td><td class='n'>{b}</td><td class='n'>{c}</td></tr>" for a, b, c in lines)
    return f"{table}<h2>Left camera in the right camera's frame (T_right_left)</h2><table>{body}</table>"


def _residual_plots(result: StereoCalibration) -> str:
    left = np.concatenate([pair[0] for pair in result.residuals])
    right = np.concatenate([pair[1] for pair in result.residuals])
    at_left = np.concatenate([view.left for view in result.used])
    at_right = np.concatenate([view.right for view in result.used])
    left_size, right_size = result.rig.left.image_size, result.rig.right.image_size
    enlarged = f"{plots.ENLARGED} times enlarged. Neighbors of equal direction: the lens model does not fit."
    figures = [
        (
            plots.residual_scatter(left, right),
            "All residuals: left blue, right orange; half lie in the circle.",
        ),
        (
            plots.residual_histogram(left, right),
            "Histogram of both axes; dashed: normal curves of equal robust standard deviation.",
        ),
        (plots.residual_arrows(at_left, left, left_size, plots.LEFT), f"Left camera, {enlarged}"),
        (
            plots.residual_arrows(at_right, right, right_size, plots.RIGHT),
            f"Right camera, {enlarged}",
        ),
    ]
    rows = "".join(_statistics(name, values) for name, values in (("left", left), ("right", right)))
    head = "<tr><th>camera</th>" + "".join(
        f"<th class='n'>{name}</th>" for name in _STATISTICS
    ) + "</tr>"  # fmt: skip
    return f"<h2>Residuals</h2><table>{head}{rows}</table>{_far_corners(result)}{grid(figures, 'two')}"


def _far_corners(result: StereoCalibration) -> str:
    """Corners that hardly count in the fit because they lie far from it, the farthest first; nothing if none do."""
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
        f"<p class='note'>Corners more than {limit:.2f} px ({FAR_RATIO:g} times the median) from the fit, where the "
        f"robust loss gives them nearly no weight: {named}{more}.</p>"
    )


def _statistics(name: str, residuals: FloatArray) -> str:
    off = np.linalg.norm(residuals, axis=1)
    figures = [*residuals.mean(axis=0), *residuals.std(axis=0), np.median(off), np.percentile(off, 95), off.max()]
    # Adding zero leaves no "-0.000".
    cells = "".join(f"<td class='n'>{round(float(value), 3) + 0.0:.3f}</td>" for value in figures)
    return f"<tr><td>{name}, px</td><td class='n'>{len(residuals)}</td>{cells}</tr>"


def _space(result: StereoCalibration, board: BoardSpec) -> str:
    s = result.solution
    outlines = plots.board_outlines(board.object_points, s.rotations, s.translations)
    poses = [(np.eye(3), np.zeros(3)), (s.R, s.t)]
    drawing = plots.scene([s.left, s.right], poses, outlines, [view.name for view in result.used])
    caption = "The cameras (left blue, right orange), what they see, and every pair's board; from behind and above."
    return f"<h2>Cameras and boards in space</h2>{figure(drawing, caption)}"


def _pair_table(result: StereoCalibration) -> str:
    rows = []
    for view, (left, right) in zip(result.used, result.residuals, strict=True):
        rms = [np.sqrt(np.mean(np.sum(r**2, axis=1))) for r in (left, right)]
        rows.append(
            f"<tr><td>{escape(view.name)}</td><td class='n'>{len(view.left)}</td>"
            f"<td class='n'>{rms[0]:.3f}</td><td class='n'>{rms[1]:.3f}</td><td>used</td></tr>"
        )
    rows += [
        f"<tr><td>{escape(name)}</td><td></td><td></td><td></td><td>rejected: {escape(why)}</td></tr>"
        for name, why in result.rejected
    ]
    head = "<tr><th>pair</th><th>corners</th><th>left px</th><th>right px</th><th></th></tr>"
    return f"<h2>Pairs</h2><table>{head}{''.join(rows)}</table>"


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
