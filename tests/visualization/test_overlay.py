"""Labels and outlines on images are readable at every size."""

from __future__ import annotations

import numpy as np
import pytest

from lmkit.visualization.overlay import INK, draw_label


@pytest.mark.parametrize(("width", "least_share"), [(640, 0.02), (4800, 0.01)])
def test_words_grow_with_the_image(width, least_share):
    canvas = np.full((width * 3 // 4, width, 3), 200, dtype=np.uint8)
    draw_label(canvas, "137", np.array([100.0, width / 4]))
    plate = (canvas == INK).all(axis=2).any(axis=1).sum()
    assert plate > least_share * width
