"""Images of a step with their detections, as one JPEG: for the page, and for a topic of ROS 2."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lmkit.arrays import ByteArray
from lmkit.live.state import CameraView, LiveState
from lmkit.model.observation import Detection

SHOWN_PX = 480  # width of each camera's image
QUALITY = 80  # of the JPEG


def annotated_jpeg(state: LiveState) -> bytes:
    """Images of all cameras side by side with the landmarks outlined, as JPEG; empty without an image."""
    from lmkit.visualization.overlay import encode_jpeg

    shown = [_drawn(view, state) for view in state.views if view.image is not None]
    if not shown:
        return b""
    height = max(image.shape[0] for image in shown)
    padded = [np.pad(image, ((0, height - image.shape[0]), (0, 0), (0, 0))) for image in shown]
    return encode_jpeg(np.asarray(np.hstack(padded), dtype=np.uint8), QUALITY)


def _drawn(view: CameraView, state: LiveState) -> ByteArray:
    """A camera's image, reduced: read landmarks green, outliers red, expected but unread ones magenta."""
    import cv2

    from lmkit.visualization.overlay import GREEN, MAGENTA, RED, draw_landmarks

    assert view.image is not None
    factor = SHOWN_PX / view.image.shape[1]
    size = (SHOWN_PX, round(factor * view.image.shape[0]))
    small = np.asarray(cv2.resize(view.image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    read = [replace(d, corners=(d.corners + 0.5) * factor - 0.5, covariance=None) for d in view.detections]
    names = {d.id for d in read}
    unread = [
        Detection(name, (corners + 0.5) * factor - 0.5, 0.0, 0.0)
        for name, corners in view.expected.items()
        if name not in names and np.isfinite(corners).all()
    ]
    colors = [RED if d.id in state.outliers else GREEN for d in read] + [MAGENTA] * len(unread)
    labels = [str(d.code) for d in read] + [f"{d.code}?" for d in unread]
    return draw_landmarks(small, [*read, *unread], enlarge=1, labels=labels, outlines=colors)
