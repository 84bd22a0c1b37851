"""The calibration report of one camera, or of three and more: one self-contained HTML file."""

from __future__ import annotations

from html import escape

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.calibration.intrinsics import intrinsics_vector
from lmkit.calibration.several_cameras import RigCalibration
from lmkit.calibration.uncertainty import NEAR_M, projection_uncertainty
from lmkit.calibration.view_coverage import visible_cells
from lmkit.geometry.rig import MountedCamera
from lmkit.model.board import BoardSpec
from lmkit.reports import calibration_plots as plots
from lmkit.units import counted
from lmkit.visualization.html import columns_table, figure, grid, headline, listed, page, table

COLORS = (plots.LEFT, plots.RIGHT, "#3a9d5d", "#a45ad0", "#c2417c", "#7a7a2a", "#2a9d9d", "#9d5a2a")
GOOD_PX, FAIR_PX = 0.2, 0.5
_INTRINSICS = ("fx", "fy", "cx", "cy")


def rig_calibration_report(result: RigCalibration, board: BoardSpec) -> str:
    """HTML report of a calibration of one camera, or of three and more."""
    several = len(result.rig.cameras) > 1
    warnings = [
        f"{mounted.name}: {warning.message}" if several else warning.message
        for mounted, camera in zip(result.rig.cameras, result.cameras, strict=True)
        for warning in camera.warnings
    ]
    parts = [
        f"<p>{escape(str(board))}, {counted(len(result.rig.cameras), 'camera')}, {len(result.frames)} frames</p>",
        headline(*rig_calibration_summary(result)),
        listed("Warnings", warnings),
        _cameras(result),
        *((_places(result), _ties(result)) if several else ()),
        _coverage(result),
        _residuals(result),
        _uncertainty(result),
        *(_intrinsics(mounted) for mounted in result.rig.cameras),
        _space(result, board),
        _frames(result),
    ]
    return page("Calibration of several cameras" if several else "Calibration of one camera", parts)


def rig_calibration_summary(result: RigCalibration) -> tuple[str, str, str]:
    """Tone (``good``, ``fair``, ``poor``), headline and its reason; the worst camera decides."""
    names = [mounted.name for mounted in result.rig.cameras]
    held = [camera.held_out_px for camera in result.cameras]
    few = [name for name, error in zip(names, held, strict=True) if error is None]
    if few:
        reason = f"The held-out error of {', '.join(few)} needs five or more images. Take more images."
        reason = reason if len(names) > 1 else "The held-out error needs five or more images. Take more images."
        return "poor", "Too few images to judge the calibration.", reason
    errors = [error for error in held if error is not None]
    worst = int(np.argmax(errors))
    whose = f"mean of the worst camera, {names[worst]}" if len(names) > 1 else "mean"
    size = f"Held-out reprojection error: {errors[worst]:.3f} px ({whose})"
    count = sum(len(camera.warnings) for camera in result.cameras)
    joint = int(np.argmax(np.array(result.rms_px) / [camera.rms_px for camera in result.cameras]))
    apart = result.rms_px[joint] / result.cameras[joint].rms_px
    if apart > 2.0:
        reason = (
            f"{size}, but {names[joint]} fits {apart:.1f} times worse beside the others than alone: did a camera "
            "move between the images, or were images of one name taken at different times? Hold the board still for "
            "every image, or trigger the cameras."
        )
        return "poor", "The cameras do not agree.", reason
    if errors[worst] > FAIR_PX:
        return "poor", "Poor.", f"{size}. See the warnings and the frames with large errors."
    if errors[worst] > GOOD_PX:
        return "fair", "Usable.", f"{size}. Sharp images of a flat board reach less than {GOOD_PX} px."
    if count:
        return (
            "fair",
            f"Good fit, {counted(count, 'warning')}.",
            f"{size}. Fix the causes of the warnings and calibrate again.",
        )
    return "good", "Good.", f"{size}. No warnings."


