"""The geometry of the landmark: the one source that printing and reading share.

Numbers as in docs/landmark.md, section 2.  The landmark's plane has its origin in the middle, x to
the right, y up, z towards the viewer; angles run clockwise as seen, from the triangle's apex (up).
Lengths of the drawing are millimetres at the nominal size of 180 mm and scale with the print.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.errors import InputError


@dataclass(frozen=True)
class Ring:
    """A white ring with evenly spaced gap positions.

    Attributes:
        inner_mm, outer_mm: radii.
        first_gap_deg: centre of the first gap, clockwise from up.
        gap_width_deg: angular width of every gap.
        gap_count: number of gap positions.
    """

    inner_mm: float
    outer_mm: float
    first_gap_deg: float
    gap_width_deg: float
    gap_count: int = 4

    @property
    def gap_centres_deg(self) -> tuple[float, ...]:
        """Centres of the gap positions, clockwise from up."""
        return tuple(self.first_gap_deg + 360.0 / self.gap_count * k for k in range(self.gap_count))


@dataclass(frozen=True)
class LandmarkFamily:
    """One frozen design of landmark; printed paper outlives software, so a change is a new version.

    Attributes:
        name, version: e.g. ``lm8``, 1.
        side_mm: outer edge to outer edge of the red border; "size" always means this.
        border_mm: width of the red border.
        margin_mm: least width of white around the border.
        rings: from the outside in.
        triangle_mm: height of the triangle above the centre and half of its base.
    """

    name: str
    version: int
    rings: tuple[Ring, ...]
    triangle_mm: float
    side_mm: float = 180.0
    border_mm: float = 10.0
    margin_mm: float = 10.0

    @property
    def gap_count(self) -> int:
        """Number of gap positions, one bit of the code each."""
        return sum(ring.gap_count for ring in self.rings)

    @property
    def code_count(self) -> int:
        """Number of codes: 0 to ``code_count - 1``."""
        return 1 << self.gap_count

    @property
    def half_mm(self) -> float:
        """Half of the side."""
        return self.side_mm / 2

    @property
    def ground_half_mm(self) -> float:
        """Half of the side of the blue ground."""
        return self.half_mm - self.border_mm

    @property
    def triangle_vertices_mm(self) -> FloatArray:
        """(3,2) apex, right end of the base, left end, in the landmark's plane."""
        t = self.triangle_mm
        return np.array([[0.0, t], [t, 0.0], [-t, 0.0]])

    @property
    def corners_mm(self) -> FloatArray:
        """(4,2) outer corners of the red border: top left, then clockwise as the landmark stands."""
        h = self.half_mm
        return np.array([[-h, h], [h, h], [h, -h], [-h, -h]])

    def object_points(self, size_m: float) -> FloatArray:
        """(4,3) the outer corners in the landmark frame, metres, for a print of side ``size_m``.

        The order is the one ``cv2.SOLVEPNP_IPPE_SQUARE`` wants.
        """
        return np.column_stack([self.corners_mm / self.side_mm * size_m, np.zeros(4)])


LM8 = LandmarkFamily(
    name="lm8",
    version=1,
    rings=(
        Ring(inner_mm=60.0, outer_mm=70.0, first_gap_deg=0.0, gap_width_deg=50.0),
        Ring(inner_mm=37.0, outer_mm=47.0, first_gap_deg=45.0, gap_width_deg=70.0),
    ),
    triangle_mm=30.0,
)

FAMILIES = {LM8.name: LM8}


def family_named(name: str) -> LandmarkFamily:
    """The family called ``name``.

    Raises:
        InputError: there is none.
    """
    try:
        return FAMILIES[name]
    except KeyError:
        raise InputError(
            "unknown_family", f"there is no landmark family {name!r}", f"known: {', '.join(FAMILIES)}"
        ) from None
