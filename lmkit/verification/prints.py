"""Verification of prints: rasterize or open a file, read the landmarks, measure them, grade them."""

from __future__ import annotations

import hashlib
import io
import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pypdfium2
from PIL import Image

from lmkit.arrays import ByteArray, FloatArray
from lmkit.detection.config import DetectOptions
from lmkit.detection.register_and_decode import Candidate
from lmkit.errors import InputError
from lmkit.io.images import MAX_BYTES, decode_image
from lmkit.io.manifest import MANIFEST, PrintManifest, parse_manifest, read_manifest_beside
from lmkit.model.codewords import format_codes
from lmkit.model.families import ALL_FAMILIES, MarkerFamily
from lmkit.model.observation import Detection
from lmkit.units import MM_PER_INCH
from lmkit.verification.find_prints import FoundPrint, find_prints
from lmkit.verification.flat_print import FINE_SIDE_PX
from lmkit.verification.grade import GradedLine, grade_print, grade_tag, overall_grade
from lmkit.verification.measure import measure_print
from lmkit.verification.measure_tag import measure_tag
from lmkit.verification.raster import raster_page
from lmkit.verification.reference import find_reference

PDF_DPI = 150.0
LABEL = re.compile(r"lmkit (?P<family>\w+) v\d+, (?:code \d+, )?(?P<size>[0-9.]+) mm")
CODE = re.compile(r"code (?P<code>\d+)")
EXIF_IFD = 0x8769
EXPOSURE_TAGS = {0x829A, 0x829D, 0x9202, 0x920A}  # exposure time, f-number, aperture, focal length
LEAST_SCAN_DPI = 100.0
SIZES_ALIKE_MM = 0.5


@dataclass(frozen=True)
class Stated:
    """Code, family and size of a landmark from a label or manifest; None if not stated."""

    code: int | None
    family: MarkerFamily | None
    size_mm: float | None
    paper_mm: tuple[float, float] | None = None


@dataclass(frozen=True)
class PrintedLandmark:
    """One landmark read from a print.

    Attributes:
        source: file, and page for a PDF.
        observation: its code and corners.
        side_mm: (width, height) of the border's outer edges, or None if the scale is unknown.
        scale_from: source of the scale.
        stated_code, stated_mm: code and size by the page's label or manifest, or None.
        lines: the grades, line by line.
        image: (H,W,3) the image it was read from, BGR.
    """

    source: str
    observation: Detection
    side_mm: tuple[float, float] | None
    scale_from: str | None
    stated_code: int | None
    stated_mm: float | None
    lines: tuple[GradedLine, ...]
    image: ByteArray

    @property
    def grade(self) -> str:
        """Grade of the worst line."""
        return overall_grade(list(self.lines))

    @property
    def problems(self) -> tuple[str, ...]:
        """Sentences about the lines that fail."""
        return tuple(f"{line.name}: {line.value}" for line in self.lines if line.grade == "F")


# Name, image, dots per inch, and its stated landmarks.
Sheet = tuple[str, ByteArray, tuple[float, float] | None, tuple[Stated, ...]]


@dataclass(frozen=True)
class VerifiedSheet:
    """An image, or a page of a PDF, that has been read.

    Attributes:
        source: file, and page for a PDF.
        found: its landmarks, graded, in the order of their codes.
        missing: codes of its label or manifest that were not found.
    """

    source: str
    found: tuple[PrintedLandmark, ...]
    missing: tuple[int, ...]


def verify_print(
    path: Path, options: DetectOptions | None = None, stated: tuple[Stated, ...] = ()
) -> list[PrintedLandmark]:
    """Read and grade all landmarks of a PDF or image; see `verify_sheets`."""
    return [item for sheet in verify_sheets(path, options, stated) for item in sheet.found]


def verify_sheets(
    path: Path, options: DetectOptions | None = None, stated: tuple[Stated, ...] = ()
) -> list[VerifiedSheet]:
    """Read and grade all landmarks of a PDF or image, compared with its statements; one result for each page.

    Args:
        stated: landmarks that may be on a scan or photograph without a label or manifest.

    Raises:
        InputError: the file or its manifest cannot be read, the file is not the one of the manifest, it contains only
            sheets of tiled landmarks, or its size differs from the stated one.
    """
    sheets = _sheets(path)
    for source, _, _, of_sheet in sheets:
        _require_one_size(source, of_sheet, stated)
    return [_verified(*sheet, stated, options) for sheet in sheets]


def _verified(
    source: str,
    image: ByteArray,
    dpi: tuple[float, float] | None,
    of_sheet: tuple[Stated, ...],
    stated: tuple[Stated, ...],
    options: DetectOptions | None,
) -> VerifiedSheet:
    found = grade_sheet(source, image, dpi, of_sheet or stated, options)
    codes = [one.code for one in of_sheet if one.code is not None]
    # A wrong code is graded as such; it counts for one of the missing codes.
    wrong = sum(item.observation.code not in codes for item in found)
    missing = [code for code in codes if code not in {item.observation.code for item in found}]
    return VerifiedSheet(source, tuple(found), tuple(missing[wrong:]))


