"""Squares of which a corner or a piece of one side is hidden; benchmarks/hidden.py has many more."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from simulated import shoot

from lmkit.detection.detector import detect_landmarks

COVERS = {
    # In shares of the landmark's box; all gap positions are left clear.
    "corner": [[0.55, -0.3], [1.3, -0.3], [1.3, 0.45]],
    "corner and a piece of the side": [[0.1, -0.3], [0.1, 0.25], [-0.4, 0.25], [-0.4, -0.3]],
}


@pytest.mark.parametrize("color", [15, 200])
@pytest.mark.parametrize("name", COVERS)
def test_the_square_is_completed_and_read(name, color):
    """Dark things merge with the border: without completion only 5 of 8 of the second kind are read."""
    read = 0
    for seed in range(8):
        image, corners = shoot(100 + seed, 36, 4.0 * seed, 20.0, seed=seed)
        low, size = corners.min(axis=0), np.ptp(corners, axis=0)
        cover = np.round(low + np.array(COVERS[name]) * size).astype(np.int32)
        found = detect_landmarks(cv2.fillPoly(image.copy(), [cover], (color, color, color)))
        assert [d.code for d in found] in ([100 + seed], [])
        read += len(found)
    assert read >= 7, f"{read} of 8"
