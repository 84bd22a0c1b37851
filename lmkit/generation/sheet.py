"""Pages of landmarks from codes and a template, with plain errors if something does not fit."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

from lmkit.errors import InputError
from lmkit.generation import sheet_parts as parts
from lmkit.generation.artwork import FilledPath
from lmkit.generation.page import Box, Page, PrintedFace, Text, item_box, overlap
from lmkit.generation.sheet_parts import Part
from lmkit.io.template import PageTemplate, TextLine
from lmkit.model.codewords import format_codes
from lmkit.model.families import MarkerFamily
from lmkit.model.landmark import LM8, LandmarkFamily

CONTENTS_COLUMNS = 8
FITTING = ("landmark_too_large", "overlap", "outside")  # errors that a smaller landmark may avoid


@dataclass(frozen=True)
class Wording:
    """Text that a user adds to a sheet: free text, and the name of the map it belongs to."""

    text: str = ""
    map_name: str = ""


def compose_sheets(
    family: MarkerFamily,
    codes: Sequence[int],
    template: PageTemplate,
    size_mm: float | None = None,
    wording: Wording | None = None,
    mirrored: bool = False,
    stretch: tuple[float, float] = (1.0, 1.0),
) -> list[Page]:
    """All sheets for these codes, in order.

    Args:
        size_mm: of the landmarks; None: the template's own.
        mirrored: mirror the sheets even if the template does not.
        stretch: factors of the drawing in x and y that compensate the printer.

    Raises:
        InputError: a landmark does not fit, parts overlap or reach into the printer's margin, or a code
            is not in the family.
    """
    size = size_mm or usual_size_mm(family, template)
    mirrored = mirrored or template.mirrored
    places = template.all_places
    pages = []
    for start in range(0, len(codes), 1 if template.repeat else len(places)):
        some = [codes[start]] * len(places) if template.repeat else codes[start : start + len(places)]
        faces = tuple(
            PrintedFace(family, code, size, place.centre_mm, place.upside_down)
            for code, place in zip(some, places, strict=False)
        )
        page = _composed(faces, template, wording or Wording())
        pages.append(replace(page, mirrored=mirrored, stretch=stretch))
    if template.contents:
        pages[:0] = contents_pages(pages, template)
    return pages


def compose_landmark_page(family: MarkerFamily, code: int, size_mm: float, template: PageTemplate) -> Page:
    """One landmark's sheet; see :func:`compose_sheets`."""
    return compose_sheets(family, [code], template, size_mm)[0]


def _composed(faces: tuple[PrintedFace, ...], template: PageTemplate, wording: Wording) -> Page:
    try:
        return _compose(faces, template, wording)
    except InputError as error:
        largest = largest_fitting_mm(faces[0].family, template) if error.code in FITTING else 0
        if not 0 < largest < faces[0].size_mm:
            raise
        hint = f"the largest that fits there is {largest} mm; without a template (--template) sheets are made to fit"
        raise InputError(error.code, error.message, hint) from None


def _compose(faces: tuple[PrintedFace, ...], template: PageTemplate, wording: Wording) -> Page:
    _check_faces(faces, template)
    around = list(_parts(faces, template, wording))
    _check_parts(around, faces, template)
    items: list[FilledPath | Text] = [shape for face in faces for shape in face.artwork]
    items += [item for part in around for item in part.items]
    return Page(template.page_mm, tuple(items), _title(faces), faces)


def _title(faces: tuple[PrintedFace, ...]) -> str:
    first = faces[0]
    return f"{first.family.name} v{first.family.version}, {_codes(faces)}, {first.size_mm:g} mm"


def _codes(faces: tuple[PrintedFace, ...]) -> str:
    """``code 3`` or ``codes 3-8``."""
    codes = list(dict.fromkeys(face.code for face in faces))
    return f"code {codes[0]}" if len(codes) == 1 else f"codes {format_codes(codes)}"


