"""Pages of a PDF as images, by a renderer that is not lmkit's own."""

from __future__ import annotations

import cv2
import numpy as np
import pypdfium2

from lmkit.arrays import ByteArray
from lmkit.model.palette import SRGB_TO_LINEAR, linear_to_srgb


def raster_page(page: pypdfium2.PdfPage, dpi: float, finer: int = 2) -> tuple[ByteArray, tuple[float, float]]:
    """(H,W,3) BGR near ``dpi``, and its exact dots per inch in x and y; edges smoothed in linear light.

    The renderer smooths edges in code values, which enlarges dark shapes by a fraction of a pixel;
    drawing at ``finer`` times the resolution and averaging linear light reduces this to half a fine pixel.
    """
    drawn = page.render(scale=finer * dpi / 72).to_numpy()  # (H,W,3) BGR
    height, width = drawn.shape[0] // finer, drawn.shape[1] // finer
    light = cv2.LUT(drawn[: finer * height, : finer * width], SRGB_TO_LINEAR)
    mean = np.asarray(cv2.resize(light, (width, height), interpolation=cv2.INTER_AREA), dtype=np.float32)
    # The page is drawn into whole pixels, which stretches it by up to one pixel.
    points = page.get_size()
    exact = (drawn.shape[1] / finer / points[0] * 72, drawn.shape[0] / finer / points[1] * 72)
    return np.round(linear_to_srgb(mean) * 255).astype(np.uint8), exact
