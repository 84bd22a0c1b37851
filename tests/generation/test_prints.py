"""Printed sheets measured by two foreign rasterizers, and the drawing against the reader's model."""

from __future__ import annotations

import io
import json
import re
from xml.etree import ElementTree

import numpy as np
import pypdfium2
import pytest
from command_line import run_command
from PIL import Image
from rasters import BOTH, by_pdfium

from lmkit.detection.pattern_model import LandmarkPattern
from lmkit.errors import InputError
from lmkit.generation.board import compose_board_page, largest_that_fits
from lmkit.generation.page import bare_landmark_page
from lmkit.generation.pdf import pages_to_pdf
from lmkit.generation.png import page_to_image, page_to_png
from lmkit.generation.sheet import compose_landmark_page
from lmkit.generation.svg import page_to_svg
from lmkit.io.template import load_template
from lmkit.model.board import BoardSpec
from lmkit.model.codewords import code_to_gaps
from lmkit.model.landmark import LM8
from lmkit.model.palette import BLUE, RED, WHITE
from lmkit.pipelines.prints import PrintLayout

DPI = 300
BOARD_DPI = 150


def sheet(code: int = 137, template: str = "a4") -> bytes:
    page = compose_landmark_page(LM8, code, 180.0, load_template(template))
    return pages_to_pdf([page], page.title)


def red_extent_mm(rgb: np.ndarray) -> tuple[float, float]:
    """Width and height of the red border's outer edges, sub-pixel by the share of red in edge pixels."""
    redness = (rgb[:, :, 0].astype(float) - rgb[:, :, 2]) / (RED[0] - RED[2])  # white and black 0, red 1
    spans = []
    for axis in (0, 1):
        # A band through the middle of the top (or left) border, where only the border is inked.
        inked = (rgb[:, :, 0] > 200) & (rgb[:, :, 2] < 90)
        lines = np.flatnonzero(inked.sum(axis=1 - axis) > 1500)
        band = redness.take(lines[5:40], axis=axis).mean(axis=axis)
        spans.append(band.clip(0, band.max()).sum() / band.max() / DPI * 25.4)
    return spans[0], spans[1]


@pytest.mark.parametrize("by", BOTH)
@pytest.mark.parametrize("template", ["a4", "letter"])
def test_the_red_border_measures_180_mm(by, template):
    width, height = red_extent_mm(by(sheet(template=template), DPI))
    assert width == pytest.approx(180.0, abs=0.1)
    assert height == pytest.approx(180.0, abs=0.1)


def test_the_same_sheet_gives_the_same_bytes():
    assert sheet() == sheet()
    page = bare_landmark_page(LM8, 5, 180.0)
    assert page_to_png(page, 72) == page_to_png(page, 72)


def test_viewers_are_asked_not_to_scale():
    assert b"/PrintScaling /None" in sheet()


def test_the_label_is_selectable_and_says_what_it_is():
    text = pypdfium2.PdfDocument(sheet())[0].get_textpage().get_text_bounded()
    assert "code 137" in text
    assert "180 mm" in text
    assert "100 %" in text


@pytest.mark.parametrize("code", [0, 137, 255])
def test_the_drawing_is_what_the_reader_expects(code):
    """Printing and reading are separate code (paths and formulas); here they must agree."""
    size = 720
    rgb = np.asarray(page_to_image(bare_landmark_page(LM8, code, 180.0), size / 180 * 25.4), dtype=float)
    centers = (np.arange(size) + 0.5) / size * 180 - 90
    x, y = np.meshgrid(centers, -centers)
    points = np.column_stack([x.ravel(), y.ravel()])
    spread = np.tile([0.01, 0.0, 0.01], (len(points), 1))
    open_gaps = np.flatnonzero(code_to_gaps(code, 8))
    (inks,) = LandmarkPattern(LM8).inks(points, spread, open_gaps, 0)
    expected = (inks @ np.array([WHITE, RED, BLUE, WHITE], dtype=float)).reshape(size, size, 3)
    # Over cells of 1 mm, so that two methods of smoothing edges do not count.
    off = np.abs((rgb - expected).reshape(180, 4, 180, 4, 3).mean(axis=(1, 3)))
    off = off[1:-1, 1:-1]  # at its edge the page ends, but the paper of the model does not
    assert off.max() < 25
    assert off.mean() < 0.5