def _require_one_size(source: str, of_sheet: tuple[Stated, ...], stated: tuple[Stated, ...]) -> None:
    own, given = ({one.size_mm for one in some if one.size_mm is not None} for some in (of_sheet, stated))
    if own and given and not any(abs(a - b) < SIZES_ALIKE_MM for a in own for b in given):
        raise InputError(
            "size_contradicted",
            f"{source} is of {', '.join(f'{a:g}' for a in sorted(own))} mm according to its label, and "
            f"{', '.join(f'{b:g}' for b in sorted(given))} mm are given",
            "leave the size (--size) out, or give the file that was meant",
        )


def stated_by_manifest(manifest: PrintManifest, page: int | None = None) -> tuple[Stated, ...]:
    """Statements of a manifest about one page, or about all pages."""
    entries = (entry for entry in manifest.landmarks if page is None or entry.page == page)
    papers = manifest.paper_mm
    stated = (
        Stated(
            entry.code,
            ALL_FAMILIES.get(entry.family),
            entry.size_mm,
            papers[entry.page - 1] if entry.page <= len(papers) else None,
        )
        for entry in entries
    )
    return tuple(dict.fromkeys(stated))


def grade_sheet(
    source: str,
    image: ByteArray,
    dpi: tuple[float, float] | None,
    stated: tuple[Stated, ...],
    options: DetectOptions | None = None,
) -> list[PrintedLandmark]:
    """Grade the landmarks of one image, in the order of their codes.

    Args:
        source: its name.
        image: (H,W,3) BGR, 8 bit.
        dpi: dots per inch in x and y of a scan; None for photographs.
        stated: landmarks that should be on it, in any order; empty if unknown.  A code of None
            matches any code.
    """
    padded, offset = _with_margin(image)
    options = options or DetectOptions()
    families = tuple(dict.fromkeys(s.family for s in stated if s.family is not None)) or options.families
    # A resolution in the file comes from a scanner or rasterizer, not from a camera with a lens.
    options = replace(options, families=families, through_lens=dpi is None)
    found = (_graded(source, offset, one, dpi, stated) for one in find_prints(padded, options))
    in_order = sorted(found, key=lambda item: (item.observation.family, item.observation.code))
    return [replace(item, image=image) for item in in_order]


def _graded(
    source: str,
    offset: FloatArray,
    found: FoundPrint,
    dpi: tuple[float, float] | None,
    of_sheet: tuple[Stated, ...],
) -> PrintedLandmark:
    candidate, image = found.candidate, found.image
    stated = _stated_for(found, of_sheet)
    side_px = candidate.side_px
    side_mm = skew = scale_from = None
    if dpi is not None:
        inches = candidate.corners / np.array(dpi)
        edges = (np.roll(inches, -1, axis=0) - inches) * MM_PER_INCH
        sides = np.linalg.norm(edges, axis=1)
        side_mm = (float(sides[[0, 2]].mean()), float(sides[[1, 3]].mean()))
        across, down = edges[0] - edges[2], edges[1] - edges[3]
        cosine = float(across @ down / (np.linalg.norm(across) * np.linalg.norm(down)))
        skew = abs(float(np.degrees(np.arcsin(cosine))))
        scale_from = "resolution of the file"
    elif stated.size_mm is not None and side_px >= FINE_SIDE_PX:
        # Around a distant landmark, many edges of the room could be mistaken for edges of its sheet.
        papers = [stated.paper_mm] if stated.paper_mm is not None else []
        reference = find_reference(image, candidate.corners, stated.size_mm, papers)
        if reference is not None:
            side_mm = (stated.size_mm * reference.stretch[0], stated.size_mm * reference.stretch[1])
            scale_from = reference.name
    problem = _content_problem(found, of_sheet) if candidate.rejected is None else None
    scale = (side_mm, skew, stated.size_mm, problem)
    if isinstance(candidate, Candidate):
        lines = grade_print(candidate, measure_print(image, candidate), *scale)
    else:
        lines = grade_tag(candidate, measure_tag(image, candidate), *scale)
    if candidate.rejected is not None:
        refused = GradedLine("reading", f"refused by the reader: {candidate.rejected}", "F", "see the lines below")
        lines.insert(0, refused)
    moved = replace(candidate.observation, corners=found.corners - offset)
    return PrintedLandmark(source, moved, side_mm, scale_from, stated.code, stated.size_mm, tuple(lines), image)


def _stated_for(found: FoundPrint, stated: tuple[Stated, ...]) -> Stated:
    """Statement about this landmark: by its code, or the only one; else the size common to all statements."""
    same = [one for one in stated if one.code in (None, found.candidate.decoding.code)]
    if len(stated) == 1 or same:
        return (same or list(stated))[0]
    sizes = {one.size_mm for one in stated}
    return Stated(None, None, sizes.pop() if len(sizes) == 1 else None)


