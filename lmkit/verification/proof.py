"""Verification before a print is written: every page is drawn by pdfium, every landmark read and measured.

Sheets of a tiled landmark are joined first, as the user will glue them.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import pypdfium2

from lmkit.arrays import ByteArray, FloatArray
from lmkit.detection.read_marker import read_marker_at
from lmkit.errors import LmkitError
from lmkit.generation.page import Page, PrintedFace
from lmkit.parallel import map_in_processes
from lmkit.units import MM_PER_INCH
from lmkit.verification.raster import raster_page

SIDE_PX = 64.0  # of a landmark in the proof's images
MOST_PX = 3000.0  # of a page's longer side
FINER = 6
TOLERANCE = 0.003  # of the side, for every corner
PAPER_WHITE = 235
WORTH_PROCESSES = 400  # pages; starting worker processes takes a second, a page a few milliseconds
CHUNKS = 16


@dataclass(frozen=True)
class _Job:
    """Pages that are verified together: one, or the sheets of a tiled landmark."""

    numbers: tuple[int, ...]
    pages: tuple[Page, ...]


def prove_pages(pdf: bytes, pages: Sequence[Page]) -> None:
    """Read every landmark of the PDF at its nominal place on the page.

    Raises:
        LmkitError: a landmark is not read, is not at its place, or its white margin is not white: an
            internal error; the file must not be printed.
    """
    jobs = [_Job((n,), (page,)) for n, page in enumerate(pages) if page.faces and page.window is None]
    tiles = [(n, page) for n, page in enumerate(pages) if page.window is not None]
    for code in dict.fromkeys(page.faces[0].code for _, page in tiles):
        some = [(n, page) for n, page in tiles if page.faces[0].code == code]
        jobs.append(_Job(tuple(n for n, _ in some), tuple(page for _, page in some)))
    work = partial(_first_problem, pdf)
    if len(jobs) < WORTH_PROCESSES:
        answers: Iterable[str | None] = [work(jobs)]
    else:
        answers = map_in_processes(work, [jobs[k::CHUNKS] for k in range(CHUNKS)])
    for problem in answers:
        if problem is not None:
            raise LmkitError("proof_failed", problem, "nothing was written; please report this with the command")


def _first_problem(pdf: bytes, jobs: Sequence[_Job]) -> str | None:
    """The first problem of these pages, or None."""
    document = pypdfium2.PdfDocument(pdf)
    try:
        for job in jobs:
            if problem := _problem(document, job):
                return f"page {job.numbers[0] + 1}: {problem}"
    finally:
        document.close()
    return None


def _problem(document: pypdfium2.PdfDocument, job: _Job) -> str | None:
    if job.pages[0].window is not None:
        return _tiles_problem(document, job)
    (page,) = job.pages
    smallest_mm = min(face.size_mm for face in page.faces)
    problem = None
    # Rounding to pixels can exceed the tolerance at one resolution; an error of the drawing exceeds it at both.
    for finer in (1, 2):
        image, per_mm = _raster(document, job.numbers[0], page, smallest_mm / finer)
        found = (_face_problem(image, per_mm, page, face) for face in page.faces)
        problem = next((problem for problem in found if problem), None)
        if problem is None:
            return None
    return problem


def _raster(document: pypdfium2.PdfDocument, number: int, page: Page, size_mm: float) -> tuple[ByteArray, FloatArray]:
    """Image of a page (without mirroring), and its pixels per mm in x and y."""
    dpi = min(SIDE_PX / size_mm, MOST_PX / max(page.size_mm)) * MM_PER_INCH
    image, exact = raster_page(document[number], dpi, FINER)
    if page.mirrored:
        image = np.ascontiguousarray(image[:, ::-1])
    return image, np.array(exact) / MM_PER_INCH


def _face_problem(image: ByteArray, per_mm: FloatArray, page: Page, face: PrintedFace) -> str | None:
    corners = _corners_mm(page, face) * per_mm - 0.5
    if page.mirrored:
        corners[:, 0] = image.shape[1] - 1 - corners[:, 0]
    # Extra white, for landmarks whose white margin ends at the paper's edge.
    pad = 40
    padded = np.pad(image, ((pad, pad), (pad, pad), (0, 0)), constant_values=255)
    side = float(np.linalg.norm(corners[1] - corners[0]))
    low = np.maximum(np.floor(corners.min(axis=0) - 0.08 * side).astype(int) + pad, 0)
    high = np.ceil(corners.max(axis=0) + 0.08 * side).astype(int) + pad
    part = np.ascontiguousarray(padded[low[1] : high[1], low[0] : high[0]])
    expected = corners + pad - low
    seen = read_marker_at(part, expected, face.family)
    name = f"code {face.code} of {face.family.name}"
    if seen is None or seen.rejected is not None:
        return f"{name} does not read ({'nothing there' if seen is None else seen.rejected})"
    if seen.decoding.code != face.code:
        return f"{name} reads as {seen.decoding.code}"
    off = float(np.abs(seen.corners - expected).max()) / side
    if off > TOLERANCE:
        return f"{name} is off by {off * face.size_mm:.2f} mm"
    y, x = np.mgrid[: part.shape[0], : part.shape[1]]
    low_x, low_y = expected.min(axis=0)
    high_x, high_y = expected.max(axis=0)
    away = np.maximum(np.maximum(low_x - x, x - high_x), np.maximum(low_y - y, y - high_y))
    margin_px = (face.reach_mm / face.size_mm - 0.5) * side
    # Pixels shared with the border or with the area outside the margin are ignored.
    if (part[(away > 1.0) & (away < margin_px - 1.2)] < PAPER_WHITE).any():
        return f"the white margin of {name} is not white"
    return None


def _corners_mm(page: Page, face: PrintedFace) -> FloatArray:
    """(4,2) outer corners on the paper, in the landmark's order."""
    (x, y), half = face.centre_mm, face.size_mm / 2
    way = -1 if face.upside_down else 1
    points = [(x - way * half, y - way * half), (x + way * half, y - way * half)]
    points += [(x + way * half, y + way * half), (x - way * half, y + way * half)]
    return np.array([page.on_paper(point) for point in points])


