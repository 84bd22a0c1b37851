"""Grades of printed square markers: planted defects are named by the right line, good sheets have no finding."""

from __future__ import annotations

import json
from functools import lru_cache

import cv2
import numpy as np
import pypdfium2
import pytest

from lmkit.detection.config import DetectOptions
from lmkit.generation.pdf import pages_to_pdf
from lmkit.generation.sheet import compose_landmark_page
from lmkit.io.template import load_template
from lmkit.model.families import family_named
from lmkit.model.palette import linear_to_srgb, srgb_to_linear
from lmkit.model.square_marker import SQUARE_FAMILIES
from lmkit.verification.prints import PrintedLandmark, Stated, grade_sheet

DPI, SIZE_MM, CODE = 60.0, 150.0, 7
MM = DPI / 25.4


@lru_cache(maxsize=4)
def sheet(family: str = "tag36h11") -> np.ndarray:
    """(H,W,3) linear light of the A4 sheet, ink a little gray."""
    page = compose_landmark_page(family_named(family), CODE, SIZE_MM, load_template("a4"))
    pdf = pypdfium2.PdfDocument(pages_to_pdf([page], ""))
    rgb = np.asarray(pdf[0].render(scale=4 * DPI / 72).to_pil().convert("RGB"), dtype=np.float32) / 255
    light = srgb_to_linear(rgb).astype(np.float32)
    return 0.04 + 0.92 * cv2.resize(light, None, fx=0.25, fy=0.25, interpolation=cv2.INTER_AREA)


def graded(
    light: np.ndarray, family: str = "tag36h11", scanned: bool = True, code: int = CODE, states: bool = True
) -> PrintedLandmark:
    encoded = 255 * linear_to_srgb(np.clip(cv2.GaussianBlur(light, (0, 0), 0.6), 0, 1).astype(np.float64))
    image = np.round(encoded + np.random.default_rng(1).normal(0, 1.5, encoded.shape)).clip(0, 255).astype(np.uint8)
    stated = (Stated(code, family_named(family), SIZE_MM),) if states else ()
    options = DetectOptions((family_named(family),))
    (found,) = grade_sheet("scan", image[:, :, ::-1].copy(), (DPI, DPI) if scanned else None, stated, options)
    return found


def grade_of(found: PrintedLandmark, name: str) -> str | None:
    return next(line.grade for line in found.lines if line.name == name)


def shrunk(sx: float, sy: float) -> np.ndarray:
    height, width = sheet().shape[:2]
    return cv2.warpAffine(sheet(), np.array([[sx, 0, 8.0], [0, sy, 6.0]]), (width, height), borderValue=(0.96,) * 3)


def blotched() -> np.ndarray:
    y, x = np.mgrid[: sheet().shape[0], : sheet().shape[1]] / MM
    return sheet() + np.clip(1.4 - np.hypot(x - 60, y - 75) / 24, 0, 1)[:, :, None] * (0.96 - sheet())


def striped() -> np.ndarray:
    bare = (np.arange(sheet().shape[0]) / MM % 14 < 2)[:, None, None]
    return np.where(bare, 0.4 + 0.56 * sheet(), sheet())


def faded() -> np.ndarray:
    """One black cell inside the border, nearly gray."""
    light, cell = sheet().copy(), SIZE_MM / 8 * MM
    dark, cells = light[:, :, 1] < 0.3, family_named("tag36h11").darkness(CODE)
    top, left = (int(np.flatnonzero(dark.sum(axis=axis) > 0.9 * SIZE_MM * MM)[0]) for axis in (1, 0))
    row, column = next((r, c) for r in range(1, 7) for c in range(1, 7) if cells[r, c] > 0.5)
    y, x = (round(first + number * cell) for first, number in ((top, row), (left, column)))
    part = light[y : y + round(cell), x : x + round(cell)]
    part += 0.5 * (0.96 - part)
    return light


