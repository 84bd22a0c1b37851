"""The round trip: rasterise what was printed, read it, measure it, compare it with what it says."""

from __future__ import annotations

import io
import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pypdfium2
from PIL import Image

from lmkit.arrays import ByteArray, FloatArray
from lmkit.detect.landmarks import DetectOptions, detect_landmarks
from lmkit.errors import InputError
from lmkit.formats.images import MAX_BYTES, decode_image
from lmkit.model.observation import LandmarkObservation
from lmkit.model.palette import linear_to_srgb, srgb_to_linear
from lmkit.units import MM_PER_INCH

PDF_DPI = 150.0
SIZE_TOLERANCE_MM = 0.5
LABEL = re.compile(r"lm\w* v\d+, (?P<size>[0-9.]+) mm")
CODE = re.compile(r"code (?P<code>\d+)")


@dataclass(frozen=True)
class PrintedLandmark:
    """One landmark read from a print.

    Attributes:
        source: file, and page for a PDF.
        code: what it reads as.
        side_mm: (width, height) of the red border's outer edges, or None where no resolution is known.
        stated_code, stated_mm: what the page's own label says, or None.
        problems: what does not agree, in words; empty for a good print.
    """

    source: str
    observation: LandmarkObservation
    side_mm: tuple[float, float] | None
    stated_code: int | None
    stated_mm: float | None
    problems: tuple[str, ...]


@dataclass(frozen=True)
class _Sheet:
    source: str
    image: ByteArray
    dpi: tuple[float, float] | None
    text: str


def verify_print(path: Path, options: DetectOptions | None = None) -> list[PrintedLandmark]:
    """Read all landmarks of a PDF or picture and compare them with what the file says.

    Raises:
        InputError: the file cannot be read.
    """
    return [found for sheet in _sheets(path) for found in _verify_sheet(sheet, options)]


def _sheets(path: Path) -> list[_Sheet]:
    try:
        if path.stat().st_size > MAX_BYTES:
            raise InputError("file_too_large", f"{path}: more than {MAX_BYTES >> 20} MiB", "split it")
        data = path.read_bytes()
    except OSError as error:
        raise InputError(
            "file_unreadable", f"cannot read {path}: {error.strerror}", "check the path and its permissions"
        ) from None
    if data.startswith(b"%PDF"):
        return _pdf_sheets(path, data)
    image = decode_image(data, str(path))
    with Image.open(io.BytesIO(data)) as picture:
        dpi = picture.info.get("dpi")
    known = dpi is not None and min(dpi) > 1
    return [_Sheet(str(path), image, (float(dpi[0]), float(dpi[1])) if known and dpi else None, "")]


def _pdf_sheets(path: Path, data: bytes) -> list[_Sheet]:
    try:
        document = pypdfium2.PdfDocument(data)
    except pypdfium2.PdfiumError as error:
        raise InputError("bad_pdf", f"{path}: not a PDF that can be read ({error})", "generate it again") from None
    sheets = []
    for number, page in enumerate(document):
        image, dpi = _raster(page)
        text = page.get_textpage().get_text_bounded()
        sheets.append(_Sheet(f"{path} page {number + 1}", image, dpi, text))
    document.close()
    return sheets


def _raster(page: pypdfium2.PdfPage) -> tuple[ByteArray, tuple[float, float]]:
    """The page near PDF_DPI, BGR, and its exact dots per inch in x and y; edges smoothed in linear light.

    The renderer smooths edges in code values, which makes dark shapes grow by a fraction of a pixel;
    drawing twice as fine and averaging light leaves half a fine pixel of that at most.
    """
    rgb = np.asarray(page.render(scale=2 * PDF_DPI / 72).to_pil().convert("RGB"))
    height, width = rgb.shape[0] // 2, rgb.shape[1] // 2
    light = srgb_to_linear(np.arange(256) / 255)[rgb[: 2 * height, : 2 * width]]
    mean = light.reshape(height, 2, width, 2, 3).mean(axis=(1, 3))
    # The page is drawn into whole pixels, which stretches it by up to one.
    points = page.get_size()
    dpi = (rgb.shape[1] / 2 / points[0] * 72, rgb.shape[0] / 2 / points[1] * 72)
    return np.ascontiguousarray(np.round(linear_to_srgb(mean) * 255).astype(np.uint8)[:, :, ::-1]), dpi


def _verify_sheet(sheet: _Sheet, options: DetectOptions | None) -> list[PrintedLandmark]:
    image, offset = _with_margin(sheet.image)
    options = options or DetectOptions()
    # Whoever wrote the resolution into the file was a scanner or a rasteriser, not a camera with a lens.
    options = replace(options, through_lens=sheet.dpi is None)
    found = []
    for observation in detect_landmarks(image, options):
        side = _side_mm(observation.corners, sheet.dpi)
        label, code = LABEL.search(sheet.text), CODE.search(sheet.text)
        stated_mm = float(label["size"]) if label else None
        stated_code = int(code["code"]) if code else None
        problems = []
        if stated_code is not None and stated_code != observation.code:
            problems.append(f"reads as code {observation.code}, but its label says {stated_code}")
        if stated_mm is not None and side is not None:
            off = max(abs(length - stated_mm) for length in side)
            if off > SIZE_TOLERANCE_MM:
                problems.append(f"measures {side[0]:.1f} x {side[1]:.1f} mm, but its label says {stated_mm:g} mm")
        moved = LandmarkObservation(
            observation.code,
            observation.corners - offset,
            observation.confidence,
            observation.margin,
            observation.family,
            observation.covariance,
        )
        found.append(PrintedLandmark(sheet.source, moved, side, stated_code, stated_mm, tuple(problems)))
    return found


def _with_margin(image: ByteArray) -> tuple[ByteArray, FloatArray]:
    """White around the page, as the wall's paper would be; a bare face has no margin of its own."""
    margin = max(16, round(0.08 * max(image.shape[:2])))
    padded = np.pad(image, ((margin, margin), (margin, margin), (0, 0)), constant_values=255)
    return padded, np.array([margin, margin], dtype=np.float64)


def _side_mm(corners: FloatArray, dpi: tuple[float, float] | None) -> tuple[float, float] | None:
    if dpi is None:
        return None
    inches = corners / np.array(dpi)
    sides = np.linalg.norm(np.roll(inches, -1, axis=0) - inches, axis=1) * MM_PER_INCH
    return float(sides[[0, 2]].mean()), float(sides[[1, 3]].mean())
