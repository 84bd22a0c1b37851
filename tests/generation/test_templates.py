"""Every shipped template, measured by two foreign rasterizers; tiles laid together; templates that are wrong."""

from __future__ import annotations

import json
import shutil
import subprocess
from collections.abc import Callable
from functools import cache

import numpy as np
import pypdfium2
import pytest
from rasters import BOTH

from lmkit.errors import InputError, LmkitError
from lmkit.generation.grid_sheet import grid_template
from lmkit.generation.manifest import manifest_of
from lmkit.generation.page import Page, Text
from lmkit.generation.pdf import pages_to_pdf
from lmkit.generation.sheet import Wording, compose_sheets, largest_fitting_mm
from lmkit.generation.tiles import compose_tiles
from lmkit.io.manifest import parse_manifest
from lmkit.io.template import PageTemplate, load_template, shipped_templates
from lmkit.model.landmark import LM8, LM12
from lmkit.verification.proof import prove_pages

DPI = 200
PER_MM = DPI / 25.4
TOO_LARGE = ("a0", "a1")  # they differ from a2 in their sizes only
ROUNDING_MM = 2 / PER_MM  # a rasterizer may snap each edge to a whole pixel; test_prints measures finer
CODES = list(range(40, 49))


@cache
def pages_of(name: str) -> tuple[Page, ...]:
    return tuple(compose_sheets(LM8, CODES, load_template(name), wording=Wording("Room 12", "second floor")))


def first_with_landmarks(name: str) -> int:
    return next(number for number, page in enumerate(pages_of(name)) if page.faces)


def raster(name: str, by: Callable[[bytes, float, int], np.ndarray]) -> np.ndarray:
    """The first page that bears a landmark, (h,w,3) RGB."""
    return by(pages_to_pdf(pages_of(name), name), DPI, first_with_landmarks(name))


def red_span_mm(rgb: np.ndarray, low: float, high: float) -> float:
    """Outer edge to outer edge of red along the middle line of ``rgb`` (n,3), sub-pixel by shares of red."""
    redness = (rgb[:, 0].astype(float) - rgb[:, 2]) / (237 - 36)
    inside = np.arange(len(rgb)) / PER_MM
    seen = np.flatnonzero((redness > 0.5) & (inside > low) & (inside < high))
    first, last = seen[0], seen[-1]
    share = np.clip(redness[first - 2 : first + 1].sum(), 0, 3), np.clip(redness[last : last + 3].sum(), 0, 3)
    return (last - first - 1 + share[0] + share[1]) / PER_MM


def _named(names):
    """Layouts that exist for another paper, too, are slow tests."""
    again = [name for name in names if name.startswith("letter-") and name.replace("letter", "a4", 1) in names]
    return [pytest.param(name, marks=pytest.mark.slow if name in again else ()) for name in names]


@pytest.mark.parametrize("by", BOTH)
@pytest.mark.parametrize("name", _named([name for name in shipped_templates() if name not in TOO_LARGE]))
def test_pages_measure_what_they_state(by, name):
    page = pages_of(name)[first_with_landmarks(name)]
    rgb = raster(name, by)
    if page.mirrored:
        rgb = rgb[:, ::-1]
    width, height = page.size_mm
    assert rgb.shape[:2] == pytest.approx((height * PER_MM, width * PER_MM), abs=1)
    marked = rgb.min(axis=2) < 250
    edge = int(load_template(name).printer_margin_mm * PER_MM)
    if edge:
        inner = marked[edge:-edge, edge:-edge]
        assert inner.sum() == marked.sum(), "something stands in the printer's blank edge"
    yy, xx = ((np.arange(n) + 0.5) / PER_MM for n in marked.shape)
    for face in page.faces:
        x, y = face.centre_mm
        row, column = rgb[round(y * PER_MM)], rgb[:, round(x * PER_MM)]
        for line, at in ((row, x), (column, y)):
            span = red_span_mm(line, at - face.reach_mm, at + face.reach_mm)
            assert span == pytest.approx(face.size_mm, abs=ROUNDING_MM)
        away = np.maximum(abs(xx - x)[None, :], abs(yy - y)[:, None])
        margin = (away > face.size_mm / 2 + 0.2) & (away < face.reach_mm - 0.4)
        assert not marked[margin].any(), "the white margin is not white"


