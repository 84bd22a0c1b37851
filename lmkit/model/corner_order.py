"""Corner order of detections: corners of a printed landmark run clockwise in the image, from its top left corner."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from lmkit.arrays import BoolArray, FloatArray
from lmkit.errors import InputError
from lmkit.model.observation import Detection

LEAST = 4  # detections, of which nearly all must run backwards
NEARLY_ALL = 0.9


def runs_backwards(corners: FloatArray) -> BoolArray:
    """(N,) whether (N,4,2) corners (px, y down) run counter-clockwise; seen from its face no landmark's do."""
    x, y = corners[..., 0], corners[..., 1]
    area = (x * np.roll(y, -1, axis=-1) - np.roll(x, -1, axis=-1) * y).sum(axis=-1)
    return np.asarray(area < 0)


def require_clockwise(detections: Iterable[Detection], where: str = "detections") -> None:
    """Refuse detections whose corners run counter-clockwise, as those of the AprilTag library do.

    Args:
        where: the file, named in the error.

    Raises:
        InputError: ``corner_order``, where nearly all run backwards; a few may be misread.
    """
    corners: Sequence[FloatArray] = [detection.corners for detection in detections]
    if len(corners) < LEAST:
        return
    backwards = runs_backwards(np.array(corners))
    if backwards.mean() >= NEARLY_ALL:
        raise InputError(
            "corner_order",
            f"{where}: the corners of {int(backwards.sum())} of {len(corners)} detections are in another order: they "
            "run counter-clockwise in the image, as the AprilTag library writes them",
            "write the corners from the top left one clockwise: AprilTag's order reversed (p[3], p[2], p[1], p[0]); "
            "in a CSV file, name its columns x3,y3,x2,y2,x1,y1,x0,y0",
        )
