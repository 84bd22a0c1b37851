"""Defects planted in scans of sheets, each named by the right line; good sheets have no finding.

Simulated: pypdfium2 draws the sheet, OpenCV damages and scans it; benchmarks/prints.py has more cases.
"""

from __future__ import annotations

import json
from datetime import date
from functools import lru_cache

import cv2
import numpy as np
import pypdfium2
import pytest
from PIL import Image

from lmkit.generation.pdf import pages_to_pdf
from lmkit.generation.sheet import compose_landmark_page
from lmkit.io.template import load_template
from lmkit.model.landmark import FAMILIES, LM8
from lmkit.reports.certificate import certificate
from lmkit.verification.prints import PrintedLandmark, Stated, grade_sheet, verify_sheets
from lmkit.verification.sheet_edges import is_sheet

DPI = 100.0
MM = DPI / 25.4
CODE = 37


@lru_cache(maxsize=4)
def sheet(code: int) -> np.ndarray:
    """(H,W,3) RGB 0..1 of the A4 sheet."""
    page = compose_landmark_page(LM8, code, 180.0, load_template("a4"))
    pdf = pypdfium2.PdfDocument(pages_to_pdf([page], ""))
    rgb = np.asarray(pdf[0].render(scale=2 * DPI / 72).to_pil().convert("RGB"), dtype=np.float32) / 255
    return cv2.resize(rgb, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)


def graded(photo: np.ndarray, stated: int = CODE, scanned: bool = True) -> PrintedLandmark:
    rng = np.random.default_rng(1)
    scan = cv2.GaussianBlur(photo, (0, 0), 0.6) * 250 + rng.normal(0, 1.5, photo.shape)
    image = np.clip(np.round(scan), 0, 255).astype(np.uint8)[:, :, ::-1].copy()
    (found,) = grade_sheet("scan", image, (DPI, DPI) if scanned else None, (Stated(stated, LM8, 180.0),))
    return found


def grade_of(found: PrintedLandmark, name: str) -> str | None:
    return next(line.grade for line in found.lines if line.name == name)


def shrunk(sx: float, sy: float) -> np.ndarray:
    height, width = sheet(CODE).shape[:2]
    A = np.array([[sx, 0, 20.0], [0, sy, 15.0]])
    return cv2.warpAffine(sheet(CODE), A, (width, height), borderValue=(1.0, 1.0, 1.0))


def paled(share: float, channel: int) -> np.ndarray:
    """Ink of a color (0 red, 2 blue) blended with white."""
    photo = sheet(CODE)
    ink = np.clip(photo[:, :, channel] - photo[:, :, 2 - channel], 0, 1)[:, :, None]
    return photo + share * np.clip(2 * ink, 0, 1) * (1 - photo)


def blotched() -> np.ndarray:
    photo = sheet(CODE).copy()
    y, x = np.mgrid[: photo.shape[0], : photo.shape[1]] / MM
    return photo + np.clip(1.3 - np.hypot(x - 60, y - 60) / 22, 0, 1)[:, :, None] * (1 - photo)


def cut() -> np.ndarray:
    photo = sheet(CODE).copy()
    photo[: round(14 * MM)] = 0.2
    return photo


def striped() -> np.ndarray:
    bare = (np.arange(sheet(CODE).shape[0]) / MM % 14 < 1.6)[:, None, None]
    return np.where(bare, 0.5 + 0.5 * sheet(CODE), sheet(CODE))


PLANTED = {
    "scale": (lambda: shrunk(0.97, 0.97), "DF"),
    "X to Y": (lambda: shrunk(1.0, 0.98), "DF"),
    "contrast of blue": (lambda: paled(0.6, 2), "CDF"),
    "color of red": (lambda: paled(0.5, 0), "CDF"),
    "glare": (blotched, "CDF"),
    "white margin": (cut, "CDF"),
    "evenness": (striped, "CDF"),
    "sharpness": (lambda: cv2.GaussianBlur(sheet(CODE), (0, 0), 0.018 * 180 * MM), "CDF"),
}