@pytest.mark.parametrize("name", _named(shipped_templates()))
def test_every_template_is_proven_and_small(name):
    pages = pages_of(name)
    pdf = pages_to_pdf(pages, name)
    prove_pages(pdf, pages)
    assert len(pdf) / len(pages) < 50_000
    assert pdf == pages_to_pdf(pages, name)
    assert load_template(name).description


def test_every_page_knows_the_spot_color_of_its_cutting_line():
    pdf = pypdfium2.PdfDocument(pages_to_pdf(pages_of("sticker-100"), "stickers"))
    for page in pdf:
        red, green, blue = np.moveaxis(page.render(scale=1).to_numpy()[..., 2::-1].astype(int), -1, 0)
        assert np.sum((red > green + 50) & (blue > green + 50)) > 500  # magenta: plotters find the cut by it


def test_qpdf_finds_nothing_wrong(tmp_path):
    if shutil.which("qpdf") is None:
        pytest.skip("qpdf is not installed")
    for name in ("a4", "sticker-100"):
        (tmp_path / f"{name}.pdf").write_bytes(pages_to_pdf(pages_of(name), name, "{}", cmyk=True))
        subprocess.run(["qpdf", "--check", f"{name}.pdf"], cwd=tmp_path, check=True, capture_output=True)


def test_the_proof_notices():
    (page,) = compose_sheets(LM8, [7], load_template("a4"))
    (other,) = compose_sheets(LM8, [8], load_template("a4"))
    with pytest.raises(LmkitError, match="code 8 of lm8 reads as 7"):
        prove_pages(pages_to_pdf([page], ""), [other])
    moved = Page(page.size_mm, page.items, "", page.faces, stretch=(1.01, 1.0))
    with pytest.raises(LmkitError, match=r"code 7 of lm8 is off by \d"):
        prove_pages(pages_to_pdf([moved], ""), [page])
    from lmkit.generation.page import rectangle

    dirty = Page(page.size_mm, (*page.items, rectangle("mark", (0, 0, 0), 100, 11, 20, 3)), "", page.faces)
    with pytest.raises(LmkitError, match="white margin of code 7"):
        prove_pages(pages_to_pdf([dirty], ""), [page])
    empty = Page(page.size_mm, (), "", page.faces)
    with pytest.raises(LmkitError, match="does not read"):
        prove_pages(pages_to_pdf([empty], ""), [page])


def test_compensation_undoes_what_the_printer_does():
    """A printer that shrinks by the measured factors prints the compensated sheet at its true size."""
    measured = (178.6, 179.4)
    stretch = (180 / measured[0], 180 / measured[1])
    (page,) = compose_sheets(LM8, [7], load_template("a4"), stretch=stretch)
    left, top = page.on_paper((page.faces[0].centre_mm[0] - 90, page.faces[0].centre_mm[1] - 90))
    right, bottom = page.on_paper((page.faces[0].centre_mm[0] + 90, page.faces[0].centre_mm[1] + 90))
    assert (right - left) * measured[0] / 180 == pytest.approx(180)
    assert (bottom - top) * measured[1] / 180 == pytest.approx(180)
    prove_pages(pages_to_pdf([page], ""), [page])


@pytest.mark.parametrize(("size_mm", "paper"), [(540, "a4"), (300, "letter"), (900, "a3")])
def test_tiles_laid_together_are_the_landmark(size_mm, paper):
    pages = compose_tiles(LM8, 137, size_mm, paper)
    prove_pages(pages_to_pdf(pages, ""), pages)
    # In another order they do not.
    shuffled = [pages[0], *pages[:0:-1]]
    with pytest.raises(LmkitError, match="laid together"):
        prove_pages(pages_to_pdf(shuffled, ""), pages)


def test_the_sheets_overlap_and_cover_the_margin():
    pages = compose_tiles(LM12, 5, 540, "a4")[1:]
    covered = np.zeros((600, 600), dtype=int)
    ticks = np.arange(600) + 0.5 - 300
    for page in pages:
        left, top, right, bottom = page.window
        x, y = page.faces[0].centre_mm
        covered[np.ix_((ticks + y > top) & (ticks + y < bottom), (ticks + x > left) & (ticks + x < right))] += 1
    assert covered.min() == 1
    assert (covered > 1).sum() > 0
    assert [page.title.rpartition(" ")[2] for page in pages] == [f"T{n}" for n in range(1, len(pages) + 1)]


