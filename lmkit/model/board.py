"""Calibration boards, named as on the command line: ``chessboard:9x6:30mm``."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.errors import InputError
from lmkit.model.families import family_named
from lmkit.model.landmark import LM8
from lmkit.model.square_marker import SquareMarkerFamily
from lmkit.units import parse_length_mm

KINDS = ("chessboard", "charuco", "landmarks", "aprilgrid")
KALIBR_BORDER = 2  # black cells around the tags of an AprilGrid; single tags have one
MOST_STRETCH = 0.1
SQUARES_MM = (0.5, 2000.0)  # outside, the unit is wrong
LEAST_GAP = 1 / 9  # of a landmark's side: the white that two neighbors need between them
_HINT = (
    "write chessboard:9x6:30mm (inner corners and square), "
    "charuco:8x6:30mm:22mm:DICT_5X5_100 (squares, square, marker, dictionary; :legacy and the first id may follow), "
    "landmarks:4x3:60mm:48mm (landmarks, middle to middle, side; the first code may follow) or "
    "aprilgrid:6x6:22mm:0.3 (tags, side, gap over side, as in Kalibr; a family may follow)"
)


@dataclass(frozen=True)
class BoardSpec:
    """A flat calibration target.

    Attributes:
        kind: ``chessboard``, ``charuco``, ``landmarks`` or ``aprilgrid``.
        columns, rows: chessboard: INNER corners; charuco: squares; landmarks, aprilgrid: landmarks.
        square_mm: side of a square; landmarks, aprilgrid: from center to center.
        marker_mm: side of a marker (charuco) or landmark (landmarks, aprilgrid).
        dictionary: name of the marker dictionary (charuco) or of the family (aprilgrid).
        legacy: the marker layout of OpenCV before 4.6 (charuco with an even number of rows).
        first_code: of the landmark or marker at the top left; the others follow row by row (landmarks, charuco).
        stretch: measured size divided by nominal size of the print, in x and y.

    Examples:
        >>> import lmkit
        >>> board = lmkit.BoardSpec.parse("chessboard:9x6:25mm")
        >>> board.kind, board.columns, board.rows, board.square_mm
        ('chessboard', 9, 6, 25.0)
    """

    kind: str
    columns: int
    rows: int
    square_mm: float
    marker_mm: float = 0.0
    dictionary: str = ""
    legacy: bool = False
    first_code: int = 0
    stretch: tuple[float, float] = (1.0, 1.0)

    @classmethod
    def parse(cls, text: str) -> BoardSpec:
        """Read a specification, such as ``chessboard:9x6:30mm``; see the hint of its errors for the others.

        Raises:
            InputError: the text is not such a specification.
        """
        kind, *parts = text.strip().split(":")
        counts = {"chessboard": (2,), "charuco": (4, 5, 6), "landmarks": (3, 4), "aprilgrid": (3, 4)}.get(kind)
        if counts is None or len(parts) not in counts:
            raise InputError("bad_board", f"board {text!r} is not a board specification", _HINT)
        least = 1 if kind in ("landmarks", "aprilgrid") else 2
        columns, _, rows = parts[0].lower().partition("x")
        if not (columns.isdecimal() and rows.isdecimal() and all(least <= int(n) <= 100 for n in (columns, rows))):
            raise InputError("bad_board", f"{parts[0]!r} in board {text!r} is not COLUMNSxROWS", _HINT)
        size = (int(columns), int(rows))
        square_mm = parse_length_mm(parts[1], f"square of board {text!r}")
        if not SQUARES_MM[0] <= square_mm <= SQUARES_MM[1]:
            message = f"square {parts[1]} of board {text!r} is outside {SQUARES_MM[0]:g} to {SQUARES_MM[1]:g} mm"
            raise InputError("bad_board", message, "check the unit; 30mm is usual")
        if kind == "chessboard":
            return cls(kind, *size, square_mm)
        if kind == "aprilgrid":
            return _april_grid(size, square_mm, parts[2:], text)
        marker_mm = parse_length_mm(parts[2], f"marker of board {text!r}")
        if kind == "charuco":
            if marker_mm >= square_mm:
                raise InputError(
                    "bad_board", f"marker {parts[2]} of board {text!r} is not smaller than its square", _HINT
                )
            more = parts[4:]
            firsts = [int(word) for word in more if word.isdecimal() and len(word) < 6]
            if len(more) != len(firsts) + more.count("legacy") or max(len(firsts), more.count("legacy")) > 1:
                raise InputError("bad_board", f"board {text!r} is not a board specification", _HINT)
            return cls(kind, *size, square_mm, marker_mm, parts[3].upper(), "legacy" in more, sum(firsts))
        if square_mm < marker_mm * (1 + LEAST_GAP):
            raise InputError(
                "bad_board",
                f"landmarks of {parts[2]} every {parts[1]} leave less than {LEAST_GAP * marker_mm:.3g} mm of white",
                f"place them at least {marker_mm * (1 + LEAST_GAP):.4g}mm apart",
            )
        first = parts[3] if len(parts) == 4 else "0"
        if not first.isdecimal() or int(first) + size[0] * size[1] > LM8.code_count:
            raise InputError(
                "bad_board",
                f"first code {first!r} of board {text!r}: the board needs {size[0] * size[1]} codes in 0 to "
                f"{LM8.code_count - 1}",
                _HINT,
            )
        return cls(kind, *size, square_mm, marker_mm, first_code=int(first))

    def __str__(self) -> str:
        if self.kind == "aprilgrid":
            family = "" if self.dictionary == "tag36h11" else f":{self.dictionary}"
            return (
                f"aprilgrid:{self.columns}x{self.rows}:{self.marker_mm:g}mm:{self.gap_mm / self.marker_mm:g}{family}"
            )
        text = f"{self.kind}:{self.columns}x{self.rows}:{self.square_mm:g}mm"
        if self.kind == "charuco":
            text += f":{self.marker_mm:g}mm:{self.dictionary}" + (":legacy" if self.legacy else "")
            text += f":{self.first_code}" if self.first_code else ""
        if self.kind == "landmarks":
            text += f":{self.marker_mm:g}mm" + (f":{self.first_code}" if self.first_code else "")
        return text

    def measured(self, width_mm: float, height_mm: float) -> BoardSpec:
        """The board as printed, from the measured size of its whole pattern (see :attr:`pattern_mm`).

        Raises:
            InputError: more than a tenth from the nominal size: probably another board.
        """
        should = self.pattern_mm
        stretch = (width_mm / should[0], height_mm / should[1])
        if max(abs(s - 1) for s in stretch) > MOST_STRETCH:
            raise InputError(
                "bad_measure",
                f"--measured {width_mm:g}x{height_mm:g}: the pattern of {self} is {should[0]:g} x {should[1]:g} mm",
                "measure the whole pattern, outer edge to outer edge, in mm; width first",
            )
        return replace(self, stretch=stretch)

    @property
    def pattern_mm(self) -> tuple[float, float]:
        """(width, height) of all squares, or from the first landmark's border to the last one's."""
        if self.is_grid:
            return self.columns * self.square_mm - self.gap_mm, self.rows * self.square_mm - self.gap_mm
        columns, rows = self.squares
        return columns * self.square_mm, rows * self.square_mm

    @property
    def is_grid(self) -> bool:
        """True of boards of landmarks or tags, whose corners are those of their landmarks."""
        return self.kind in ("landmarks", "aprilgrid")

    @property
    def gap_mm(self) -> float:
        """White between two landmarks (landmarks, aprilgrid)."""
        return self.square_mm - self.marker_mm

    @property
    def tag_family(self) -> SquareMarkerFamily:
        """The family of an AprilGrid's tags, with the border that Kalibr gives them."""
        family = family_named(self.dictionary)
        assert isinstance(family, SquareMarkerFamily)
        return replace(family, border_cells=KALIBR_BORDER)

    @property
    def inner_corners(self) -> tuple[int, int]:
        """Inner corners per row and per column (chessboard, charuco)."""
        if self.kind == "charuco":
            return self.columns - 1, self.rows - 1
        return self.columns, self.rows

    @property
    def squares(self) -> tuple[int, int]:
        """Squares per row and per column (chessboard, charuco)."""
        columns, rows = self.inner_corners
        return columns + 1, rows + 1

    @property
    def codes(self) -> tuple[int, ...]:
        """Codes of a board of landmarks, row by row from the top; Kalibr counts rows from the bottom."""
        if self.kind == "aprilgrid":
            rows = [range(row * self.columns, (row + 1) * self.columns) for row in range(self.rows)]
            return tuple(code for row in reversed(rows) for code in row)
        return tuple(range(self.first_code, self.first_code + self.columns * self.rows))

    @property
    def object_points(self) -> FloatArray:
        """(N,3) meters; x along a row, y down the rows, z = 0.

        Inner corners row by row; of landmarks, row by row, the four corners of each: top left first,
        then clockwise.
        """
        if self.is_grid:
            y, x = np.mgrid[0 : self.rows, 0 : self.columns] * self.square_mm
            corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * self.marker_mm
            points = (np.column_stack([x.ravel(), y.ravel()])[:, None] + corners).reshape(-1, 2)
        else:
            columns, rows = self.inner_corners
            y, x = np.mgrid[0:rows, 0:columns] * self.square_mm
            points = np.column_stack([x.ravel(), y.ravel()])
        return np.column_stack([points * self.stretch, np.zeros(len(points))]) / 1000


def _april_grid(size: tuple[int, int], tag_mm: float, rest: list[str], text: str) -> BoardSpec:
    try:
        gap = float(rest[0])
    except ValueError:
        gap = 0.0
    if not 0.1 <= gap <= 1.0:
        message = f"gap {rest[0]!r} of board {text!r} is not a number from 0.1 to 1"
        raise InputError(
            "bad_board", message, "give the gap between two tags over a tag's side, 0.3 in Kalibr's examples"
        )
    family = family_named(rest[1] if len(rest) == 2 else "tag36h11")
    if not (isinstance(family, SquareMarkerFamily) and family.is_apriltag):
        raise InputError("bad_board", f"{family.name} of board {text!r} is not a family of AprilTags", _HINT)
    if size[0] * size[1] > family.code_count:
        message = f"board {text!r} needs {size[0] * size[1]} tags; {family.name} has {family.code_count}"
        raise InputError("bad_board", message, _HINT)
    return BoardSpec("aprilgrid", *size, tag_mm * (1 + gap), tag_mm, family.name)