def _content_problem(found: FoundPrint, stated: tuple[Stated, ...]) -> str | None:
    code, family = found.candidate.decoding.code, found.candidate.family
    if found.is_mirrored or found.is_inverted:
        faults = " and ".join(["mirrored"] * found.is_mirrored + ["white on black"] * found.is_inverted)
        return f"code {code} of {family.name}, but {faults}"
    codes = [one.code for one in stated if one.code is not None]
    if len(codes) < len(stated) or not codes or code in codes:
        return None
    mirrored = family.mirrored_code(code)
    if len(codes) > 1:
        problem = f"reads as code {code}, which is none of {format_codes(codes)}"
        return problem + (f"; {mirrored} mirrored reads so" if mirrored in codes else "")
    problem = f"reads as code {code}, but its label states {codes[0]}"
    return problem + (", which it is mirrored" if mirrored == codes[0] else "")


def _sheets(path: Path) -> list[Sheet]:
    try:
        if path.stat().st_size > MAX_BYTES:
            raise InputError("file_too_large", f"{path}: more than {MAX_BYTES >> 20} MiB", "split it")
        data = path.read_bytes()
    except OSError as error:
        raise InputError(
            "file_unreadable", f"cannot read {path}: {error.strerror}", "check the path and its permissions"
        ) from None
    manifest = read_manifest_beside(path)
    if manifest is not None and manifest.sha256 not in (None, hashlib.sha256(data).hexdigest()):
        raise InputError(
            "other_print",
            f"{path} is not the file that its manifest was written for",
            "generate it again, or delete the manifest beside it",
        )
    if data.startswith(b"%PDF"):
        return _pdf_sheets(path, data, manifest)
    _refuse_tiles(path, manifest)
    image = decode_image(data, str(path))
    known = _resolution(data, trusted=manifest is not None)
    if manifest is None:
        return [(str(path), image, known, ())]
    image = np.ascontiguousarray(image[:, ::-1]) if manifest.mirrored else image
    return [(str(path), image, known and _as_printed(known, manifest), stated_by_manifest(manifest, 1))]


def _resolution(data: bytes, trusted: bool) -> tuple[float, float] | None:
    """Dots per inch of a scan or rasterized page; None for a photograph, even if its file has a value.

    Cameras write 72, 96 or other values, and their exposure, by which photographs are recognized.
    """
    with Image.open(io.BytesIO(data)) as opened_image:
        dpi = opened_image.info.get("dpi")
        exposed = EXPOSURE_TAGS & set(opened_image.getexif().get_ifd(EXIF_IFD))
    if dpi is None or exposed or min(dpi) < (1.0 if trusted else LEAST_SCAN_DPI):
        return None
    return float(dpi[0]), float(dpi[1])


def _as_printed(dpi: tuple[float, float], manifest: PrintManifest) -> tuple[float, float]:
    """Dots per inch of paper: a compensated file is drawn at another size than its print."""
    return dpi[0] * manifest.stretch[0], dpi[1] * manifest.stretch[1]


def _refuse_tiles(path: Path, manifest: PrintManifest | None) -> None:
    if manifest is not None and manifest.landmarks and all(entry.tile for entry in manifest.landmarks):
        raise InputError(
            "tiles",
            f"{path} contains the tiles of a landmark",
            "tiles were verified together when they were written; glue them, then verify a photograph",
        )


def _pdf_sheets(path: Path, data: bytes, manifest: PrintManifest | None) -> list[Sheet]:
    try:
        document = pypdfium2.PdfDocument(data)
    except pypdfium2.PdfiumError as error:
        raise InputError("bad_pdf", f"{path}: not a PDF that can be read ({error})", "generate it again") from None
    try:
        keywords = document.get_metadata_dict().get("Keywords", "")
        if manifest is None and MANIFEST in keywords:
            manifest = parse_manifest(keywords, str(path))
        _refuse_tiles(path, manifest)
        sheets: list[Sheet] = []
        for number, page in enumerate(document, start=1):
            if manifest is not None and not any(entry.page == number for entry in manifest.landmarks):
                continue  # table of contents
            image, dpi = raster_page(page, PDF_DPI)
            if manifest is not None:
                image = np.ascontiguousarray(image[:, ::-1]) if manifest.mirrored else image
                dpi = _as_printed(dpi, manifest)
            stated = _stated_by_text(page.get_textpage().get_text_bounded())
            if manifest is not None and not stated:
                stated = stated_by_manifest(manifest, number)
            sheets.append((f"{path} page {number}", image, dpi, stated))
    finally:
        document.close()
    return sheets


def _stated_by_text(text: str) -> tuple[Stated, ...]:
    """Statement in the text of the page, if it names one landmark."""
    codes, label = {int(match["code"]) for match in CODE.finditer(text)}, LABEL.search(text)
    if len(codes) != 1 or label is None:
        return ()
    return (Stated(codes.pop(), ALL_FAMILIES.get(label["family"]), float(label["size"])),)


def _with_margin(image: ByteArray) -> tuple[ByteArray, FloatArray]:
    """White around the page: a face without a sheet has no margin of its own."""
    margin = max(16, round(0.08 * max(image.shape[:2])))
    padded = np.pad(image, ((margin, margin), (margin, margin), (0, 0)), constant_values=255)
    return padded, np.array([margin, margin], dtype=np.float64)