def _cameras(result: RigCalibration) -> str:
    rows, several = [], len(result.cameras) > 1
    for mounted, camera, rms_px in zip(result.rig.cameras, result.cameras, result.rms_px, strict=True):
        held = "unknown" if camera.held_out_px is None else f"{camera.held_out_px:.3f}"
        size = "{} x {}".format(*mounted.model.image_size)
        cells = [mounted.name, mounted.model.model, size, str(len(camera.used)), str(len(camera.rejected)), held]
        joint = [f"{rms_px:.3f}"] if several else []
        rows.append([*cells, f"{camera.rms_px:.3f}", *joint, f"{100 * camera.covered:.0f} %"])
    fits = ["error alone, px", "error together, px"] if several else ["error of the fit, px"]
    head = ["camera", "lens model", "image size", "images used", "rejected", "held-out error, px", *fits, "covered"]
    note = "Held-out error: mean reprojection error on images that the fit did not use."
    if several:
        note += " Alone: RMS of the camera fitted by itself. Together: RMS with all cameras in one rig."
    title = "Cameras" if several else "Camera"
    return f"<h2>{title}</h2>{columns_table(head, rows)}<p class='note'>{note}</p>"


def _places(result: RigCalibration) -> str:
    rows = []
    for mounted in result.rig.cameras[1:]:
        T = mounted.T_camera_left.inverse()
        sigma = np.zeros(6) if mounted.covariance is None else np.sqrt(np.diag(mounted.covariance))
        mm, deg = 1000 * float(np.linalg.norm(sigma[:3])), float(np.rad2deg(np.linalg.norm(sigma[3:])))
        angle = float(np.rad2deg(np.linalg.norm(T.rvec)))
        place = [f"{1000 * v:z.1f}" for v in T.t]
        rows.append([mounted.name, *place, f"{mm:.2f}", f"{angle:.2f}", f"{deg:.3f}"])
    first = escape(result.rig.cameras[0].name)
    note = f"In the frame of {first}: x right, y down, z forward. ±: standard deviation of all three axes together."
    head = ["camera", "x, mm", "y, mm", "z, mm", "±\u00a0mm", "rotation, deg", "±\u00a0deg"]
    return f"<h2>Camera positions</h2>{table(head, rows)}<p class='note'>{note}</p>"


def _ties(result: RigCalibration) -> str:
    rows = [[f"{a} - {b}", str(count), ", ".join(bad) or "none"] for a, b, count, bad in result.ties]
    return f"<h2>Pairs that link the cameras</h2>{table(['pair', 'common views', 'rejected'], rows)}"


def _coverage(result: RigCalibration) -> str:
    figures = [
        (
            plots.corner_cover(
                seen.pixels, camera.coverage | ~visible_cells(mounted.model), mounted.model.image_size, _color(k)
            ),
            f"{_of(mounted, result)}All corners. Red: no corner there. "
            f"{100 * camera.covered:.0f}\u00a0% of the image covered.",
        )
        for k, (mounted, camera, seen) in enumerate(
            zip(result.rig.cameras, result.cameras, result.corners, strict=True)
        )
    ]
    several = len(result.cameras) > 1
    advice = [
        f"<li>{escape(f'{mounted.name}: {text}' if several else text)}</li>"
        for mounted, camera in zip(result.rig.cameras, result.cameras, strict=True)
        for text in camera.advice
    ]
    words = f"<p><b>Take these views next:</b></p><ul>{''.join(advice)}</ul>" if advice else ""
    return f"<h2>Coverage</h2>{words}{grid(figures)}"


def _residuals(result: RigCalibration) -> str:
    rows, figures = [], []
    for k, (mounted, seen, off) in enumerate(zip(result.rig.cameras, result.corners, result.residuals, strict=True)):
        size = np.linalg.norm(off, axis=1)
        numbers = [*off.mean(axis=0), *off.std(axis=0), np.median(size), np.percentile(size, 95), size.max()]
        rows.append([mounted.name, str(len(off)), *(f"{value:z.3f}" for value in numbers)])
        drawing = plots.residual_arrows(seen.pixels, off, mounted.model.image_size, _color(k))
        figures.append((drawing, f"{_of(mounted, result)}{plots.ARROWS}"))
    return f"<h2>Residuals</h2>{plots.RESIDUAL}{columns_table(plots.STATISTICS, rows)}{grid(figures)}"