def cut() -> np.ndarray:
    """Cut 3 mm above the border, before something dark."""
    light = sheet().copy()
    y = np.flatnonzero(light[:, light.shape[1] // 2, 1] < 0.3)[0]
    light[: y - round(3 * MM)] = 0.1
    return light


PLANTED = {
    "scale": (lambda: shrunk(0.97, 0.97), "DF"),
    "X to Y": (lambda: shrunk(1.0, 0.98), "DF"),
    "modulation of cells": (faded, "CDF"),
    "contrast of black": (lambda: sheet() + 0.5 * (0.96 - sheet()), "CDF"),
    "glare": (blotched, "CDF"),
    "white margin": (cut, "CDF"),
    "evenness": (striped, "CDF"),
    "sharpness": (lambda: cv2.GaussianBlur(sheet(), (0, 0), 0.018 * SIZE_MM * MM), "CDF"),
    "border straightness": (lambda: curved(0.04), "CDF"),
}


def curved(share: float) -> np.ndarray:
    """Every column shifted, the central one by a share of the side."""
    height, width = sheet().shape[:2]
    y, x = np.mgrid[:height, :width].astype(np.float32)
    shift = share * SIZE_MM * MM * np.cos((x - width / 2) / (SIZE_MM * MM) * np.pi)
    return cv2.remap(sheet(), x, y + shift.astype(np.float32), cv2.INTER_LINEAR, borderValue=(0.96,) * 3)


def photograph(stretch: float) -> np.ndarray:
    """(1000,800,3) the whole sheet, tilted, with its drawing stretched on the same paper."""
    height, width = sheet().shape[:2]
    A = np.array([[stretch, 0, (1 - stretch) * width / 2], [0, stretch, (1 - stretch) * height / 2]])
    paper = cv2.warpAffine(sheet(), A, (width, height), borderValue=(0.96,) * 3)
    corners = np.array([[90, 50], [690, 90], [660, 930], [70, 900]], dtype=np.float32)
    outline = np.array([[0, 0], [width, 0], [width, height], [0, height]], dtype=np.float32) - 0.5
    H = cv2.getPerspectiveTransform(outline, corners)
    return cv2.warpPerspective(paper, H, (800, 1000), flags=cv2.INTER_LINEAR, borderValue=(0.12, 0.1, 0.09))


@pytest.mark.parametrize("family", ["tag36h11", "aruco4x4_50"])
def test_a_good_scan_is_an_a(family):
    found = graded(sheet(family), family)
    assert found.grade == "A", found.lines
    assert found.observation.id.family == family
    assert found.side_mm == pytest.approx((SIZE_MM, SIZE_MM), abs=0.2)
    assert all(line.grade is not None for line in found.lines)


@pytest.mark.parametrize("name", PLANTED)
def test_a_planted_defect_is_named(name):
    spoil, severity = PLANTED[name]
    found = graded(spoil())
    assert grade_of(found, name) in tuple(severity), found.lines
    assert next(line.advice for line in found.lines if line.name == name)


@pytest.mark.parametrize(("stretch", "grade"), [(1.0, "A"), (0.97, "F")])
def test_a_photograph_takes_its_scale_from_the_sheets_edges(stretch, grade):
    found = graded(photograph(stretch), scanned=False)
    assert found.scale_from == "a4"
    assert found.side_mm == pytest.approx((stretch * SIZE_MM, stretch * SIZE_MM), rel=0.003)
    assert grade_of(found, "scale") == grade, found.lines


def test_a_narrow_margin_before_something_dark_does_not_move_the_edges():
    found = graded(cut())
    assert found.side_mm == pytest.approx((SIZE_MM, SIZE_MM), rel=0.004)


def test_a_print_of_no_stated_size_is_no_a():
    found = graded(photograph(1.0), scanned=False, states=False)
    assert (found.side_mm, found.grade) == (None, "B")


def test_wrong_mirrored_and_inverted_markers_are_named():
    assert graded(sheet(), code=8).problems == ("content: reads as code 7, but its label states 8",)
    mirrored = graded(np.ascontiguousarray(sheet()[:, ::-1]))
    assert mirrored.problems == ("content: code 7 of tag36h11, but mirrored",)
    assert grade_of(mirrored, "scale") == "A"
    plain = graded(sheet()).observation.corners
    assert np.abs(sheet().shape[1] - 1 - mirrored.observation.corners[:, 0] - plain[:, 0]).max() < 0.3
    inverted = graded(1 - sheet())
    assert "content: code 7 of tag36h11, but white on black" in inverted.problems


def test_a_mirrored_marker_that_reads_as_another_is_named():
    family = SQUARE_FAMILIES["aruco4x4_1000"]
    pairs = [(code, family.mirrored_code(code)) for code in range(300)]
    assert all(other is None or family.mirrored_code(other) is not None for _, other in pairs)
    assert any(other is not None for _, other in pairs)
    assert SQUARE_FAMILIES["tag36h11"].mirrored_code(7) is None


def test_the_command_grades_prints_of_generate(lmkit, tmp_path):
    assert lmkit("generate", "--family", "tag36h11", "--codes", "3-4", "-o", "tags.pdf").code == 0
    answer = lmkit("verify", "tags.pdf", "--json", "--certificate", "c.pdf")
    rows = [json.loads(line) for line in answer.out.splitlines()]
    assert [(row["id"], row["grade"], row["stated_code"]) for row in rows] == [
        ("tag36h11:3", "A", 3),
        ("tag36h11:4", "A", 4),
    ]
    assert rows[0]["side_mm"] == pytest.approx([rows[0]["stated_mm"]] * 2, abs=0.1)
    assert (tmp_path / "c.pdf").read_bytes().startswith(b"%PDF")
