"""Short names of landmark ids for tests."""

from __future__ import annotations

from lmkit.model.landmark_id import LandmarkId


def lm8(code: int) -> LandmarkId:
    """The id of a code of family lm8."""
    return LandmarkId("lm8", code)
