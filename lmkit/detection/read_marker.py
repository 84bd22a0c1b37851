"""A marker of any family at a known place of a sharp image."""

from __future__ import annotations

from lmkit.arrays import ByteArray, FloatArray
from lmkit.detection.register_and_decode import Candidate, read_landmark_at
from lmkit.detection.tag_registration import TagCandidate, read_tag_at
from lmkit.model.families import MarkerFamily
from lmkit.model.square_marker import SquareMarkerFamily


def read_marker_at(image: ByteArray, corners: FloatArray, family: MarkerFamily) -> Candidate | TagCandidate | None:
    """Read the marker at (4,2) known corners, px, clockwise as seen; None if there is none."""
    if isinstance(family, SquareMarkerFamily):
        return read_tag_at(image, corners, family)
    return read_landmark_at(image, corners, family)
