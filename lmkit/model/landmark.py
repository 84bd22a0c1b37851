"""The geometry of the landmark: the one source that printing and reading share.

Numbers as in docs/landmark.md, section 2.  The landmark's plane has its origin at the center, x to
the right, y up, z toward the viewer; angles run clockwise as seen, from the triangle's apex (up).
Lengths of the drawing are millimeters at the nominal size of 180 mm and scale with the print.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.errors import InputError
from lmkit.model.codewords import code_to_gaps, codewords, gaps_to_code


@dataclass(frozen=True)
class Ring:
    """A white ring with evenly spaced gap positions.

    Attributes:
        inner_mm, outer_mm: radii.
        first_gap_deg: center of the first gap, clockwise from up.
        gap_width_deg: angular width of every gap.
        gap_count: number of gap positions.
    """

    inner_mm: float
    outer_mm: float
    first_gap_deg: float
    gap_width_deg: float
    gap_count: int = 4

    @property
    def gap_centers_deg(self) -> tuple[float, ...]:
        """Centers of the gap positions, clockwise from up."""
        return tuple(self.first_gap_deg + 360.0 / self.gap_count * k for k in range(self.gap_count))


@dataclass(frozen=True)
class LandmarkFamily:
    """One design of landmarks.  Prints outlive software, so a design never changes: a change is a new version.

    Attributes:
        name, version: e.g. ``lm8``, 1.
        side_mm: outer edge to outer edge of the red border; "size" always means this.
        border_mm: width of the red border.
        margin_mm: least width of white around the border.
        rings: from the outside in.
        triangle_mm: height of the triangle above the center and half of its base.
        distance: gap positions in which any two codes differ at least, in any quarter turn, where the
            triangle counts for two; 1 uses every word; with more, words are left out to detect misreadings.

    Examples:
        >>> import lmkit
        >>> lmkit.LM8.name, lmkit.LM8.code_count, lmkit.LM8.side_mm
        ('lm8', 256, 180.0)
    """

    name: str
    version: int
    rings: tuple[Ring, ...]
    triangle_mm: float
    distance: int = 1
    side_mm: float = 180.0
    border_mm: float = 10.0
    margin_mm: float = 10.0

    def __hash__(self) -> int:
        return self._hash

    @cached_property
    def _hash(self) -> int:
        """Hash of the numbers, stored since tables are indexed by family; hashes of text differ between processes."""
        numbers = (self.triangle_mm, self.distance, self.side_mm, self.border_mm, self.margin_mm)
        return hash((self.version, self.rings, *numbers))

    @property
    def gap_count(self) -> int:
        """Number of gap positions, one bit of the code each."""
        return sum(ring.gap_count for ring in self.rings)

    @property
    def code_count(self) -> int:
        """Number of codes: 0 to ``code_count - 1``."""
        return len(self.words)

    @cached_property
    def words(self) -> tuple[int, ...]:
        """The gaps of every code, as bits; code k is the k-th word."""
        return codewords(tuple(ring.gap_count for ring in self.rings), self.distance)

    def require_code(self, code: int) -> None:
        """Check that a code is one of the family's.

        Raises:
            InputError: the family has no such code.
        """
        if not 0 <= code < self.code_count:
            raise InputError(
                "code_range",
                f"code {code} is outside 0 to {self.code_count - 1} of family {self.name}",
                f"choose a code from 0 to {self.code_count - 1}",
            )

    def gaps(self, code: int) -> tuple[bool, ...]:
        """Which gap positions are open, from the outer ring inward, clockwise from up.

        Raises:
            InputError: the family has no such code.
        """
        self.require_code(code)
        return code_to_gaps(self.words[code], self.gap_count)

    def mirrored_code(self, code: int) -> int | None:
        """The code that a landmark reads as in a mirrored image; None where the family has no such code.

        The triangle is symmetric, and the order of each ring's gaps is reversed.  If the image is also upside down,
        the landmark reads as the same code.

        Raises:
            InputError: the family has no such code.
        """
        gaps = self.gaps(code)
        mirrored: list[bool] = []
        for ring in self.rings:
            own, gaps = gaps[: ring.gap_count], gaps[ring.gap_count :]
            centers = [round(center) % 360 for center in ring.gap_centers_deg]
            mirrored += [own[centers.index(-center % 360)] for center in centers]
        word = gaps_to_code(mirrored)
        return self.words.index(word) if word in self.words else None

    def is_drawn_like(self, other: object) -> bool:
        """True where two families share their drawing, so that a landmark of one is a landmark of the other."""
        if not isinstance(other, LandmarkFamily) or self == other:
            return False
        own, others = ((f.rings, f.triangle_mm, f.side_mm, f.border_mm) for f in (self, other))
        return own == others

    @property
    def border_color(self) -> str:
        """The color of the border, whose outer edges are the size."""
        return "red"

    @property
    def print_hint(self) -> str:
        """How to print and mount, for the sheet."""
        return "Print in color. Keep the white margin. Mount flat, with the triangle pointing up."

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
        """(4,2) outer corners of the red border: top left, then clockwise on the upright landmark."""
        h = self.half_mm
        return np.array([[-h, h], [h, h], [h, -h], [-h, -h]])

    def object_points(self, size_m: float) -> FloatArray:
        """(4,3) the outer corners in the landmark frame, meters, for a print of side ``size_m``."""
        return square_corners(size_m)


_TWO_RINGS = (
    Ring(inner_mm=60.0, outer_mm=70.0, first_gap_deg=0.0, gap_width_deg=50.0),
    Ring(inner_mm=37.0, outer_mm=47.0, first_gap_deg=45.0, gap_width_deg=70.0),
)
_THREE_RINGS = (
    Ring(inner_mm=64.0, outer_mm=74.0, first_gap_deg=0.0, gap_width_deg=60.0),
    Ring(inner_mm=47.0, outer_mm=57.0, first_gap_deg=45.0, gap_width_deg=60.0),
    Ring(inner_mm=30.0, outer_mm=40.0, first_gap_deg=0.0, gap_width_deg=60.0),
)

LM4 = LandmarkFamily("lm4", 1, (Ring(50.0, 60.0, 0.0, 60.0),), triangle_mm=38.0)
LM8 = LandmarkFamily("lm8", 1, _TWO_RINGS, triangle_mm=30.0)
LM8P = LandmarkFamily("lm8p", 1, _TWO_RINGS, triangle_mm=30.0, distance=2)
LM12 = LandmarkFamily("lm12", 1, _THREE_RINGS, triangle_mm=25.0, distance=3)
LM12H4 = LandmarkFamily("lm12h4", 1, _THREE_RINGS, triangle_mm=25.0, distance=4)

FAMILIES = {family.name: family for family in (LM4, LM8, LM8P, LM12, LM12H4)}


def square_corners(size_m: float) -> FloatArray:
    """(4,3) corners of any square landmark in its own frame, meters: top left, then clockwise as it stands.

    The order is the one ``cv2.SOLVEPNP_IPPE_SQUARE`` wants.
    """
    h = size_m / 2
    return np.array([[-h, h, 0.0], [h, h, 0.0], [h, -h, 0.0], [-h, -h, 0.0]])
