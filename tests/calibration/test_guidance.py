"""Guidance while images are taken: which images are kept, which are not and why, and when it ends."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from board_views import BOARD, views

from lmkit.calibration.capture_guide import CaptureGuide
from lmkit.calibration.stereo import calibrate_stereo

SIZE = (640, 480)


def guide(moving: bool = False) -> CaptureGuide:
    return CaptureGuide(BOARD.object_points, SIZE, moving)


def shifted(view, dx: float):
    return replace(view, left=view.left + np.array([dx, 0]), right=view.right + np.array([dx, 0]))


def test_the_first_sharp_view_is_kept_and_its_copy_is_not():
    g = guide()
    view = views(1, 0.05)[0]
    assert g.judge(view).reason == "kept"
    assert g.judge(shifted(view, 3)).reason == "not new"
    assert len(g.views) == 1


def test_a_moving_board_waits():
    g = guide(moving=True)
    view = views(1, 0.05)[0]
    assert g.judge(shifted(view, -20)).reason == "moving"
    assert g.judge(view).reason == "moving"
    assert g.judge(shifted(view, 0.5)).reason == "kept"


def test_a_frame_without_the_board_starts_anew():
    g = guide(moving=True)
    view = views(1, 0.05)[0]
    g.judge(view)
    assert g.judge(None).reason == "no board"
    assert g.judge(view).reason == "moving"


def test_a_blurred_view_is_not_kept():
    g = guide()
    first, second = views(2, 0.05)
    assert g.judge(replace(first, noise_left=0.05, noise_right=0.05)).kept
    assert g.judge(replace(second, noise_left=0.05, noise_right=0.6)).reason == "blurred"


@pytest.mark.slow
def test_it_asks_for_what_is_missing_and_ends_when_nothing_is():
    g = guide()
    asked: list[str] = []
    for view in views(120, 0.05, 5):
        g.judge(view)
        advice = g.coverage.advice
        if not advice:
            break
        asked.append(advice[0])
    assert not g.coverage.advice
    assert any("tilted" in words for words in asked)
    assert 10 <= len(g.views) < 60
    kept = calibrate_stereo(g.views, BOARD, SIZE)
    assert kept.coverage.advice == ()
    assert not [w for w in kept.warnings if w.code in ("coverage", "few_pairs")]


@pytest.mark.slow
def test_tilts_are_named_from_the_side_that_is_nearer():
    g = guide()
    for view in views(60, 0.0, 7):
        g.judge(view)

    # The board's left edge is longer in the image when it is nearer.
    def height(view, column):
        at = view.left.reshape(6, 9, 2)[:, column]
        return np.linalg.norm(at[-1] - at[0])

    nearer = [height(v, 8) - height(v, 0) for v in g.views]
    strong = np.abs(g.coverage.tilts_deg[:, 0]) > 15
    agree = np.sign(nearer) == np.sign(g.coverage.tilts_deg[:, 0])
    assert strong.sum() > 5
    assert agree[strong].mean() > 0.9