def test_sheets_without_ink_are_left_out_and_the_rest_still_reads():
    pages = compose_tiles(LM8, 137, 2600, "letter")
    words = [item.content for item in pages[0].items if isinstance(item, Text)]
    assert words.count("blank") == 24
    assert len(pages) - 1 == 168
    prove_pages(pages_to_pdf(pages, ""), pages)


@pytest.mark.parametrize(
    ("paper", "size_mm", "count"),
    [("a4", 60, 8), ("a4", 80, 6), ("letter", 100, 2), ("a2", 180, 4), ("a3", 130, 4), ("tabloid", 60, 15)],
)
def test_as_many_of_a_size_as_the_paper_holds(paper, size_mm, count):
    sheet = grid_template(LM8, paper, size_mm)
    assert len(sheet.all_places) == count
    pages = compose_sheets(LM8, list(range(count)), sheet, size_mm)
    assert [face.code for face in pages[0].faces] == list(range(count))
    prove_pages(pages_to_pdf(pages, ""), pages)


def test_a_paper_without_space_has_no_grid():
    assert grid_template(LM8, "a4", 200) is None


@pytest.mark.parametrize("name", ["letter-six", "a4-six", "a4", "a3", "a0"])
def test_the_largest_that_fits_does(name):
    sheet = load_template(name)
    largest = largest_fitting_mm(LM8, sheet)
    compose_sheets(LM8, CODES, sheet, largest)
    with pytest.raises(InputError) as refused:
        compose_sheets(LM8, CODES, sheet, largest + 1)
    assert f"the largest that fits there is {largest} mm" in refused.value.hint


def test_the_manifest_says_what_is_printed():
    pages = pages_of("a4-six")
    manifest = manifest_of(pages, "a4-six")
    assert [entry.code for entry in manifest.landmarks] == CODES
    assert [entry.page for entry in manifest.landmarks] == [1] * 6 + [2] * 3
    text = manifest.to_json()
    assert parse_manifest(text, "x") == manifest
    pdf = pages_to_pdf(pages, "six", text)
    inside = pypdfium2.PdfDocument(pdf).get_metadata_dict()["Keywords"]
    assert parse_manifest(inside, "x") == manifest
    with pytest.raises(InputError, match="unknown key"):
        parse_manifest(json.dumps(json.loads(text) | {"color": 3}), "x")


WRONG = {
    "unknown key": ({"margin": 3}, "margin"),
    "two papers": ({"paper_mm": [100, 100]}, "either paper or paper_mm"),
    "no such paper": ({"paper": "a7"}, "a7"),
    "no place": ({"centre_mm": None}, "one of centre_mm, grid and places"),
    "slanted line": ({"cut_lines": [[0, 0, 10, 10]]}, "along one of the paper's edges"),
    "negative": ({"printer_margin_mm": -1}, "printer_margin_mm"),
}
IN_THE_WAY = {
    "ruler in the margin": ({"rulers": {"horizontal_mm": [20, 195], "vertical_mm": [7.2, 18]}}, "white margin"),
    "label off the page": ({"label": {"at_mm": [120, 280]}}, "printers leave blank"),
    "label over square": ({"label": {"at_mm": [30, 220]}, "check_square": {"at_mm": [30, 222]}}, "overlap"),
    "landmarks over each other": (
        {"centre_mm": None, "grid": {"columns": 1, "rows": 2, "first_mm": [110, 106], "step_mm": [0, 80]}},
        "overlap each other",
    ),
    "wrong placeholder": ({"texts": [{"at_mm": [20, 280], "text": "{cod}"}]}, "{cod}"),
}


def template_with(changes: dict) -> PageTemplate:
    data = {"format": "lmkit-template/1", "name": "t", "paper": "a4", "centre_mm": [109.9, 105.9]} | changes
    return PageTemplate.model_validate({key: value for key, value in data.items() if value is not None})


@pytest.mark.parametrize("name", WRONG)
def test_wrong_templates_are_refused(name):
    changes, words = WRONG[name]
    with pytest.raises(ValueError, match=words):
        template_with(changes)


@pytest.mark.parametrize("name", IN_THE_WAY)
def test_what_is_in_the_way_is_named(name):
    changes, words = IN_THE_WAY[name]
    size = 80.0 if "each other" in words else 180.0
    with pytest.raises(InputError, match=words):
        compose_sheets(LM8, [1, 2], template_with(changes), size)