def _parts(faces: tuple[PrintedFace, ...], template: PageTemplate, wording: Wording) -> Iterator[Part]:
    """Everything but the landmarks, in the template's order."""
    if template.rulers is not None:
        length = template.rulers.length_mm
        yield parts.ruler(template.rulers.horizontal_mm, length, vertical=False)
        yield parts.ruler(template.rulers.vertical_mm, length, vertical=True, slim=template.rulers.slim_vertical)
    if template.check_square is not None:
        yield parts.check_square(template.check_square.at_mm)
    if template.patches is not None:
        is_colored = any(isinstance(face.family, LandmarkFamily) for face in faces)
        yield parts.patch_strip(template.patches.at_mm, is_colored)
    if template.arrow is not None:
        yield parts.up_arrow(template.arrow.at_mm)
    if template.holes is not None:
        for at in template.holes.at_mm:
            yield parts.hole(at, template.holes.diameter_mm)
    if template.label is not None:
        length_or_none = None if template.rulers is None else template.rulers.length_mm
        yield parts.label(template.label.at_mm, faces[0], _codes(faces), length_or_none)
    for face in faces:
        if template.caption is not None:
            yield parts.caption(face, template.caption.below_mm, template.caption.height_mm)
        if template.dimension:
            yield parts.dimension(face)
        if template.crop_marks:
            yield parts.crop_marks(face, template.bleed_mm)
        if template.centre_marks:
            yield parts.centre_marks(face)
        if template.cut_contour:
            yield parts.cut_contour(face)
    for segment in template.cut_lines:
        yield parts.straight_line(segment, dashed=False)
    for segment in template.fold_lines:
        yield parts.straight_line(segment, dashed=True)
    for line in template.texts:
        if words := _filled_in(line, faces, wording, template.name):
            rotation = 180 if line.upside_down else 0
            text = Text(line.at_mm, words, line.height_mm, line.anchor, rotation_deg=rotation, bold=line.bold)
            yield Part(f"text {words!r}", (text,))


def _filled_in(line: TextLine, faces: tuple[PrintedFace, ...], wording: Wording, template: str) -> str:
    values = {
        "code": _codes(faces).split()[1],
        "family": faces[0].family.name,
        "size": f"{faces[0].size_mm:g} mm",
        "text": wording.text,
        "map": wording.map_name,
    }
    try:
        return line.text.format(**values).strip()
    except (KeyError, IndexError, ValueError, AttributeError) as error:
        raise InputError(
            "bad_template",
            f"template {template}: text {line.text!r} cannot be filled in: {error}",
            f"placeholders: {', '.join('{' + name + '}' for name in values)}",
        ) from None


def usual_size_mm(family: MarkerFamily, template: PageTemplate) -> float:
    """The template's own size; smaller for families with a wider white margin than ring landmarks."""
    rings, own = (1 + 2 * f.margin_mm / f.side_mm for f in (LM8, family))
    return template.size_mm if own <= rings else float(math.floor(template.size_mm * rings / own))


def largest_fitting_mm(family: MarkerFamily, template: PageTemplate) -> int:
    """The largest size, whole mm, at which landmarks and all parts of the sheet fit; 0 if none does."""
    low, high = 0, math.floor(largest_mm(family, template))
    while low < high:
        size_mm = (low + high + 1) // 2
        faces = tuple(
            PrintedFace(family, 0, float(size_mm), place.centre_mm, place.upside_down)
            for place in template.all_places
        )
        try:
            _compose(faces, template, Wording())
            low = size_mm
        except InputError:
            high = size_mm - 1
    return low


def largest_mm(family: MarkerFamily, template: PageTemplate) -> float:
    """The largest landmark that fits between the template's places and the paper's edges."""
    width, height = template.page_mm
    free = min(min(x, y, width - x, height - y) for x, y in (place.centre_mm for place in template.all_places))
    # The white margin may overlap the printer's blank edge, since nothing is printed in it.
    by_margin = (free - template.bleed_mm) / (0.5 + family.margin_mm / family.side_mm)
    return min(by_margin, 2 * (free - template.printer_margin_mm))