def test_a_good_scan_is_an_a():
    found = graded(sheet(CODE))
    assert found.grade == "A", found.lines
    assert found.side_mm == pytest.approx((180, 180), abs=0.2)
    assert all(line.grade is not None for line in found.lines)


@pytest.mark.parametrize("name", PLANTED)
def test_a_planted_defect_is_named(name):
    spoil, severity = PLANTED[name]
    found = graded(spoil())
    assert grade_of(found, name) in tuple(severity), found.lines
    assert found.grade in "CDF"
    assert next(line.advice for line in found.lines if line.name == name)


def test_the_wrong_landmark_and_a_mirrored_one_are_distinguished():
    wrong = graded(sheet(CODE), stated=CODE + 1)
    assert wrong.problems == ("content: reads as code 37, but its label states 38",)
    mirrored = graded(np.ascontiguousarray(sheet(CODE)[:, ::-1]))
    (problem,) = mirrored.problems
    assert problem.endswith("which it is mirrored")
    assert mirrored.observation.code == LM8.mirrored_code(CODE)


@pytest.mark.parametrize("family", FAMILIES.values(), ids=lambda f: f.name)
def test_mirroring_twice_changes_nothing(family):
    codes = [family.mirrored_code(code) for code in range(family.code_count)]
    for code, once in enumerate(codes):
        assert once is None or codes[once] == code
    assert None not in codes or family.distance > 2


def photograph(stretch: float) -> np.ndarray:
    """(1200,1000,3) the whole sheet, tilted, with its drawing shrunk on the same paper."""
    height, width = sheet(CODE).shape[:2]
    A = np.array([[stretch, 0, (1 - stretch) * width / 2], [0, stretch, (1 - stretch) * height / 2]])
    paper = cv2.warpAffine(sheet(CODE), A, (width, height), borderValue=(1.0, 1.0, 1.0))
    corners = np.array([[120, 60], [900, 110], [860, 1120], [90, 1080]], dtype=np.float32)
    outline = np.array([[0, 0], [width, 0], [width, height], [0, height]], dtype=np.float32) - 0.5
    H = cv2.getPerspectiveTransform(outline, corners)
    return cv2.warpPerspective(paper, H, (1000, 1200), flags=cv2.INTER_AREA, borderValue=(0.4, 0.35, 0.3))


@pytest.mark.parametrize(("stretch", "grade"), [(1.0, "A"), (0.97, "F")])
def test_a_photograph_takes_its_scale_from_the_sheets_edges(stretch, grade):
    found = graded(photograph(stretch), scanned=False)
    assert found.scale_from == "a4"
    assert grade_of(found, "scale") == grade, found.lines


def test_a_cameras_dots_per_inch_are_not_believed(lmkit, tmp_path):
    """Cameras write 72 or 300 dpi and exposure data; scanners do not."""
    photo = Image.fromarray(np.clip(photograph(1.0) * 250, 0, 255).astype(np.uint8))
    exif = Image.Exif()
    exif.get_ifd(0x8769)[0x829A] = 0.01
    photo.save(tmp_path / "phone.jpg", dpi=(300, 300), exif=exif, quality=95)
    photo.save(tmp_path / "plain.jpg", dpi=(72, 72), quality=95)
    for name in ("phone.jpg", "plain.jpg"):
        (row,) = [json.loads(line) for line in lmkit("verify", name, "--json").out.splitlines()]
        assert row["side_mm"] is None
        assert "--size" in row["lines"]["scale"]["advice"]
        (row,) = [json.loads(line) for line in lmkit("verify", name, "--json", "--size", "180mm").out.splitlines()]
        assert row["scale_from"] == "a4"
        assert row["side_mm"] == pytest.approx([180, 180], abs=0.4)


