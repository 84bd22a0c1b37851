"""The report: one file, the headline first, every section there, nothing fetched."""

from __future__ import annotations

from dataclasses import replace
from html import escape
from html.parser import HTMLParser

import numpy as np
import pytest
from board_views import BOARD, views

from lmkit.calibration.sanity_checks import CalibrationWarning
from lmkit.calibration.stereo import StereoCalibration, calibrate_stereo
from lmkit.reports.calibration import calibration_report, calibration_summary

GRAY = np.full((480, 640, 3), 128, np.uint8)
SECTIONS = (
    "Key numbers", "Expected depth error", "Coverage", "Residuals", "Projection uncertainty", "Cameras",
    "Cameras and boards in space", "Pairs", "A rectified pair", "Corners as detected",
)  # fmt: skip


@pytest.fixture(scope="module")
def result() -> StereoCalibration:
    return calibrate_stereo(views(6, 0.1), BOARD, (640, 480))


class Balanced(HTMLParser):
    """Every element that is opened is closed."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []

    def handle_starttag(self, tag, attributes):
        if tag not in ("meta", "img"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_startendtag(self, tag, attributes):
        pass


def test_it_stands_alone_and_says_the_headline_first(result):
    html = calibration_report(result, BOARD, {"00": (GRAY, GRAY), "03": (GRAY, GRAY)})
    assert "http" not in html.replace("http-equiv", "")
    assert "nan" not in html.lower().replace("nano", "").replace("finance", "")
    assert html.count("data:image/jpeg;base64,") == 3
    headings = [part.split("</h2>")[0] for part in html.split("<h2>")[1:]]
    assert set(SECTIONS) <= set(headings)
    assert html.index("class='headline'") < html.index("<h2>")
    assert f"{result.held_out_epipolar_px:.3f} px" in html[: html.index("<h2>")]
    parser = Balanced()
    parser.feed(html)
    assert parser.open == []


def test_corners_that_hardly_count_are_named(result):
    assert "robust loss" not in calibration_report(result, BOARD, {})
    residuals = [(left, right.copy()) for left, right in result.residuals]
    residuals[2][1][7] = 3.0, 4.0
    html = calibration_report(replace(result, residuals=tuple(residuals)), BOARD, {})
    x, y = result.used[2].right[7]
    assert f"{result.used[2].name}, right camera, at {x:.0f}, {y:.0f}: 5.00 px." in html
    assert "-0.000" not in html.split("Residuals</h2>")[1].split("</table>")[0]


def test_names_are_no_markup(result):
    used = (replace(result.used[0], name="<script>x</script>"), *result.used[1:])
    html = calibration_report(replace(result, used=used), BOARD, {})
    assert "<script>" not in html


def test_what_was_warned_of_and_what_to_take_next_is_in_it(result):
    html = calibration_report(result, BOARD, {})
    assert result.warnings
    for warning in result.warnings:
        assert escape(warning.message) in html
    for view in result.coverage.advice:
        assert view in html


@pytest.mark.slow
def test_good_data_are_called_good_and_bad_data_poor():
    good = calibrate_stereo(views(70, 0.05, 5), BOARD, (640, 480))
    assert not good.warnings
    assert "<b>Good.</b>" in calibration_report(good, BOARD, {})
    poor = calibrate_stereo(views(14, 1.2, 3), BOARD, (640, 480))
    assert "<b>Not determined by these views.</b>" in calibration_report(poor, BOARD, {})


@pytest.mark.parametrize(
    ("code", "error_px", "headline"),
    [
        ("lenses_kept", 0.1, ("fair", "Only as good as the lenses given.")),
        ("rests_on_lenses", 0.1, ("fair", "Only as good as the lenses given.")),
        ("lenses_kept", 5.0, ("poor", "Poor.")),
        ("intrinsics_contradicted", 0.1, ("poor", "The images contradict the known lenses.")),
    ],
)
def test_the_headline_says_what_known_lenses_leave_open(result, code, error_px, headline):
    held = replace(result.held_out, epipolar_px=np.full_like(result.held_out.epipolar_px, error_px))
    warned = replace(result, held_out=held, warnings=(CalibrationWarning(code, "these lenses"),))
    *found, reason = calibration_summary(warned)
    assert tuple(found) == headline
    assert "these lenses" in reason or headline[1] == "Poor."
