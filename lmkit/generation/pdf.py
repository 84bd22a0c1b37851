"""Vector PDF of pages in exact size; the only module that uses reportlab."""

from __future__ import annotations

import io
from collections.abc import Iterable

from reportlab import rl_config
from reportlab.lib.colors import CMYKColorSep
from reportlab.pdfgen.canvas import Canvas
from reportlab.pdfgen.pathobject import PDFPathObject

from lmkit.generation.artwork import FilledPath
from lmkit.generation.page import Box, Page, Text
from lmkit.model.palette import BLACK, BLUE, RED, Rgb
from lmkit.units import POINTS_PER_MM
from lmkit.version import __version__

rl_config.useA85 = 0  # binary instead of ASCII85 streams: a fifth smaller, and reportlab's encoder is slow

# The usual process colors of the two inks; other colors are converted by the simple formula.
CMYK = {RED: (0.0, 1.0, 1.0, 0.0), BLUE: (1.0, 0.75, 0.0, 0.0), BLACK: (0.0, 0.0, 0.0, 1.0)}
Item = FilledPath | Text
CUT_CONTOUR = CMYKColorSep(0, 1, 0, 0, spotName="CutContour", density=1)


def pages_to_pdf(pages: Iterable[Page], title: str, keywords: str = "", cmyk: bool = False) -> bytes:
    """A PDF with one page each, the same bytes every time.

    Viewers are asked not to scale when printing (PDF 32000-1, table 150, PrintScaling).

    Args:
        keywords: written into the document's metadata.
        cmyk: inks as process colors instead of RGB.
    """
    buffer = io.BytesIO()
    canvas = Canvas(buffer, invariant=1, pageCompression=1, initialFontName="Helvetica")
    canvas.setTitle(title)
    canvas.setAuthor("lmkit")
    canvas.setCreator(f"lmkit {__version__}")
    canvas.setSubject("Print at 100 %, without scaling")
    canvas.setKeywords(keywords)
    canvas.setViewerPreference("PrintScaling", "None")
    drawn: dict[Item, list[str]] = {}
    for page in pages:
        width, height = (length * POINTS_PER_MM for length in page.size_mm)
        canvas.setPageSize((width, height))
        canvas.translate(0, height)
        canvas.scale(POINTS_PER_MM, -POINTS_PER_MM)
        # The page's center does not move.
        (x0, y0), (x1, y1) = page.on_paper((0.0, 0.0)), page.on_paper((1.0, 1.0))
        canvas.transform(x1 - x0, 0, 0, y1 - y0, x0, y0)
        if page.window is not None:
            canvas.saveState()
            _clip(canvas, page.window)
            for shape in page.windowed:
                _draw(canvas, shape, cmyk, drawn)
            canvas.restoreState()
        for item in page.items:
            _draw(canvas, item, cmyk, drawn)
        canvas.showPage()
    canvas.save()
    return buffer.getvalue()


def _draw(canvas: Canvas, item: Item, cmyk: bool, drawn: dict[Item, list[str]]) -> None:
    """Draw an item, or reuse its earlier drawing: sheets of a set share rulers, marks and most texts.

    A line in a spot color is drawn again on each page, which adds the color to the page's resources.
    """
    known = None if is_spot_color(item) else drawn.get(item)
    if known is not None:
        canvas._code.extend(known)
        return
    first = len(canvas._code)
    if isinstance(item, Text):
        _draw_text(canvas, item, cmyk)
    else:
        _draw_path(canvas, item, cmyk)
    drawn[item] = canvas._code[first:]


def is_spot_color(item: Item) -> bool:
    """True for the line that a cutting plotter follows, which is drawn in the spot color ``CutContour``."""
    return isinstance(item, FilledPath) and item.role == "cut"


def _clip(canvas: Canvas, window: Box) -> None:
    left, top, right, bottom = window
    path = canvas.beginPath()
    path.rect(left, top, right - left, bottom - top)
    canvas.clipPath(path, stroke=0, fill=0)


def _set_fill(canvas: Canvas, color: Rgb, cmyk: bool) -> None:
    r, g, b = (channel / 255 for channel in color)
    if not cmyk:
        canvas.setFillColorRGB(r, g, b)
        return
    k = 1 - max(r, g, b)
    plain = tuple((1 - channel - k) / max(1 - k, 1e-9) for channel in (r, g, b))
    canvas.setFillColorCMYK(*CMYK.get(color, (*plain, k)))


def _draw_path(canvas: Canvas, shape: FilledPath, cmyk: bool) -> None:
    path = PDFPathObject([])
    for name, *points in shape.commands:
        flat = [coordinate for point in points for coordinate in point]
        method = {"M": "moveTo", "L": "lineTo", "C": "curveTo", "Z": "close"}[name]
        getattr(path, method)(*flat)
    if is_spot_color(shape):
        canvas.setFillColor(CUT_CONTOUR)
    else:
        _set_fill(canvas, shape.color, cmyk)
    canvas.drawPath(path, stroke=0, fill=1, fillMode=0)


def _draw_text(canvas: Canvas, text: Text, cmyk: bool) -> None:
    canvas.saveState()
    canvas.translate(*text.at)
    canvas.scale(1, -1)
    canvas.rotate(text.rotation_deg)
    _set_fill(canvas, text.color, cmyk)
    canvas.setFont("Helvetica-Bold" if text.bold else "Helvetica", text.height_mm)
    draw = {"start": canvas.drawString, "middle": canvas.drawCentredString, "end": canvas.drawRightString}
    draw[text.anchor](0, 0, text.content)
    canvas.restoreState()
