"""Square markers of black and white cells: AprilTag and ArUco families (bit tables: OpenCV's dictionaries).

A marker is a square of cells: a black border one cell wide, the code's cells inside, white paper around.  Its size is
the outer edge of the BLACK BORDER, as for `cv2.aruco` and for the AprilTag project's ``tag size``, not of the white
paper.  The frame is a landmark's: origin at the center, x to the right, y up, z toward the viewer.

OpenCV draws AprilTags upside down.  Here they are upright as printed by the AprilTag project, so maps of WPILib and
apriltag_ros can be used unchanged.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lmkit.arrays import BoolArray, FloatArray
from lmkit.errors import InputError

TURNED_BY_OPENCV = 2  # quarter turns of AprilTags


@dataclass(frozen=True)
class SquareMarkerFamily:
    """One family of square markers.

    Attributes:
        name: as in ``tag36h11`` or ``aruco4x4_50``.
        bits: code cells along a side.
        distance: cells in which any two codes differ at least, in any quarter turn.
        dictionary: name of OpenCV's dictionary, without ``DICT_``.
        is_apriltag: drawn upside down by OpenCV.
        code_count: number of codes.
        border_cells, margin_cells: width of the black border and of the white margin that must be around it.
        side_mm: outer edge of the black border of a nominal print.
    """

    name: str
    bits: int
    distance: int
    dictionary: str
    code_count: int
    is_apriltag: bool = False
    border_cells: int = 1
    margin_cells: int = 1
    side_mm: float = 180.0
    version: int = 1

    @property
    def cells(self) -> int:
        """Cells along a side, border included."""
        return self.bits + 2 * self.border_cells

    @property
    def cell_mm(self) -> float:
        """Side of a cell."""
        return self.side_mm / self.cells

    @property
    def border_mm(self) -> float:
        """Width of the black border."""
        return self.border_cells * self.cell_mm

    @property
    def margin_mm(self) -> float:
        """Least width of white around the border."""
        return self.margin_cells * self.cell_mm

    @property
    def border_color(self) -> str:
        """The color of the border, whose outer edges are the size."""
        return "black"

    @property
    def print_hint(self) -> str:
        """How to print and mount, for the sheet."""
        return "Keep the white margin. Mount flat, upright as on this page."

    @property
    def half_mm(self) -> float:
        """Half of the side."""
        return self.side_mm / 2

    @property
    def ground_half_mm(self) -> float:
        """Half of the side of the square of the code's cells."""
        return self.half_mm - self.border_mm

    @property
    def corners_mm(self) -> FloatArray:
        """(4,2) outer corners of the black border: top left, then clockwise as the marker stands."""
        h = self.half_mm
        return np.array([[-h, h], [h, h], [h, -h], [-h, -h]])

    @cached_property
    def white(self) -> BoolArray:
        """(code_count,bits,bits) white cells of every code, row by row from the top left."""
        import cv2

        number = getattr(cv2.aruco, f"DICT_{self.dictionary}")
        dictionary = cv2.aruco.getPredefinedDictionary(number)
        drawn = [cv2.aruco.generateImageMarker(dictionary, code, self.bits + 2) for code in range(self.code_count)]
        table = np.asarray(drawn)[:, 1:-1, 1:-1] > 127
        return np.rot90(table, TURNED_BY_OPENCV, axes=(1, 2)) if self.is_apriltag else table

    def chance(self, wrong_cells: int) -> float:
        """Share of random insides that differ from any code, in any quarter turn, by at most a number of cells."""
        near = sum(math.comb(self.bits**2, wrong) for wrong in range(wrong_cells + 1))
        return min(4 * self.code_count * near / 2.0 ** (self.bits**2), 1.0)

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

    def darkness(self, code: int) -> FloatArray:
        """(cells,cells) 1 for black cells, 0 for white ones, border included.

        Raises:
            InputError: the family has no such code.
        """
        self.require_code(code)
        return np.pad(1.0 - self.white[code], self.border_cells, constant_values=1.0)

    def mirrored_code(self, code: int) -> int | None:
        """The code that a marker reads as in a mirrored image; None where the family has no such code, as is usual.

        Raises:
            InputError: the family has no such code.
        """
        self.require_code(code)
        mirrored = self.white[code][:, ::-1]
        alike = [(self.white == np.rot90(mirrored, turns)).all(axis=(1, 2)) for turns in range(4)]
        found = np.flatnonzero(np.any(alike, axis=0))
        return int(found[0]) if len(found) else None

    def object_points(self, size_m: float) -> FloatArray:
        """(4,3) outer corners of the black border in the marker's frame, meters, for a side of ``size_m``."""
        return np.column_stack([self.corners_mm * (size_m / self.side_mm), np.zeros(4)])

    def is_drawn_like(self, other: object) -> bool:
        """True where another family has a marker that could be one of these: the dictionaries are nested."""
        if not isinstance(other, SquareMarkerFamily) or self == other or self.bits != other.bits:
            return False
        turned = [np.rot90(other.white, k, axes=(1, 2)).reshape(other.code_count, -1) for k in range(4)]
        return bool({row.tobytes() for row in self.white.reshape(self.code_count, -1)} & _rows(turned))


def _rows(tables: list[BoolArray]) -> set[bytes]:
    return {np.ascontiguousarray(row).tobytes() for table in tables for row in table}


def _aruco(bits: int, distances: dict[int, int]) -> list[SquareMarkerFamily]:
    return [
        SquareMarkerFamily(f"aruco{bits}x{bits}_{count}", bits, distance, f"{bits}X{bits}_{count}", count)
        for count, distance in distances.items()
    ]


SQUARE_FAMILIES = {
    family.name: family
    for family in (
        SquareMarkerFamily("tag16h5", 4, 5, "APRILTAG_16H5", 30, is_apriltag=True),
        SquareMarkerFamily("tag25h9", 5, 9, "APRILTAG_25H9", 35, is_apriltag=True),
        SquareMarkerFamily("tag36h10", 6, 10, "APRILTAG_36H10", 2320, is_apriltag=True),
        SquareMarkerFamily("tag36h11", 6, 11, "APRILTAG_36H11", 587, is_apriltag=True),
        *_aruco(4, {50: 4, 100: 3, 250: 3, 1000: 2}),
        *_aruco(5, {50: 8, 100: 7, 250: 6, 1000: 5}),
        *_aruco(6, {50: 13, 100: 12, 250: 11, 1000: 9}),
        *_aruco(7, {50: 19, 100: 18, 250: 17, 1000: 14}),
        SquareMarkerFamily("aruco_original", 5, 0, "ARUCO_ORIGINAL", 1024),
        SquareMarkerFamily("aruco_mip_36h12", 6, 12, "ARUCO_MIP_36H12", 250),
    )
}
