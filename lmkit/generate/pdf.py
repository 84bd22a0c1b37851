"""Pages -> vector PDF of exact size; the only room that knows reportlab."""

from __future__ import annotations

import io
from collections.abc import Iterable

from reportlab.pdfgen.canvas import Canvas

from lmkit.generate.artwork import Command, FilledPath
from lmkit.generate.page import Page, Text
from lmkit.model.palette import Rgb
from lmkit.units import POINTS_PER_MM
from lmkit.version import __version__


def pages_to_pdf(pages: Iterable[Page], title: str) -> bytes:
    """A PDF with one page each, the same bytes every time.

    Viewers are asked not to scale when printing (PDF 32000-1, table 150, PrintScaling).
    """
    buffer = io.BytesIO()
    canvas = Canvas(buffer, invariant=1, pageCompression=1, initialFontName="Helvetica")
    canvas.setTitle(title)
    canvas.setAuthor("lmkit")
    canvas.setCreator(f"lmkit {__version__}")
    canvas.setSubject("Print at 100 %, without scaling")
    canvas.setViewerPreference("PrintScaling", "None")
    for page in pages:
        width, height = (length * POINTS_PER_MM for length in page.size_mm)
        canvas.setPageSize((width, height))
        canvas.translate(0, height)
        canvas.scale(POINTS_PER_MM, -POINTS_PER_MM)
        for item in page.items:
            if isinstance(item, Text):
                _draw_text(canvas, item)
            else:
                _draw_path(canvas, item)
        canvas.showPage()
    canvas.save()
    return buffer.getvalue()


def _set_fill(canvas: Canvas, color: Rgb) -> None:
    canvas.setFillColorRGB(*(channel / 255 for channel in color))


def _draw_path(canvas: Canvas, shape: FilledPath) -> None:
    path = canvas.beginPath()
    for command in shape.commands:
        _add(path, command)
    _set_fill(canvas, shape.color)
    canvas.drawPath(path, stroke=0, fill=1, fillMode=0)


def _add(path: object, command: Command) -> None:
    name, points = command[0], command[1:]
    flat = [coordinate for point in points for coordinate in point]
    method = {"M": "moveTo", "L": "lineTo", "C": "curveTo", "Z": "close"}[name]
    getattr(path, method)(*flat)


def _draw_text(canvas: Canvas, text: Text) -> None:
    canvas.saveState()
    canvas.translate(*text.at)
    canvas.scale(1, -1)
    if text.vertical:
        canvas.rotate(90)
    _set_fill(canvas, text.color)
    canvas.setFont("Helvetica-Bold" if text.bold else "Helvetica", text.height_mm)
    draw = {"start": canvas.drawString, "middle": canvas.drawCentredString, "end": canvas.drawRightString}
    draw[text.anchor](0, 0, text.content)
    canvas.restoreState()
