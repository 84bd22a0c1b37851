"""Calibration boards, named as on the command line: ``chessboard:9x6:30mm``."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.errors import InputError
from lmkit.units import parse_length_mm

_HINT = (
    "write chessboard:9x6:30mm (inner corners and square) or "
    "charuco:8x6:30mm:22mm:DICT_5X5_100 (squares, square, marker, dictionary; :legacy may follow)"
)


@dataclass(frozen=True)
class BoardSpec:
    """A flat calibration target.

    Attributes:
        kind: ``chessboard`` or ``charuco``.
        columns, rows: chessboard: INNER corners; charuco: squares.
        square_mm: side of a square.
        marker_mm: side of a marker (charuco).
        dictionary: name of the marker dictionary (charuco).
        legacy: the marker layout of OpenCV before 4.6 (charuco with an even number of rows).
    """

    kind: str
    columns: int
    rows: int
    square_mm: float
    marker_mm: float = 0.0
    dictionary: str = ""
    legacy: bool = False

    @classmethod
    def parse(cls, text: str) -> BoardSpec:
        """Read ``chessboard:9x6:30mm`` or ``charuco:8x6:30mm:22mm:DICT_5X5_100[:legacy]``.

        Raises:
            InputError: the text is not such a specification.
        """
        kind, *parts = text.strip().split(":")
        counts = {"chessboard": (2,), "charuco": (4, 5)}.get(kind)
        if counts is None or len(parts) not in counts or (len(parts) == 5 and parts[4] != "legacy"):
            raise InputError("bad_board", f"board {text!r} is not a board specification", _HINT)
        columns, _, rows = parts[0].lower().partition("x")
        if not (columns.isdecimal() and rows.isdecimal() and 2 <= int(columns) <= 100 and 2 <= int(rows) <= 100):
            raise InputError("bad_board", f"{parts[0]!r} in board {text!r} is not COLUMNSxROWS", _HINT)
        square_mm = parse_length_mm(parts[1], f"square of board {text!r}")
        if kind == "chessboard":
            return cls(kind, int(columns), int(rows), square_mm)
        marker_mm = parse_length_mm(parts[2], f"marker of board {text!r}")
        if marker_mm >= square_mm:
            raise InputError(
                "bad_board", f"marker {parts[2]} of board {text!r} is not smaller than its square", _HINT
            )
        return cls(kind, int(columns), int(rows), square_mm, marker_mm, parts[3].upper(), len(parts) == 5)

    def __str__(self) -> str:
        text = f"{self.kind}:{self.columns}x{self.rows}:{self.square_mm:g}mm"
        if self.kind == "charuco":
            text += f":{self.marker_mm:g}mm:{self.dictionary}" + (":legacy" if self.legacy else "")
        return text

    @property
    def inner_corners(self) -> tuple[int, int]:
        """Inner corners per row and per column."""
        if self.kind == "charuco":
            return self.columns - 1, self.rows - 1
        return self.columns, self.rows

    @property
    def squares(self) -> tuple[int, int]:
        """Squares per row and per column."""
        columns, rows = self.inner_corners
        return columns + 1, rows + 1

    @property
    def object_points(self) -> FloatArray:
        """(N,3) inner corners row by row, metres; x along a row, y down the rows, z = 0."""
        columns, rows = self.inner_corners
        y, x = np.mgrid[0:rows, 0:columns]
        return np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)]) * (self.square_mm / 1000)
