"""Limits of what counts as a square, for the search of `quads`."""

from __future__ import annotations

from typing import NamedTuple


class QuadRules(NamedTuple):
    """Limits of what counts as a square.

    Attributes:
        least_side: px.
        darker: share by which a pixel must be below its local mean or, if negative, may be above it; a ratio, so
            that the brightness of the room has no effect.
        longest: outlines of more pixel sides are ignored.
        completed_side: side from which squares with a hidden part are completed, px.
        straight: largest deviation of a straight segment, as a share of the outline's length.
        step_per_change, least_step, most_step: an outline begins only where the value falls below its local mean
            by a multiple of the median change between neighbors, within least and most gray levels.
            Noise then gives no outlines, and outlines of edges are followed into low contrast.
    """

    least_side: float
    darker: float
    longest: int
    completed_side: float
    straight: float
    step_per_change: float = 0.0
    least_step: float = 0.0
    most_step: float = 255.0
