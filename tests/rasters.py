"""Two foreign rasterizers of PDF pages: pdfium, and poppler where it is installed."""

from __future__ import annotations

import io
import shutil
import subprocess

import numpy as np
import pypdfium2
import pytest
from PIL import Image


def by_pdfium(pdf: bytes, dpi: float, page: int = 0) -> np.ndarray:
    return np.asarray(pypdfium2.PdfDocument(pdf)[page].render(scale=dpi / 72).to_pil().convert("RGB"))


def by_poppler(pdf: bytes, dpi: float, page: int = 0) -> np.ndarray:
    if shutil.which("pdftoppm") is None:
        pytest.skip("pdftoppm (poppler-utils) is not installed")
    number = str(page + 1)
    command = ["pdftoppm", "-r", str(dpi), "-f", number, "-l", number, "-"]
    pixels = subprocess.run(command, input=pdf, check=True, capture_output=True).stdout
    return np.asarray(Image.open(io.BytesIO(pixels)).convert("RGB"))


BOTH = (by_pdfium, by_poppler)