def _uncertainty(result: RigCalibration) -> str:
    s, maps, at = result.solution, [], 0
    assert s.covariance is not None
    for mounted in result.rig.cameras:
        count = len(intrinsics_vector(mounted.model))
        C = s.covariance[at : at + count, at : at + count]
        maps.append((mounted, projection_uncertainty(mounted.model, C, NEAR_M)))
        at += count
    largest = max(float(np.nanpercentile(values, 90)) for _, values in maps)
    figures = [
        (
            plots.heat_map(values, mounted.model.image_size, largest),
            f"{_of(mounted, result)}At {NEAR_M:g} m: {np.nanmin(values):.3f} to {np.nanmax(values):.3f} px.",
        )
        for mounted, values in maps
    ]
    note = plots.UNCERTAINTY
    bar = plots.color_bar(largest)
    return f"<h2>Projection uncertainty</h2>{note}{bar}{grid(figures)}"


def _intrinsics(mounted: MountedCamera) -> str:
    values, sigma = intrinsics_vector(mounted.model), mounted.intrinsics_sigma
    assert sigma is not None
    names = (*_INTRINSICS, *mounted.model.lens.coefficients)
    rows = []
    for k, (name, value, deviation) in enumerate(zip(names, values, sigma, strict=True)):
        digits = 2 if k < len(_INTRINSICS) else 5
        rows.append([name, f"{value:.{digits}f}", f"± {deviation:.{digits}f}"])
    return f"<h2>Lens of {escape(mounted.name)}, pixels</h2>{table([mounted.model.model, '', ''], rows)}"


def _space(result: RigCalibration, board: BoardSpec) -> str:
    s = result.solution
    outlines = plots.board_outlines(board.object_points, s.rotations, s.translations)
    colors = [_color(k) for k in range(len(s.models))]
    drawing = plots.scene(s.models, list(zip(s.R, s.t, strict=True)), outlines, result.frames, colors)
    names = ", ".join(
        f"<span style='color:{color}'>{escape(mounted.name)}</span>"
        for color, mounted in zip(colors, result.rig.cameras, strict=True)
    )
    several = len(s.models) > 1
    who, views = ("cameras", "their fields of view") if several else ("camera", "its field of view")
    caption = f"The {who} ({names}) with {views}, and the board of every frame, seen from behind and above."
    return f"<h2>{who.capitalize()} and boards in space</h2>{figure(drawing, caption)}"


def _frames(result: RigCalibration) -> str:
    by_camera = [
        [_rms(part) for part in seen.per_pair(off)]
        for seen, off in zip(result.corners, result.residuals, strict=True)
    ]
    rows = [[name, *cells] for name, *cells in zip(result.frames, *by_camera, strict=True)]
    head = ["frame, RMS px", *(mounted.name for mounted in result.rig.cameras)]
    lost = [
        f"{mounted.name}: {name} ({reason})"
        for mounted, camera in zip(result.rig.cameras, result.cameras, strict=True)
        for name, reason in camera.rejected
    ]
    return f"<h2>Frames</h2>{table(head, rows)}{listed('Rejected images', lost)}"


def _of(mounted: MountedCamera, result: RigCalibration) -> str:
    """Start of a caption: name of the camera, if there are several."""
    return f"{escape(mounted.name)}. " if len(result.rig.cameras) > 1 else ""


def _rms(off: FloatArray) -> str:
    return f"{np.sqrt((off**2).sum(axis=1).mean()):.3f}" if len(off) else ""


def _color(camera: int) -> str:
    return COLORS[camera % len(COLORS)]