def test_a_photograph_is_compared_with_a_manifest_elsewhere(lmkit, tmp_path):
    photo = Image.fromarray(np.clip(photograph(1.0) * 250, 0, 255).astype(np.uint8))
    photo.save(tmp_path / "photo.png")
    assert lmkit("generate", "--codes", f"{CODE}-{CODE + 2}", "-o", "set.pdf").code == 0
    assert lmkit("generate", "--codes", "1-3", "-o", "other.pdf").code == 0
    answer = lmkit("verify", "photo.png", "--json", "--manifest", "set.pdf.json")
    row = json.loads(answer.out)
    assert (row["stated_code"], row["lines"]["scale"]["grade"]) == (CODE, "A")
    answer = lmkit("verify", "photo.png", "--json", "--manifest", "other.pdf.json")
    assert answer.code == 1
    assert json.loads(answer.out)["problems"] == [f"content: reads as code {CODE}, which is none of 1-3"]
    assert "--size" in lmkit("verify", "photo.png", "--manifest", "set.pdf.json", "--size", "180mm").err


def test_sheets_of_a_tiled_landmark_are_no_print_yet(lmkit, tmp_path):
    assert lmkit("generate", "--code", 3, "--size", "300mm", "-o", "big.pdf").code == 0
    answer = lmkit("verify", "big.pdf")
    assert answer.code == 2
    assert "glue them" in answer.err


def test_without_anything_of_known_size_the_scale_is_unknown():
    middle = sheet(CODE)[:, :][: round(205 * MM)]
    found = graded(middle, scanned=False)
    assert found.side_mm is None
    assert grade_of(found, "scale") == "C"


def test_the_certificate_is_a_page_each(tmp_path):
    items = [graded(sheet(CODE)), graded(striped())]
    pdf = certificate(items, date(2026, 5, 17))
    assert pdf == certificate(items, date(2026, 5, 17))
    document = pypdfium2.PdfDocument(pdf)
    assert len(document) == 2
    text = document[1].get_textpage().get_text_bounded()
    assert "evenness" in text
    assert "graded on 2026-05-17" in text
    assert "without a claim of compliance" in text


def test_the_command_reads_the_manifest(lmkit, tmp_path):
    assert lmkit("generate", "--codes", "3-8", "--template", "a4-six", "-o", "six.pdf").code == 0
    answer = lmkit("verify", "six.pdf", "--json", "--certificate", "c.pdf", "--annotate", "marked")
    rows = [json.loads(line) for line in answer.out.splitlines()]
    assert sorted(row["code"] for row in rows) == list(range(3, 9))
    assert all(row["grade"] == "A" and row["stated_mm"] == 80 and row["ok"] for row in rows)
    assert (tmp_path / "c.pdf").read_bytes().startswith(b"%PDF")
    assert [p.name for p in (tmp_path / "marked").iterdir()] == ["six.pdf-1.jpg"]
    (tmp_path / "six.pdf").write_bytes((tmp_path / "six.pdf").read_bytes() + b"\n")
    answer = lmkit("verify", "six.pdf")
    assert answer.code == 2
    assert "not the file that its manifest was written for" in answer.err


def test_a_compensated_print_is_measured_as_it_will_come_out(lmkit, tmp_path):
    assert lmkit("generate", "--code", 3, "--compensate", "178.6x179.4", "-o", "c.pdf").code == 0
    (row,) = [json.loads(line) for line in lmkit("verify", "c.pdf", "--json").out.splitlines()]
    assert row["side_mm"] == pytest.approx([180, 180], abs=0.1)
    assert row["grade"] == "A"


def test_measured_sizes_go_into_the_map(lmkit, tmp_path):
    entry = "  - {code: 3, family: lm8, size_m: 0.18, position: [0, 0, 1], quaternion: [0, 0, 0, 1]}\n"
    (tmp_path / "map.yaml").write_text(f"format: lmkit-map/1\nframe: map\nlandmarks:\n{entry}")
    answer = lmkit("generate", "--code", 3, "--measured", "179.2x179.0", "--map", "map.yaml")
    assert answer.code == 2
    assert "--force" in answer.err
    answer = lmkit("generate", "--code", 3, "--measured", "179.2x179.0", "--map", "map.yaml", "-o", "new.yaml")
    assert answer.code == 0, answer.err
    assert "size_m: 0.1791" in (tmp_path / "new.yaml").read_text()
    answer = lmkit("generate", "--code", 4, "--measured", "179", "--map", "map.yaml", "--force")
    assert "no lm8 landmark of code 4" in answer.err