def test_svg_is_true_to_scale_and_well_formed():
    root = ElementTree.fromstring(page_to_svg(bare_landmark_page(LM8, 137, 180.0)))
    assert (root.get("width"), root.get("viewBox")) == ("180mm", "0 0 180 180")
    border = next(e for e in root.iter("{http://www.w3.org/2000/svg}path") if e.get("class") == "border")
    numbers = [float(n) for n in re.findall(r"[-0-9.]+", border.get("d", ""))]
    assert (min(numbers), max(numbers)) == (0.0, 180.0)


def test_png_carries_its_resolution():
    image = Image.open(io.BytesIO(page_to_png(bare_landmark_page(LM8, 137, 180.0), 254)))
    assert image.size == (1800, 1800)
    assert image.info["dpi"][0] == pytest.approx(254, abs=0.1)


@pytest.mark.parametrize("spec", ["chessboard:9x6:25mm", "charuco:7x5:30mm:22mm:DICT_4X4_50"])
def test_boards_measure_what_they_say_and_are_found(spec):
    from lmkit.detection.boards import detect_board

    board = BoardSpec.parse(spec)
    page = compose_board_page(board)
    rgb = by_pdfium(pages_to_pdf([page], page.title), BOARD_DPI)
    seen = detect_board(np.ascontiguousarray(rgb[:, :, ::-1]), board)
    assert seen is not None
    assert len(seen.ids) == len(board.object_points)
    steps = np.linalg.norm(np.diff(seen.image_points.reshape(*board.inner_corners[::-1], 2), axis=1), axis=2)
    assert steps.mean() / BOARD_DPI * 25.4 == pytest.approx(board.square_mm, abs=0.02)


def test_a_board_larger_than_its_paper_is_reported_with_what_fits(tmp_path):
    answer = run_command("board", "chessboard:9x6:30mm", "-o", tmp_path / "board.pdf")
    assert (answer.code, "squares of 26 mm would fit on a4" in answer.err) == (0, True)
    assert (
        "420 x 297 mm" in run_command("board", "chessboard:9x6:30mm", "--paper", "a3", "-o", tmp_path / "a3.pdf").out
    )
    assert run_command("board", "chessboard:9x6:26mm", "-o", tmp_path / "fits.pdf").err == ""
    assert (
        "choose a4, letter"
        in run_command("board", "chessboard:9x6:26mm", "--paper", "a9", "-o", tmp_path / "x.pdf").err
    )


def test_the_tags_that_are_said_to_fit_do_and_larger_ones_do_not():
    said = largest_that_fits(BoardSpec.parse("aprilgrid:6x6:40mm:0.3"), "a4")
    fits = int(said.split()[2])
    for tag_mm, on_paper in ((fits, True), (fits + 1, False)):
        page = compose_board_page(BoardSpec.parse(f"aprilgrid:6x6:{tag_mm}mm:0.3"), "a4")
        assert (sorted(page.size_mm) == [210, 297]) == on_paper


def test_several_codes_of_a_size_share_sheets_in_order(tmp_path):
    run_command("generate", "--codes", "5,2-4", "--size", "60mm", "-o", tmp_path / "set.pdf")
    manifest = json.loads((tmp_path / "set.pdf.json").read_text())
    assert [(entry["code"], entry["page"]) for entry in manifest["landmarks"]] == [(5, 1), (2, 1), (3, 1), (4, 1)]
    run_command("generate", "--codes", "2-3", "--size", "60mm", "--each", "-o", tmp_path / "each.pdf")
    assert {path.name for path in tmp_path.glob("each*.pdf")} == {"each-2.pdf", "each-3.pdf"}


@pytest.mark.parametrize(("text", "missing"), [("Λαβ 3", "Λαβ"), ("入口", "入口")])
def test_letters_that_the_font_lacks_are_refused(text, missing):
    layout = PrintLayout(LM8, template="a4-door", text=text)
    with pytest.raises(InputError, match=f"no {missing}"):
        layout.pages([5])


def test_letters_of_western_europe_are_printed():
    assert PrintLayout(LM8, template="a4-door", text="Büro Ångström, café").pages([5])