def _tiles_problem(document: pypdfium2.PdfDocument, job: _Job) -> str | None:
    """Join the sheets by their overlaps, later ones on top, and read the whole landmark."""
    face = job.pages[0].faces[0]
    whole_mm = 2 * face.reach_mm
    scale = SIDE_PX / face.size_mm
    canvas = np.full((round(whole_mm * scale), round(whole_mm * scale), 3), 255, dtype=np.uint8)
    for number, page in zip(job.numbers, job.pages, strict=True):
        assert page.window is not None
        image, per_mm = _raster(document, number, page, face.size_mm)
        left, top, right, bottom = page.window
        x, y = page.faces[0].centre_mm
        # Every pixel of the canvas whose center is on this sheet.
        ticks = (np.arange(len(canvas)) + 0.5) / scale - face.reach_mm
        columns = np.flatnonzero((ticks + x >= left) & (ticks + x < right))
        rows = np.flatnonzero((ticks + y >= top) & (ticks + y < bottom))
        from_x = np.clip(((ticks[columns] + x) * per_mm[0]).astype(int), 0, image.shape[1] - 1)
        from_y = np.clip(((ticks[rows] + y) * per_mm[1]).astype(int), 0, image.shape[0] - 1)
        canvas[np.ix_(rows, columns)] = image[np.ix_(from_y, from_x)]
    half = face.size_mm / 2
    corners = (np.array([[-half, -half], [half, -half], [half, half], [-half, half]]) + face.reach_mm) * scale - 0.5
    seen = read_marker_at(canvas, corners, face.family)
    if seen is None or seen.decoding.code != face.code:
        return f"the sheets of code {face.code}, laid together, do not read"
    # Each sheet is rounded separately, by up to a pixel.
    if float(np.abs(seen.corners - corners).max()) > 1.0:
        return f"the sheets of code {face.code}, laid together, are off"
    return None
