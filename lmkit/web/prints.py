"""Page 1, prints: preview of the sheets, and the verified file."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field
from starlette.requests import Request
from starlette.responses import Response

from lmkit.units import parse_length_mm
from lmkit.web.answers import Body, answer, read_body
from lmkit.web.state import state_of

SHOWN = 6  # pages of a preview
MOST_CODES = 300
Word = Annotated[str, Field(max_length=80)]


class PrintBody(Body):
    """The choices of the page; empty text means the default."""

    codes: Annotated[str, Field(min_length=1, max_length=400)]
    family: Word = "lm8"
    size: Word = ""
    paper: Word = ""
    template: Word = ""
    text: Word = ""
    map_name: Word = ""
    compensate: Word = ""
    mirror: bool = False


async def choices(request: Request) -> Response:
    """Families, papers and templates to choose from."""
    return answer(await state_of(request).workers.run(print_choices))


async def preview(request: Request) -> Response:
    """The first sheets as SVG, and the equivalent command line."""
    state, body = state_of(request), await read_body(request, PrintBody)
    return answer(await state.workers.run(preview_prints, body, str(state.project.root / "rig.yaml")))


async def make(request: Request) -> Response:
    """Write the PDF into ``prints/`` once every landmark has been read back from it."""
    state, body = state_of(request), await read_body(request, PrintBody)
    stem = await state.workers.run(file_stem, body)
    name = state.project.unused("prints", stem, ".pdf")
    made = await state.workers.run(write_pdf, body, str(state.project.path(name)))
    return answer({"file": name, "command": command_of(body, name), **made})


def print_choices() -> dict[str, Any]:
    """Families, papers and templates with their descriptions."""
    from lmkit.io.template import load_template, shipped_templates
    from lmkit.model.families import ALL_FAMILIES
    from lmkit.pipelines.prints import PAPERS

    templates = [load_template(name) for name in shipped_templates() if name not in PAPERS]
    return {
        "families": [{"name": f.name, "codes": f.code_count, "size_mm": f.side_mm} for f in ALL_FAMILIES.values()],
        "papers": list(PAPERS),
        "templates": [{"name": t.name, "description": t.description, "size_mm": t.size_mm} for t in templates],
    }


def preview_prints(body: PrintBody, rig: str) -> dict[str, Any]:
    """Pages of a print as SVG, with the reading distance.

    Args:
        rig: path of the rig file, which may be missing.
    """
    from lmkit.generation.svg import page_to_svg
    from lmkit.pipelines.prints import READ_FROM_PX, check_landmark_size

    layout, codes = _layout(body)
    pages = layout.pages(codes)
    sizes = [face.size_mm for page in pages for face in page.faces] or [layout.size_mm or layout.family.side_mm]
    size_mm = layout.size_mm if layout.tiled and layout.size_mm else max(sizes)
    focal_px, whose = _focal_length(Path(rig))
    warning = check_landmark_size(size_mm)
    return {
        "pages": [{"title": page.title, "svg": page_to_svg(page), "mm": page.size_mm} for page in pages[:SHOWN]],
        "count": len(pages),
        "landmarks": len(codes),
        "size_mm": size_mm,
        "layout": layout.name_for(codes),
        "reads_from_m": size_mm / 1000 * focal_px / READ_FROM_PX,
        "focal_px": focal_px,
        "focal_from": whose,
        "warnings": [warning] if warning else [],
        "command": command_of(body, f"prints/{file_stem(body)}.pdf"),
    }


def write_pdf(body: PrintBody, path: str) -> dict[str, Any]:
    """Write the PDF and its manifest after reading back every landmark."""
    from lmkit.pipelines.prints import write_prints

    layout, codes = _layout(body)
    write_prints(layout, codes, Path(path))
    return {"landmarks": len(codes), "pages": len(layout.pages(codes)), "bytes": Path(path).stat().st_size}


def file_stem(body: PrintBody) -> str:
    """Name of the file without its suffix."""
    from lmkit.model.codewords import format_codes

    codes = _layout(body)[1]
    text = format_codes(codes) if len(codes) > 1 else str(codes[0])
    stem = ("landmarks-" if len(codes) > 1 else "landmark-") + text.replace(",", "_")
    family = "" if body.family == "lm8" else f"{body.family}-"
    return (family + stem)[:80]


def command_of(body: PrintBody, name: str) -> str:
    """The command line that writes the same file."""
    words = ["lmkit", "generate", "--codes", body.codes]
    options = {
        "--family": "" if body.family == "lm8" else body.family, "--size": body.size, "--paper": body.paper,
        "--template": body.template, "--text": body.text, "--map-name": body.map_name,
        "--compensate": body.compensate,
    }  # fmt: skip
    for option, value in options.items():
        if value:
            words += [option, value]
    return shlex.join([*words, *(["--mirror"] if body.mirror else []), "-o", name])


def _layout(body: PrintBody) -> tuple[Any, list[int]]:
    from lmkit.errors import InputError
    from lmkit.io.template import shipped_templates
    from lmkit.model.codewords import parse_codes
    from lmkit.model.families import family_named
    from lmkit.pipelines.prints import PrintLayout, check_landmark_size

    family = family_named(body.family)
    codes = parse_codes(body.codes, family.code_count)
    if len(codes) > MOST_CODES:
        hint = f"print at most {MOST_CODES} at a time here; the command line takes all"
        raise InputError("too_many", f"{len(codes)} codes", hint)
    # On the command line a template may be a file; here only the included templates are allowed.
    if body.template and body.template not in shipped_templates():
        raise InputError("unknown_template", f"there is no template {body.template!r}", "choose one from the list")
    size_mm = parse_length_mm(body.size, "size") if body.size else None
    if size_mm is not None:
        check_landmark_size(size_mm)
    layout = PrintLayout(
        family, body.template or None, body.paper or None, size_mm, body.text, body.map_name, body.mirror,
        body.compensate or None,
    )  # fmt: skip
    return layout, codes


def _focal_length(rig: Path) -> tuple[float, str]:
    """Focal length in pixels, and its source."""
    from lmkit.errors import LmkitError
    from lmkit.geometry.rig import mounted_cameras
    from lmkit.io.any_rig import read_any_rig

    if rig.is_file():
        try:
            return float(mounted_cameras(read_any_rig(rig))[0].model.K[0, 0]), "rig"
        except LmkitError:
            pass
    return 600.0, "guess"
