"""Squares of which a corner or a piece of one side is hidden; benchmarks/hidden.py has many more."""

from __future__ import annotations

from itertools import product

import cv2
import numpy as np
import pytest
from simulated import shoot

from lmkit.detection.detector import detect_landmarks

COVERS = {
    # As shares of the landmark's box; all gap positions stay visible.
    "corner": [[0.55, -0.3], [1.3, -0.3], [1.3, 0.45]],
    "corner and a piece of the side": [[0.1, -0.3], [0.1, 0.25], [-0.4, 0.25], [-0.4, -0.3]],
}


@pytest.mark.parametrize("color", [15, 200])
@pytest.mark.parametrize("name", COVERS)
def test_the_square_is_completed_and_read(name, color):
    """Dark objects merge with the border: without completion, only 5 of 8 of the second kind are read."""
    read = 0
    for seed in range(8):
        image, corners = shoot(100 + seed, 36, 4.0 * seed, 20.0, seed=seed)
        low, size = corners.min(axis=0), np.ptp(corners, axis=0)
        cover = np.round(low + np.array(COVERS[name]) * size).astype(np.int32)
        found = detect_landmarks(cv2.fillPoly(image.copy(), [cover], (color, color, color)))
        assert [d.code for d in found] in ([100 + seed], [])
        read += len(found)
    assert read >= 7, f"{read} of 8"


def test_a_corner_behind_something_that_joins_the_square_to_its_surroundings_is_completed():
    """The square's outline continues around the sheet; the outline of its margin, a strip, has the square's sides."""
    read = 0
    for seed, (side, gray) in product(range(6), ((36, 120), (50, 83))):
        image, corners = shoot(60 + seed, side, 5.0 * seed, 15.0, seed=seed)
        low, size = corners.min(axis=0), np.ptp(corners, axis=0)
        cover = np.round(low + np.array([[0.55, -0.12], [1.5, -1.0], [2.0, 0.5], [1.12, 0.45]]) * size)
        found = detect_landmarks(cv2.fillPoly(image, [cover.astype(np.int32)], (gray, gray, gray)))
        read += [d.code for d in found] == [60 + seed]
    assert read >= 8, f"{read} of 12"


def over_a_gap(code: int, color: tuple[int, int, int], seed: int) -> np.ndarray:
    """A landmark of 40 px with a patch of its paper or its ground over the upper gap position of the outer ring."""
    image, corners = shoot(code, 40.0, seed=seed)
    low, size = corners.min(axis=0), np.ptp(corners, axis=0)
    patch = np.round(low + np.array([[0.34, 0.03], [0.70, 0.06], [0.68, 0.21], [0.32, 0.19]]) * size)
    return cv2.fillPoly(image, [patch.astype(np.int32)], color)


@pytest.mark.parametrize(("open_gap", "color"), [(1, (225, 225, 225)), (0, (120, 110, 70)), (0, (30, 30, 30))])
def test_a_patch_over_a_gap_makes_no_other_code(open_gap, color):
    """A bright patch over an open gap is taken for the ring, a dark one over the ring for a gap."""
    for seed in range(6):
        code = 21 + 17 * seed | open_gap << 7
        code = code if open_gap else code & 127
        assert {d.code for d in detect_landmarks(over_a_gap(code, color, seed))} <= {code}