def test_a_bank_card_beside_the_landmark_gives_the_scale():
    """The sheet's edges are out of view; a light card lies on the white of the print, below the landmark."""
    shrink = 0.975
    photo = cv2.warpAffine(
        sheet(CODE),
        np.array([[shrink, 0, 0], [0, shrink, 0]]),
        sheet(CODE).shape[1::-1],
        borderValue=(1.0, 1.0, 1.0),
    )
    left, top = 30 * MM, 225 * MM
    photo = photo.copy()
    photo[round(top - 6 * MM) :, :] = 1.0
    # Every pixel takes the share of it that the card covers; OpenCV's polygons come out half a pixel too large.
    rows, columns = (
        np.clip(np.minimum(k + 1, start + length) - np.maximum(k, start), 0, 1)
        for k, start, length in (
            (np.arange(photo.shape[0]), top, 53.98 * MM),
            (np.arange(photo.shape[1]), left, 85.6 * MM),
        )
    )
    cover = (rows[:, None] * columns)[:, :, None]
    photo = (photo + cover * (np.array([0.25, 0.4, 0.3]) - photo)).astype(np.float32)
    found = graded(photo[: round(290 * MM), round(8 * MM) : -round(6 * MM)], scanned=False)
    assert found.scale_from == "bank card"
    # Half a pixel of the card's 212 is a quarter of a percent.
    assert found.side_mm == pytest.approx((180 * shrink, 180 * shrink), rel=0.0035)
    assert grade_of(found, "scale") in ("D", "F")


@pytest.mark.parametrize("smaller", [0.08, 0.12])
def test_a_far_landmark_reads_but_its_inks_and_scale_are_unknown(smaller):
    small = cv2.resize(photograph(1.0), None, fx=smaller, fy=smaller, interpolation=cv2.INTER_AREA)
    room = np.full((400, 400, 3), 0.4, np.float32)
    room[40 : 40 + small.shape[0], 60 : 60 + small.shape[1]] = small
    found = graded(room, scanned=False)
    assert found.observation.code == CODE
    assert found.scale_from is None
    lines = {line.name: line for line in found.lines}
    for name in ("contrast of red", "contrast of blue", "white margin", "glare", "sharpness"):
        assert lines[name].grade is None, lines[name]
    assert lines["scale"].grade == "C"
    assert "nearer" in lines["contrast of blue"].advice
    assert found.grade in "ABCDF"


def test_a_blurred_landmark_says_what_it_is_too_blurred_to_tell():
    """The blur is wider than the bars of the drawing: no cell shows one ink alone."""
    found = graded(cv2.GaussianBlur(photograph(1.0), (0, 0), 14), scanned=False)
    for line in found.lines:
        if line.name.startswith(("contrast", "color")):
            assert line.grade is None
            assert "blurred" in line.advice


def test_a_stated_size_that_was_not_measured_is_never_an_a():
    middle = sheet(CODE)[:, :][: round(205 * MM)]
    found = graded(middle, scanned=False)
    assert (found.side_mm, found.grade, grade_of(found, "scale")) == (None, "C", "C")
    assert "ruler" in next(line.advice for line in found.lines if line.name == "scale")


@pytest.mark.parametrize("stretch", [0.90, 0.93, 0.96, 1.04, 1.10])
def test_a_print_fitted_to_the_page_is_found_in_a_photograph(stretch):
    found = graded(photograph(stretch), scanned=False)
    assert found.scale_from == "a4"
    assert found.side_mm == pytest.approx((180 * stretch, 180 * stretch), rel=0.003)
    assert grade_of(found, "scale") == "F"


