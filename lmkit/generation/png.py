"""PNG of a page, with its resolution; rasterized from the PDF, so that all formats agree."""

from __future__ import annotations

import io

import pypdfium2
from PIL import Image

from lmkit.errors import InputError
from lmkit.generation.page import Page
from lmkit.generation.pdf import pages_to_pdf
from lmkit.units import MM_PER_INCH

MAX_PIXELS = 200_000_000


def page_to_image(page: Page, dpi: float) -> Image.Image:
    """An RGB image of the page; its size is the page's, rounded to whole pixels.

    Raises:
        InputError: the image would have more than ``MAX_PIXELS`` pixels.
    """
    width, height = (max(1, round(length / MM_PER_INCH * dpi)) for length in page.size_mm)
    if width * height > MAX_PIXELS:
        raise InputError(
            "image_too_large",
            f"{dpi:g} dpi would make an image of {width} x {height} pixels",
            "choose fewer dots per inch (--dpi), or write a PDF or SVG, which are exact at any size",
        )
    document = pypdfium2.PdfDocument(pages_to_pdf([page], page.title))
    try:
        # Twice the size, then box-averaged: pdfium's own anti-aliasing has few levels.
        bitmap = document[0].render(scale=2 * dpi / 72.0, rev_byteorder=True)
        image: Image.Image = bitmap.to_pil()
    finally:
        document.close()
    return image.resize((width, height), Image.Resampling.BOX)


def page_to_png(page: Page, dpi: float) -> bytes:
    """The bytes of a PNG file; see :func:`page_to_image`."""
    buffer = io.BytesIO()
    page_to_image(page, dpi).save(buffer, format="PNG", dpi=(dpi, dpi), optimize=False)
    return buffer.getvalue()