def _check_faces(faces: tuple[PrintedFace, ...], template: PageTemplate) -> None:
    largest = largest_mm(faces[0].family, template)
    if faces[0].size_mm > largest:
        raise InputError(
            "landmark_too_large",
            f"a landmark of {faces[0].size_mm:g} mm with its white margin does not fit on template {template.name}",
            "choose a smaller size (--size), or leave the template (--template) out to tile it over several sheets",
        )
    for one, other in combinations(faces, 2):
        if overlap(one.margin_box, other.margin_box):
            raise InputError(
                "overlap",
                f"template {template.name}: landmarks of {one.size_mm:g} mm overlap each other's white margin",
                "choose a smaller size (--size), or larger steps in the template",
            )


def _check_parts(around: list[Part], faces: tuple[PrintedFace, ...], template: PageTemplate) -> None:
    width, height = template.page_mm
    edge = template.printer_margin_mm
    for part in around:
        left, top, right, bottom = part.box
        if min(left, top) < edge or right > width - edge or bottom > height - edge:
            raise InputError(
                "outside",
                f"template {template.name}: the {part.name} reaches into the {edge:g} mm at the paper's edge "
                "that printers leave blank",
                "move it inward, or lower printer_margin_mm if your printer can do more",
            )
        # The bounding box of a frame covers the margin, but the frame does not.
        if part.name != "cut contour" and any(_touches(part, face.margin_box) for face in faces):
            raise InputError(
                "overlap",
                f"template {template.name}: the {part.name} overlaps a landmark's white margin",
                "move it outward, or choose a smaller size (--size)",
            )
    for one, other in combinations([part for part in around if part.alone], 2):
        if overlap(one.box, other.box):
            raise InputError(
                "overlap",
                f"template {template.name}: the {one.name} and the {other.name} overlap",
                "move one of them",
            )


def _touches(part: Part, box: Box) -> bool:
    """Compared item by item, since marks are on all sides of a landmark."""
    return overlap(part.box, box) and any(overlap(item_box(item), box) for item in part.items)


def contents_pages(pages: Sequence[Page], template: PageTemplate) -> list[Page]:
    """Contents pages: every landmark at small size, with its code and page number."""
    width, height = template.page_mm
    edge = max(template.printer_margin_mm, 12.0)
    step = (width - 2 * edge) / CONTENTS_COLUMNS
    row_height = step + 5.0
    rows = int((height - 2 * edge - 16) // row_height)
    entries = [(face, number) for number, page in enumerate(pages) for face in page.faces]
    seen = list({face.code: (face, number) for face, number in reversed(entries)}.values())[::-1]
    count = -(-len(seen) // (rows * CONTENTS_COLUMNS))
    made = []
    for first in range(count):
        items: list[FilledPath | Text] = [
            Text((edge, edge + 6), "Contents", 6.0, bold=True),
            Text((edge, edge + 11), f"{len(seen)} landmarks of {seen[0][0].size_mm:g} mm, one code each", 3.2),
        ]
        some = seen[first * rows * CONTENTS_COLUMNS : (first + 1) * rows * CONTENTS_COLUMNS]
        for k, (face, number) in enumerate(some):
            x = edge + (k % CONTENTS_COLUMNS + 0.5) * step
            y = edge + 16 + (k // CONTENTS_COLUMNS) * row_height + step / 2
            items += PrintedFace(face.family, face.code, 0.8 * step, (x, y)).artwork
            words = f"code {face.code}, page {number + 1 + count}"
            items.append(Text((x, y + 0.4 * step + 3.4), words, 2.2, "middle"))
        made.append(Page(template.page_mm, tuple(items), "contents"))
    return made