@pytest.mark.parametrize("shrink", [0.93, 1.0])
def test_a_sheet_on_a_cluttered_table_gives_the_scale(shrink):
    """Patches of the table are as bright as the paper, so that no threshold takes the sheet out."""
    rng = np.random.default_rng(8)
    patches = rng.uniform(0, 1, (24, 18, 3)).astype(np.float32)
    table = cv2.resize(patches, (1120, 1440), interpolation=cv2.INTER_NEAREST)
    print_ = shrunk(shrink, shrink)
    table[130 : 130 + print_.shape[0], 140 : 140 + print_.shape[1]] = 0.95 * print_
    found = graded(table, scanned=False)
    assert found.scale_from == "a4"
    assert found.side_mm == pytest.approx((180 * shrink, 180 * shrink), rel=0.004)


@pytest.mark.parametrize(("left_mm", "is_edge"), [(0.0, True), (6.6, False), (8.0, False)])
def test_a_ruler_is_not_the_edge_of_the_sheet(left_mm, is_edge):
    """Beside the ruler, whose line is 7.2 mm from the left edge and 180 of 297 mm long."""
    table = np.full((round(320 * MM), round(230 * MM)), 0.2, np.float32)
    page = sheet(CODE)[:, :, 1]
    top, left = round(10 * MM), round(10 * MM)
    table[top : top + page.shape[0], left : left + page.shape[1]] = page
    to_px = np.array([[MM, 0, left + 109.9 * MM], [0, -MM, top + 105.9 * MM], [0, 0, 1]])
    corners_mm = np.array([[left_mm, 0.0], [210.0, 0.0], [210.0, 297.0], [left_mm, 297.0]])
    quad = np.array([left, top]) - 0.5 + corners_mm * MM
    assert is_sheet(table, to_px, 90.0, quad) is is_edge


def test_a_print_of_no_stated_size_is_no_a():
    rng = np.random.default_rng(1)
    scan = cv2.GaussianBlur(photograph(1.0), (0, 0), 0.6) * 250 + rng.normal(0, 1.5, photograph(1.0).shape)
    image = np.clip(np.round(scan), 0, 255).astype(np.uint8)[:, :, ::-1].copy()
    (found,) = grade_sheet("photo", image, None, ())
    assert found.side_mm is None
    assert found.grade == "B"


@pytest.mark.parametrize(("stated", "missing"), [((CODE, 40), (40,)), ((38, 40), (40,)), ((CODE,), ())])
def test_codes_that_a_page_should_show_are_missed_where_they_do_not_read(tmp_path, stated, missing):
    path = tmp_path / "page.png"
    rgb = np.round(255 * sheet(CODE)).astype(np.uint8)
    Image.fromarray(rgb).save(path, dpi=(DPI, DPI))
    entry = {"page": 1, "family": "lm8", "version": 1, "size_mm": 180.0, "centre_mm": [105.0, 110.0]}
    manifest = {
        "format": "lmkit-prints/1", "lmkit": "0.1.0", "template": "a4", "paper_mm": [[210.0, 297.0]],
        "landmarks": [{**entry, "code": code} for code in stated],
    }  # fmt: skip
    (tmp_path / "page.png.json").write_text(json.dumps(manifest))
    (read,) = verify_sheets(path)
    assert [item.observation.code for item in read.found] == [CODE]
    assert read.missing == missing


def test_a_landmark_that_reads_only_in_a_smaller_image_is_graded_beside_one_that_reads_at_full_size():
    good = sheet(CODE)[: round(220 * MM)]
    streaked = good.copy()
    streaked[::3] = streaked[1::3] = 1.0
    rgb = np.round(255 * np.hstack([good, streaked])).astype(np.uint8)
    found = grade_sheet("photo", rgb[:, :, ::-1].copy(), None, ())
    assert [item.observation.code for item in found] == [CODE, CODE]
