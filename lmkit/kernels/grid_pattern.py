"""Blurred coverage of a grid of black cells on white paper, with slopes; `grid.h` does so in blocks.

With F_i the coverage below the i-th horizontal line of the grid and G_j the coverage right of its j-th vertical line,
black covers ``sum E_ij F_i G_j``: E is the mixed second difference of the cells' darkness.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lmkit.kernels.load import contiguous
from lmkit.kernels.pattern import INKS, JET, Drawing, ink_jets_numpy, normal_distribution

FloatArray = NDArray[np.floating[Any]]
Float32Array = NDArray[np.float32]

MAX_CELLS = 12  # a side: size of the compiled code's blocks


class _Grid(NamedTuple):
    paper: float
    half: float
    darkness: FloatArray


class GridDrawing(_Grid):
    """A square of cells with darkness 0 to 1 on white paper.

    Attributes:
        paper: half side of the white paper, mm; outside are the surroundings.
        half: half side of the grid, mm.
        darkness: (n,n) 1 for black cells, 0 for white ones, row by row from the top left.
    """

    @classmethod
    def of(cls, paper: float, half: float, darkness: Any) -> GridDrawing:
        """Arrays of consistent shapes.

        Raises:
            ValueError: not a square, or more cells than the compiled code holds.
        """
        darkness = contiguous(darkness, (-1, len(darkness)))
        if len(darkness) != darkness.shape[1] or not 0 < len(darkness) <= MAX_CELLS:
            raise ValueError(f"a grid of shape {darkness.shape}")
        return cls(paper, half, darkness)

    @property
    def weights(self) -> FloatArray:
        """(n+1,n+1) mixed second difference of the darkness."""
        n = len(self.darkness)
        padded = np.zeros((n + 2, n + 2))
        padded[1:-1, 1:-1] = self.darkness
        across = padded[:, 1:] - padded[:, :-1]
        return np.asarray(across[1:] - across[:-1])

    @cached_property
    def flat(self) -> Float32Array:
        """The data in the order of `pattern.h`."""
        n = len(self.darkness)
        flat = np.empty(6 + (n + 1) ** 2, np.float32)
        flat[:6] = -n, 0, 0, self.paper, self.half, 0
        flat[6:] = self.weights.ravel()
        return flat


def jets_numpy(
    drawing: Drawing | GridDrawing, points: FloatArray, spread: FloatArray, mask: int, quarter: int, slopes: bool
) -> Float32Array:
    """(1 or 6,4,N) coverage by the four inks of both kinds of drawing, and its slopes.

    A grid has white, nothing, black and surroundings, independent of mask and quarter turn; for the rest see
    :func:`lmkit.kernels.pattern.ink_jets_numpy`.
    """
    if isinstance(drawing, Drawing):
        return ink_jets_numpy(drawing, points, spread, mask, quarter, slopes)
    black = _product(*_lines(drawing, points, spread), drawing.weights)
    square = GridDrawing(0.0, drawing.paper, np.ones((1, 1)))
    paper = _product(*_lines(square, points, spread), square.weights)
    jets = np.zeros((JET, INKS, len(points)), np.float32)
    jets[:, 0], jets[:, 2], jets[:, 3] = paper - black, black, -paper
    jets[0, 3] += 1
    return jets if slopes else jets[:1]


def line_coverage_numpy(at: FloatArray, variance: FloatArray, half: float, count: int) -> FloatArray:
    """(3,n+1,N) coverage beyond every line of a grid of ``count`` cells, and its slopes with place and variance."""
    lines = half * (2 * np.arange(count + 1) / count - 1)
    s = np.sqrt(variance)
    distance = at - lines[:, None]
    share, density = normal_distribution(np.asarray(distance / s, dtype=np.float32))
    return np.stack([share, density / s, -density * distance / (2 * s**3)])


def _lines(drawing: GridDrawing, points: FloatArray, spread: FloatArray) -> tuple[FloatArray, FloatArray]:
    count = len(drawing.darkness)
    across = line_coverage_numpy(points[:, 0], spread[:, 0], drawing.half, count)
    down = line_coverage_numpy(-points[:, 1], spread[:, 2], drawing.half, count)
    return across, down


def _product(across: FloatArray, down: FloatArray, weights: FloatArray) -> FloatArray:
    """(6,N) value and slopes."""
    v, e, f = np.einsum("rc,jcn->jrn", weights, across)
    rows = [down[0] * v, down[0] * e, -down[1] * v, down[0] * f, np.zeros_like(v), down[2] * v]
    return np.stack([row.sum(axis=0) for row in rows])


def cell_coverage_numpy(drawing: GridDrawing, points: FloatArray, spread: FloatArray) -> Float32Array:
    """(n*n,N) coverage of every cell, row by row from the top left."""
    across, down = _lines(drawing, points, spread)
    x, y = -np.diff(across[0], axis=0), -np.diff(down[0], axis=0)
    return np.asarray((y[:, None] * x[None]).reshape(-1, len(points)), dtype=np.float32)
