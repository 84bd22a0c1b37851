"""The calibration report: one HTML file with pictures, nothing fetched from anywhere."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from html import escape

import cv2
import numpy as np

from lmkit.arrays import ByteArray, FloatArray
from lmkit.calibrate.rectify import rectify_pair
from lmkit.calibrate.stereo import StereoCalibration
from lmkit.model.camera import CameraModel

GOOD_EPIPOLAR_PX = 0.2
FAIR_EPIPOLAR_PX = 0.5

_STYLE = """
:root { color-scheme: light dark; --line: #8884; --good: #1a7f37; --fair: #9a6700; --poor: #cf222e; }
body { font: 16px/1.5 system-ui, sans-serif; max-width: 60rem; margin: 2rem auto; padding: 0 1rem; }
h1 { font-size: 1.5rem; margin-bottom: 0; } h2 { font-size: 1.15rem; margin-top: 2.2rem; }
.verdict { border-left: 6px solid var(--tone); padding: .6rem 1rem; background: #8881; font-size: 1.1rem; }
table { border-collapse: collapse; } td, th { padding: .25rem .9rem .25rem 0; text-align: left; }
tr { border-bottom: 1px solid var(--line); } td.n { text-align: right; font-variant-numeric: tabular-nums; }
figure { margin: 1rem 0; } figcaption { font-size: .9rem; opacity: .8; } img, svg { max-width: 100%; height: auto; }
.grid { display: grid; grid-template-columns: repeat(auto-fill, minmax(17rem, 1fr)); gap: .8rem; }
"""


def calibration_report(
    result: StereoCalibration, board: str, pictures: Mapping[str, tuple[ByteArray, ByteArray]]
) -> str:
    """The report.

    Args:
        board: the board's specification.
        pictures: left and right picture by pair name, of the pairs to show.
    """
    tone, verdict = _verdict(result)
    parts = [
        "<!doctype html><html lang='en'><head><meta charset='utf-8'>",
        "<meta name='viewport' content='width=device-width,initial-scale=1'>",
        f"<title>Stereo calibration</title><style>{_STYLE}</style></head><body>",
        f"<h1>Stereo calibration</h1><p>{escape(board)}, {len(result.used)} pairs used</p>",
        f"<p class='verdict' style='--tone: var(--{tone})'>{escape(verdict)}</p>",
    ]
    if result.warnings:
        items = "".join(
            f"<li>{escape(w.message)}{': ' + escape(', '.join(w.pairs)) if w.pairs else ''}</li>"
            for w in result.warnings
        )
        parts.append(f"<h2>Warnings</h2><ul>{items}</ul>")
    parts += [_figures(result), _cameras(result), _residual_plots(result), _pair_table(result)]
    shown = [name for name in (view.name for view in result.used) if name in pictures]
    if shown:
        parts.append("<h2>Corners as detected</h2><div class='grid'>")
        parts += [_detections(result, name, pictures[name]) for name in shown]
        parts.append("</div><h2>A rectified pair</h2>")
        parts.append(_rectified(result, shown[0], pictures[shown[0]]))
    parts.append("</body></html>")
    return "\n".join(parts)


def _verdict(result: StereoCalibration) -> tuple[str, str]:
    error = result.held_out_epipolar_px
    if error is None:
        return (
            "poor",
            "Too few pairs to judge this calibration on pictures it has not seen. Take ten or more.",
        )
    size = f"Rows of unseen pairs match to {error:.3f} px on average"
    if error <= GOOD_EPIPOLAR_PX:
        return "good", f"Good. {size}."
    if error <= FAIR_EPIPOLAR_PX:
        return (
            "fair",
            f"Usable. {size}; below {GOOD_EPIPOLAR_PX} px is what sharp pictures of a flat board reach.",
        )
    return "poor", f"Poor. {size}; expect wrong depth. See the warnings and the pairs with large errors."


def _figures(result: StereoCalibration) -> str:
    held = "unknown" if result.held_out_epipolar_px is None else f"{result.held_out_epipolar_px:.3f} px"
    rows = [
        ("Mean row error of pairs held out (5 folds)", held),
        ("Reprojection error of the fit, both / left / right",
         f"{result.rms_px:.3f} / {result.rms_left_px:.3f} / {result.rms_right_px:.3f} px"),
        ("Baseline", f"{result.rig.baseline_m * 1000:.3f} ± {result.baseline_sigma_m * 1000:.3f} mm"),
        ("Bow of the board, along x / y", " / ".join(f"{w * 1000:.2f}" for w in result.solution.warp) + " mm"),
    ]  # fmt: skip
    body = "".join(f"<tr><td>{a}</td><td class='n'>{b}</td></tr>" for a, b in rows)
    return f"<h2>Figures</h2><table>{body}</table>"


def _cameras(result: StereoCalibration) -> str:
    def row(name: str, camera: CameraModel) -> str:
        K = camera.K
        values = [K[0, 0], K[1, 1], K[0, 2], K[1, 2]]
        cells = "".join(f"<td class='n'>{v:.2f}</td>" for v in values)
        distortion = ", ".join(f"{v:.4f}" for v in camera.distortion)
        return f"<tr><td>{name}</td><td>{camera.model}</td>{cells}<td>{distortion}</td></tr>"

    head = "<tr><th>eye</th><th>model</th><th>fx</th><th>fy</th><th>cx</th><th>cy</th><th>distortion</th></tr>"
    rig = result.rig
    return f"<h2>Cameras, pixels</h2><table>{head}{row('left', rig.left)}{row('right', rig.right)}</table>"


def _residual_plots(result: StereoCalibration) -> str:
    left = np.concatenate([pair[0] for pair in result.residuals])
    right = np.concatenate([pair[1] for pair in result.residuals])
    at_left = np.concatenate([view.left for view in result.used])
    at_right = np.concatenate([view.right for view in result.used])
    size = result.rig.left.image_size
    figures = (
        (_scatter(left, right), "All residuals, px (left blue, right orange)."),
        (_arrows(at_left, left, size), "Left eye, residuals 100 times enlarged."),
        (_arrows(at_right, right, size), "Right eye, the same."),
    )
    body = "".join(f"<figure>{plot}<figcaption>{text}</figcaption></figure>" for plot, text in figures)
    return f"<h2>Residuals</h2><div class='grid'>{body}</div>"


def _scatter(left: FloatArray, right: FloatArray) -> str:
    reach = max(0.2, float(np.percentile(np.abs(np.concatenate([left, right])), 99.5)))
    dots = []
    for points, color in ((left, "#2f6fde"), (right, "#e8833a")):
        for x, y in np.clip(points / reach, -1, 1) * 95:
            dots.append(f"<circle cx='{x:.1f}' cy='{y:.1f}' r='.9' fill='{color}' fill-opacity='.55'/>")
    return (
        "<svg viewBox='-100 -100 200 200' width='320' role='img' aria-label='residual scatter'>"
        "<path d='M-95 0H95M0-95V95' stroke='#888' stroke-width='.4'/>"
        f"<text x='94' y='-3' font-size='7' text-anchor='end' fill='#888'>{reach:.2f} px</text>{''.join(dots)}</svg>"
    )


def _arrows(at: FloatArray, residuals: FloatArray, size: tuple[int, int]) -> str:
    step = max(1, len(at) // 1500)
    lines = "".join(
        f"M{x:.1f} {y:.1f}l{dx:.1f} {dy:.1f}"
        for (x, y), (dx, dy) in zip(at[::step], residuals[::step] * 100, strict=True)
    )
    width, height = size
    return (
        f"<svg viewBox='0 0 {width} {height}' width='320' role='img' aria-label='residual field'>"
        f"<rect width='{width}' height='{height}' fill='none' stroke='#888'/>"
        f"<path d='{lines}' stroke='#2f6fde' stroke-width='{width / 450:.2f}' fill='none'/></svg>"
    )


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


def _detections(result: StereoCalibration, name: str, pictures: tuple[ByteArray, ByteArray]) -> str:
    view = next(v for v in result.used if v.name == name)
    marked = []
    for image, points in zip(pictures, (view.left, view.right), strict=True):
        canvas = image.copy()
        for k, (x, y) in enumerate(points):
            hue = int(150 * k / max(1, len(points) - 1))
            color = cv2.cvtColor(np.array([[[hue, 255, 255]]], dtype=np.uint8), cv2.COLOR_HSV2BGR)[0, 0]
            centre = (round(float(x) * 16), round(float(y) * 16))
            cv2.circle(canvas, centre, 64, tuple(int(c) for c in color), 1, cv2.LINE_AA, 4)
        marked.append(canvas)
    return f"<figure>{_img(np.hstack(marked), 560)}<figcaption>{escape(name)}</figcaption></figure>"


def _rectified(result: StereoCalibration, name: str, pictures: tuple[ByteArray, ByteArray]) -> str:
    both = np.hstack(rectify_pair(result.rig, *pictures))
    for y in range(20, both.shape[0], 40):
        cv2.line(both, (0, y), (both.shape[1], y), (80, 220, 60), 1)
    caption = f"Pair {escape(name)}, rectified: matching points lie on the same line."
    return f"<figure>{_img(both, 1100)}<figcaption>{caption}</figcaption></figure>"


def _img(image: ByteArray, width: int) -> str:
    if image.shape[1] > width:
        size = (width, round(image.shape[0] * width / image.shape[1]))
        image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    _, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 80])
    text = base64.b64encode(bytes(data)).decode("ascii")
    return f"<img alt='' width='{image.shape[1]}' height='{image.shape[0]}' src='data:image/jpeg;base64,{text}'>"
