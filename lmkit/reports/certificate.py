"""One PDF page per landmark: the headline, the image with the landmark marked, and every line with its grade."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import replace
from datetime import date

import numpy as np
from PIL import Image
from reportlab.lib.utils import ImageReader, simpleSplit
from reportlab.pdfgen.canvas import Canvas

from lmkit.units import POINTS_PER_MM
from lmkit.verification.prints import PrintedLandmark
from lmkit.version import __version__
from lmkit.visualization.overlay import draw_landmarks

WIDTH, HEIGHT = 210 * POINTS_PER_MM, 297 * POINTS_PER_MM
COLORS = {
    "A": (0.12, 0.53, 0.24),
    "B": (0.38, 0.6, 0.13),
    "C": (0.8, 0.6, 0.0),
    "D": (0.85, 0.4, 0.0),
    "F": (0.78, 0.1, 0.1),
    None: (0.5, 0.5, 0.5),
}
IMAGE_MM = 78.0
ADVICE_PT = 7.5


def certificate(prints: Sequence[PrintedLandmark], graded_on: date | None = None) -> bytes:
    """The PDF's bytes, the same every time.

    Args:
        graded_on: written on each page; None: no date.
    """
    buffer = io.BytesIO()
    canvas = Canvas(buffer, pagesize=(WIDTH, HEIGHT), invariant=1, pageCompression=1)
    canvas.setTitle("lmkit verify")
    canvas.setCreator(f"lmkit {__version__}")
    for item in prints:
        _page(canvas, item, graded_on)
        canvas.showPage()
    canvas.save()
    return buffer.getvalue()


def _page(canvas: Canvas, item: PrintedLandmark, graded_on: date | None) -> None:
    mm = POINTS_PER_MM
    canvas.setFillColorRGB(*COLORS[item.grade])
    canvas.roundRect(20 * mm, 247 * mm, 30 * mm, 30 * mm, 3 * mm, stroke=0, fill=1)
    canvas.setFillColorRGB(1, 1, 1)
    canvas.setFont("Helvetica-Bold", 64)
    canvas.drawCentredString(35 * mm, 254.2 * mm, item.grade)
    canvas.setFillColorRGB(0, 0, 0)
    canvas.setFont("Helvetica-Bold", 18)
    seen = item.observation
    canvas.drawString(56 * mm, 268 * mm, f"Landmark {seen.family}, code {seen.code}")
    canvas.setFont("Helvetica", 10)
    canvas.drawString(56 * mm, 261 * mm, _shortened(canvas, item.source, 130 * mm))
    worst = [line.name for line in item.lines if line.grade == item.grade]
    headline = "every measured line is A" if item.grade == "A" else f"decided by: {', '.join(worst)}"
    canvas.drawString(56 * mm, 255 * mm, _shortened(canvas, headline, 130 * mm))
    canvas.setFillColorRGB(0.4, 0.4, 0.4)
    canvas.drawString(56 * mm, 249 * mm, f"scale from: {item.scale_from or 'unknown'}")
    if graded_on is not None:
        canvas.drawRightString(190 * mm, 249 * mm, f"graded on {graded_on.isoformat()}")
    _draw_image(canvas, item)
    y = 154.0
    canvas.setStrokeColorRGB(0.8, 0.8, 0.8)
    for line in item.lines:
        canvas.setFillColorRGB(*COLORS[line.grade])
        canvas.setFont("Helvetica-Bold", 11)
        canvas.drawString(20 * mm, y * mm, line.grade or "-")
        canvas.setFillColorRGB(0, 0, 0)
        canvas.setFont("Helvetica", 9.5)
        canvas.drawString(28 * mm, y * mm, line.name)
        canvas.drawString(72 * mm, y * mm, _shortened(canvas, line.value, 50 * mm))
        canvas.setFillColorRGB(0.35, 0.35, 0.35)
        advice = simpleSplit(line.advice, "Helvetica", ADVICE_PT, 66 * mm)
        canvas.setFont("Helvetica", ADVICE_PT)
        for row, words in enumerate(advice):
            canvas.drawString(124 * mm, (y + 1.4 * (len(advice) - 1)) * mm - row * 1.1 * ADVICE_PT, words)
        canvas.line(20 * mm, (y - 2.2) * mm, 190 * mm, (y - 2.2) * mm)
        y -= 7.0
    canvas.setFont("Helvetica", 7.5)
    canvas.setFillColorRGB(0.4, 0.4, 0.4)
    words = (
        "Graded in the manner of ISO/IEC 15415, without a claim of compliance: the worst line decides. "
        f"lmkit {__version__}"
    )
    canvas.drawString(20 * mm, 16 * mm, words)


def _draw_image(canvas: Canvas, item: PrintedLandmark) -> None:
    """The surroundings of the landmark, with its corners marked."""
    mm = POINTS_PER_MM
    corners = item.observation.corners
    low, high = corners.min(axis=0), corners.max(axis=0)
    room = 0.3 * (high - low).max()
    height, width = item.image.shape[:2]
    x0, y0 = max(int(low[0] - room), 0), max(int(low[1] - room), 0)
    x1, y1 = min(int(high[0] + room), width), min(int(high[1] + room), height)
    shifted = replace(item.observation, corners=corners - [x0, y0])
    marked = draw_landmarks(np.ascontiguousarray(item.image[y0:y1, x0:x1]), [shifted])
    image = Image.fromarray(marked[:, :, ::-1].copy())
    image.thumbnail((900, 900))
    data = io.BytesIO()
    image.save(data, format="JPEG", quality=88)
    data.seek(0)
    scale = IMAGE_MM / max(image.size)
    size = (image.width * scale * mm, image.height * scale * mm)
    canvas.drawImage(ImageReader(data), 20 * mm, 240 * mm - size[1], *size)


def _shortened(canvas: Canvas, text: str, width: float, size: float = 9.5) -> str:
    """Text shortened to the width, with an ellipsis if some is missing."""
    if canvas.stringWidth(text, "Helvetica", size) <= width:
        return text
    kept = text
    while kept and canvas.stringWidth(f"{kept}…", "Helvetica", size) > width:
        kept = kept[:-1]
    return f"{kept.rstrip()}…"
