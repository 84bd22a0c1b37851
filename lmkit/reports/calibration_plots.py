"""The drawings of the calibration report, as SVG text."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

import numpy as np

from lmkit.arrays import BoolArray, FloatArray
from lmkit.calibration.view_coverage import CELLS
from lmkit.geometry.camera import CameraModel
from lmkit.geometry.rotations import rotation_exp
from lmkit.visualization.html import GRAY, svg, svg_text

LEFT, RIGHT = "#2f6fde", "#e8833a"
ENLARGED = 100  # residual arrows
ARROWS = (
    f"Residuals, drawn {ENLARGED} times longer. If neighboring arrows point the same way, the lens model does not "
    "fit there: try another one (<code>--model</code>)."
)
UNCERTAINTY = (
    "<p class='note'>By how many pixels a projected point may be off (standard deviation), because the intrinsics "
    "are uncertain. Show the board where the value is large. Gray: the lens model is not valid there.</p>"
)
STATISTICS = (
    "px", "corners", "mean x", "mean y", "standard deviation x", "standard deviation y", "median length",
    "95 % are shorter than", "longest",
)  # fmt: skip
RESIDUAL = "<p class='note'>Residual: where a corner was detected, minus where the calibrated model expects it.</p>"
# Light to dark; readable in print and by the color-blind (a viridis of seven stops).
_RAMP = np.array(
    [[253, 231, 37], [144, 215, 67], [53, 183, 121], [33, 145, 140], [49, 104, 142], [68, 57, 131], [68, 1, 84]]
)


def residual_scatter(left: FloatArray, right: FloatArray) -> str:
    """(N,2) and (M,2) residuals of the two cameras as dots, with a circle around half of them."""
    reach = max(0.2, float(np.percentile(np.abs(np.concatenate([left, right])), 99.5)))
    dots = []
    for points, color in ((left, LEFT), (right, RIGHT)):
        step = max(1, len(points) // 2000)
        for x, y in np.clip(points[::step] / reach, -1, 1) * 95:
            dots.append(f"<circle cx='{x:.1f}' cy='{y:.1f}' r='.9' fill='{color}' fill-opacity='.55'/>")
    half = float(np.median(np.linalg.norm(np.concatenate([left, right]), axis=1)))
    radius = half / reach * 95
    ring = f"<circle r='{radius:.1f}' fill='none' stroke='currentColor' stroke-width='.8'/>"
    words = (
        svg_text(-95, 107, f"-{reach:.2f}", 8)
        + svg_text(95, 107, f"{reach:.2f} px", 8, "end")
        + svg_text(0, 107, f"circle: {half:.2f} px", 8, "middle")
    )
    axes = f"<path d='M-98-98H98V98H-98ZM-98 0H98M0-98V98' fill='none' stroke='{GRAY}' stroke-width='.4'/>"
    return svg((-100, -100, 200, 212), 320, "residuals", axes + "".join(dots) + ring + words)


def residual_arrows(at: FloatArray, residuals: FloatArray, size: tuple[int, int], color: str) -> str:
    """(N,2) residuals as arrows at (N,2) pixels, enlarged."""
    step = max(1, len(at) // 1500)
    lines = "".join(
        f"M{x:.1f} {y:.1f}l{dx:.1f} {dy:.1f}"
        for (x, y), (dx, dy) in zip(at[::step], residuals[::step] * ENLARGED, strict=True)
    )
    return _image(
        size, "residual field", f"<path d='{lines}' stroke='{color}' stroke-width='{size[0] / 450:.2f}' fill='none'/>"
    )


def residual_histogram(left: FloatArray, right: FloatArray) -> str:
    """Histogram of residuals (one coordinate each), with the normal curve of the same median absolute value."""
    reach = max(0.1, float(np.percentile(np.abs(np.concatenate([left, right])), 99)))
    edges = np.linspace(-reach, reach, 42)
    parts, peak = [], 1e-9
    curves = []
    for values, color in ((left.ravel(), LEFT), (right.ravel(), RIGHT)):
        density, _ = np.histogram(values, edges, density=True)
        sigma = float(np.median(np.abs(values))) / 0.6745
        at = np.linspace(-reach, reach, 81)
        normal = np.exp(-((at / max(sigma, 1e-9)) ** 2) / 2) / max(sigma, 1e-9) / np.sqrt(2 * np.pi)
        peak = max(peak, float(density.max()), float(normal.max()))
        curves.append((density, at, normal, color))
    for density, at, normal, color in curves:
        steps = np.repeat(edges, 2)[1:-1]
        heights = np.repeat(density, 2)
        outline = "L".join(f"{x / reach * 95:.1f} {-h / peak * 90:.1f}" for x, h in zip(steps, heights, strict=True))
        curve = "L".join(f"{x / reach * 95:.1f} {-h / peak * 90:.1f}" for x, h in zip(at, normal, strict=True))
        parts.append(f"<path d='M{outline}' fill='none' stroke='{color}'/>")
        parts.append(f"<path d='M{curve}' fill='none' stroke='{color}' stroke-width='.6' stroke-dasharray='2 2'/>")
    axis = f"<path d='M-95 0H95M0 0v-92' stroke='{GRAY}' stroke-width='.4'/>"
    labels = (
        svg_text(-95, 9, f"-{reach:.2f}", 8)
        + svg_text(95, 9, f"{reach:.2f} px", 8, "end")
        + svg_text(0, 9, "0", 8, "middle")
    )
    return svg((-100, -98, 200, 112), 320, "histogram of residuals", axis + labels + "".join(parts))


def heat_map(values: FloatArray, size: tuple[int, int], largest: float) -> str:
    """(R,C) values over the image as colors from 0 to ``largest``, with some of them as numbers."""
    rows, columns = values.shape
    width, height = size
    cells, figures = [], []
    for r in range(rows):
        for c in range(columns):
            known = np.isfinite(values[r, c])
            share = min(float(values[r, c]) / largest, 1.0) if known else 0.0
            x, y = c * width / columns, r * height / rows
            cells.append(
                f"<rect x='{x:.1f}' y='{y:.1f}' width='{width / columns + 0.6:.1f}' "
                f"height='{height / rows + 0.6:.1f}' fill='{_color(share) if known else GRAY}'/>"
            )
            if r % 4 == 1 and c % 5 == 2 and known:
                ink = "#000" if share < 0.55 else "#fff"
                figures.append(
                    f"<text x='{x + width / columns / 2:.1f}' y='{y + height / rows * 0.75:.1f}' fill='{ink}' "
                    f"font-size='{width / 28:.0f}' text-anchor='middle'>{values[r, c]:.2f}</text>"
                )
    return _image(size, "projection uncertainty", "".join(cells + figures))


def color_bar(largest: float) -> str:
    """Colors of `heat_map` from 0 to ``largest``, pixels."""
    steps = 70
    cells = "".join(
        f"<rect x='{3 * k}' y='0' width='3.3' height='12' fill='{_color(k / (steps - 1))}'/>" for k in range(steps)
    )
    words = svg_text(0, 24, "0 px", 10) + svg_text(3 * steps, 24, f"{largest:.2g} px and more", 10, "end")
    return svg((-2, -2, 3 * steps + 4, 30), 320, "colors", cells + words)


def corner_cover(points: FloatArray, cells: BoolArray, size: tuple[int, int], color: str) -> str:
    """(N,2) all corners seen by one camera, on the (5,5) cells of its image; empty cells are marked."""
    width, height = size
    marks = []
    for row, column in zip(*np.nonzero(~cells), strict=True):
        x, y = column * width / CELLS, row * height / CELLS
        marks.append(
            f"<rect x='{x:.1f}' y='{y:.1f}' width='{width / CELLS:.1f}' height='{height / CELLS:.1f}' "
            "fill='#cf222e' fill-opacity='.18'/>"
        )
    step = max(1, len(points) // 2500)
    radius = width / 320
    dots = "".join(
        f"<circle cx='{x:.0f}' cy='{y:.0f}' r='{radius:.1f}' fill='{color}' fill-opacity='.6'/>"
        for x, y in points[::step]
    )
    return _image(size, "corners seen", "".join(marks) + dots)


def tilt_plot(tilts_deg: FloatArray, tilted_deg: float) -> str:
    """(P,2) tilts of the views; views inside the square do not help to determine the focal length."""
    reach = max(50.0, float(np.abs(tilts_deg).max()) * 1.1 if len(tilts_deg) else 50.0)
    scale = 90 / reach
    inner = tilted_deg * scale
    dots = "".join(
        f"<circle cx='{x * scale:.1f}' cy='{y * scale:.1f}' r='2.6' fill='{LEFT}' fill-opacity='.8'/>"
        for x, y in tilts_deg
    )
    frame = (
        f"<path d='M-95 0H95M0-95V95' stroke='{GRAY}' stroke-width='.4'/>"
        f"<rect x='{-inner:.1f}' y='{-inner:.1f}' width='{2 * inner:.1f}' height='{2 * inner:.1f}' fill='none' "
        f"stroke='{GRAY}' stroke-dasharray='3 3' stroke-width='.7'/>"
    )
    # Beside the plot, where they cover no view.
    words = (
        svg_text(0, -100, "upper edge nearer", 8.5, "middle")
        + svg_text(0, 107, "lower edge nearer", 8.5, "middle")
        + svg_text(-98, 107, "\u2190 left edge", 8.5)
        + svg_text(98, 107, "right edge \u2192", 8.5, "end")
    )
    return svg((-100, -110, 200, 220), 300, "tilts of the board", frame + dots + words)


def board_outlines(object_points: FloatArray, rotations: FloatArray, translations: FloatArray) -> list[FloatArray]:
    """(4,3) corners of a board's outline, for `scene`, in each of its poses (K,3,3), (K,3).

    Args:
        object_points: (N,3) of the board.
    """
    low, high = object_points.min(axis=0), object_points.max(axis=0)
    rim = np.array([[low[0], low[1], 0], [high[0], low[1], 0], [high[0], high[1], 0], [low[0], high[1], 0]])
    return list(rim @ rotations.transpose(0, 2, 1) + translations[:, None])


def scene(
    models: Sequence[CameraModel],
    poses: Sequence[tuple[FloatArray, FloatArray]],
    outlines: Sequence[FloatArray],
    names: Sequence[str],
    colors: Sequence[str] = (LEFT, RIGHT),
) -> str:
    """The cameras and every board, seen from above behind the first camera.

    Args:
        poses: R, t of every camera: x_camera = R x_first + t.
        outlines: (4,3) meters in the first camera, of every board.
        names: of the boards.
        colors: of the cameras.
    """
    farthest = max(float(np.linalg.norm(t)) for _, t in poses)
    away = float(np.median([np.linalg.norm(outline.mean(axis=0)) for outline in outlines]))
    depth = max(away / 4, farthest / 2 if len(poses) == 2 else 0.0)
    cameras = [
        ((_frustum(model, depth) - t) @ R, color) for model, (R, t), color in zip(models, poses, colors, strict=False)
    ]
    # From behind, above and a little to the right.
    view = rotation_exp(np.array([0.5, 0.0, 0.0])) @ rotation_exp(np.array([0.0, -0.6, 0.0]))
    flat = [(points @ view.T)[:, :2] for points in [*outlines, *(points for points, _ in cameras)]]
    everything = np.concatenate(flat)
    low, high = everything.min(axis=0), everything.max(axis=0)
    scale = 1000 / float((high - low).max())
    margin = 30.0

    def place(points: FloatArray) -> list[str]:
        return [f"{x:.1f} {y:.1f}" for x, y in (points - low) * scale + margin]

    parts = []
    farthest_first = np.argsort([-outline[:, 2].mean() for outline in outlines])
    for corners, name in ((flat[k], names[k]) for k in farthest_first):
        path = "L".join(place(corners))
        parts.append(
            f"<path d='M{path}Z' fill='{GRAY}' fill-opacity='.13' stroke='{GRAY}' stroke-width='1.6'>"
            f"<title>{escape(name)}</title></path>"
        )
    for (_, color), corners in zip(cameras, flat[len(outlines) :], strict=True):
        apex, *rim = place(corners)
        rays = "".join(f"M{apex}L{corner}" for corner in rim)
        style = f"fill='{color}' fill-opacity='.15' stroke='{color}' stroke-width='2.5'"
        parts.append(f"<path d='{rays}M{'L'.join(rim)}Z' {style}/>")
    width, height = (high - low) * scale + 2 * margin
    return svg((0, 0, width, height), 900, "cameras and boards in space", "".join(parts))


def _frustum(camera: CameraModel, depth: float) -> FloatArray:
    """(5,3) the camera center and the corners of its field of view at ``depth``, in its own frame."""
    width, height = camera.image_size
    corners = np.array([[0, 0], [width - 1, 0], [width - 1, height - 1], [0, height - 1.0]])
    rays = camera.unproject(corners)
    # Very wide lenses: corners outside the model's range, or too far to the side to be drawn.
    rays = np.where(
        camera.reaches(corners)[:, None], np.clip(rays, -1.5, 1.5), 1.2 * np.sign(corners - corners.mean(axis=0))
    )
    return np.concatenate([np.zeros((1, 3)), np.column_stack([rays, np.ones(4)]) * depth])


def _color(share: float) -> str:
    at = share * (len(_RAMP) - 1)
    low = min(int(at), len(_RAMP) - 2)
    red, green, blue = (_RAMP[low] + (at - low) * (_RAMP[low + 1] - _RAMP[low])).round().astype(int)
    return f"#{red:02x}{green:02x}{blue:02x}"


def _image(size: tuple[int, int], label: str, body: str) -> str:
    width, height = size
    frame = f"<rect width='{width}' height='{height}' fill='none' stroke='{GRAY}' stroke-width='{width / 320:.1f}'/>"
    return svg((0, 0, width, height), 420, label, body + frame)
