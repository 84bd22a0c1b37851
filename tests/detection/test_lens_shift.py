"""The interpolated map of a known lens agrees with the lens."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lmkit.detection.linear_image import _lens_shift, _LensKey, _straightened
from lmkit.simulation.scene import make_rig


@pytest.mark.parametrize("size", [(640, 480), (637, 481)])
def test_every_pixel_is_straightened_as_the_lens_has_it(size):
    camera = replace(make_rig().left, image_size=size)
    y, x = np.mgrid[: size[1] : 7, : size[0] : 7]
    at = np.column_stack([x.ravel(), y.ravel()]).astype(float)
    exact = (_straightened(camera, at) - at).reshape(*x.shape, 2)
    np.testing.assert_allclose(_lens_shift(_LensKey(camera))[::7, ::7], exact, atol=2e-4)
