"""Decoding of a registered square marker: every code in every quarter turn, scored by likelihood.

Black, white and surroundings are free parameters for every hypothesis and channel; the score is the
residual.  The margin is as white as the cells, which helps to locate small markers, unless the pixels refute this:
paper cut at the border, a ground in another light.  The cells are also fitted individually: in a square with
other content they do not agree with any code.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from lmkit.arrays import BoolArray, FloatArray
from lmkit.detection.decoding import CORRELATED_PIXELS
from lmkit.kernels.cell_codes import CellCodes, Words, cell_codes, packed, single_cells
from lmkit.kernels.grid_moments import OTHERS, grid_moments
from lmkit.kernels.grid_pattern import GridDrawing
from lmkit.kernels.plane import View
from lmkit.kernels.registration import Samples
from lmkit.model.square_marker import SquareMarkerFamily

MODEL_SHARE = 0.02  # of the contrast: smallest error of any model of blur and print
REFUTED = 100.0  # log likelihood ratio of a margin with different light: a tenth of the contrast in a clear image


@dataclass(frozen=True)
class TagDecoding:
    """Decoding of a registered square.

    Attributes:
        code, quarter: the likeliest reading.
        margin: log likelihood ratio against the likeliest other reading, of another code or quarter turn.
        pattern: share of what a border with a plain inside leaves unexplained that the code's cells explain.
        white, black: linear light, mean over the channels.
        inks: (2,3) white and black, linear-light BGR.
        cells: (bits,bits) each cell fitted on its own: 0 black, 1 white; in the square's frame.
        expected: (bits,bits) cells of the code, in the square's frame.
        has_own_ground: the light around is not the white of the cells.
    """

    code: int
    quarter: int
    margin: float
    pattern: float
    white: float
    black: float
    inks: FloatArray
    cells: FloatArray
    expected: BoolArray
    has_own_ground: bool

    @cached_property
    def cell_error(self) -> float:
        """Root mean square deviation of the cells from the code's cells; 0.5 is no agreement."""
        return _root_mean_square(self.cells, self.expected)

    def is_same_code(self, other: TagDecoding) -> bool:
        """Same code in the same quarter turn."""
        return (self.code, self.quarter) == (other.code, other.quarter)


@dataclass(frozen=True, eq=False)
class TagTables:
    """Data of a family for decoding, computed once.

    Attributes:
        white: (4 * codes,bits,bits) white cells in the square's frame, by quarter turn, then code.
        words: (4 * codes,) the same, one number each.
        empty: a drawing with all cells black.
    """

    white: BoolArray
    words: Words
    empty: GridDrawing


@lru_cache(maxsize=16)
def tag_tables_of(family: SquareMarkerFamily) -> TagTables:
    """Tables of a family."""
    turned = np.concatenate([np.rot90(family.white, -quarter, axes=(1, 2)) for quarter in range(4)])
    words = packed(turned.reshape(len(turned), -1))
    return TagTables(turned, words, drawing_of_cells(family, np.zeros((family.bits, family.bits))))


def drawing_of_cells(family: SquareMarkerFamily, white: FloatArray, has_own_ground: bool = False) -> GridDrawing:
    """The drawing of a marker with these (bits,bits) shares of white in the square's frame.

    The surroundings begin at the border if the margin has different light.
    """
    darkness = np.ones((family.cells, family.cells))
    inside = slice(family.border_cells, family.cells - family.border_cells)
    darkness[inside, inside] -= white
    paper = family.half_mm if has_own_ground else family.half_mm + family.margin_mm
    return GridDrawing.of(paper, family.half_mm, darkness)


def decode_tag(
    family: SquareMarkerFamily, view: View, state: FloatArray, samples: Samples, channel_repeats: float
) -> TagDecoding | None:
    """Score every code in every quarter turn at this state of a registration; None if none is plausible."""
    tables = tag_tables_of(family)
    products = grid_moments(tables.empty, family.border_cells, view, samples, state)
    tied, own = cell_codes(tables.words, products), cell_codes(tables.words, _with_own_ground(products))
    evidence = samples.values.size / CORRELATED_PIXELS / 2 / channel_repeats
    found, has_own_ground = tied, False
    if own is not None:
        least = max(own.left, 1e-9) + _floor(own)
        has_own_ground = tied is None or evidence * math.log((tied.left + _floor(own)) / least) > REFUTED
        found = own if has_own_ground else tied
    if found is None:
        return None
    white, black = found.inks.mean(axis=1).tolist()
    floor = _floor(found)
    least = max(found.left, 1e-9) + floor
    quarter, code = divmod(found.row, family.code_count)
    return TagDecoding(
        code=code,
        quarter=quarter,
        margin=evidence * math.log(max((found.next_left + floor) / least, 1.0)),
        pattern=1 - found.left / max(found.plain_left, 1e-9),
        white=white,
        black=black,
        inks=found.inks,
        cells=found.cells.reshape(family.bits, family.bits),
        expected=tables.white[found.row],
        has_own_ground=has_own_ground,
    )


def _floor(found: CellCodes) -> float:
    """Smallest residual of any model, since none explains print and blur exactly."""
    contrast = found.inks[0] - found.inks[1]
    return MODEL_SHARE**2 * float(contrast @ contrast) / 3 * found.weight


def _with_own_ground(products: FloatArray) -> FloatArray:
    """Products of cells, border, margin, surroundings and values with the margin counted among the surroundings."""
    margin = len(products) - 3 - OTHERS + 1
    joined = products.copy()
    joined[margin + 1] += joined[margin]
    joined[:, margin + 1] += joined[:, margin]
    joined[margin] = joined[:, margin] = 0.0
    return joined


def border_error_of(
    family: SquareMarkerFamily, view: View, state: FloatArray, samples: Samples, decoding: TagDecoding
) -> float:
    """Root mean square distance of the border's cells, each fitted on its own, from black.

    Windows, tiles and letters often have an inside like a code's, but rarely twenty dark cells around it.
    """
    tied = grid_moments(tag_tables_of(family).empty, 0, view, samples, state)
    products = _with_own_ground(tied) if decoding.has_own_ground else tied
    cells = single_cells(products, decoding.inks).reshape(family.cells, family.cells)
    in_border = np.ones(cells.shape, dtype=bool)
    inside = slice(family.border_cells, family.cells - family.border_cells)
    in_border[inside, inside] = False
    return _root_mean_square(cells[in_border], np.zeros(1))


def _root_mean_square(cells: FloatArray, expected: FloatArray | BoolArray) -> float:
    off = (np.minimum(np.maximum(cells, -0.5), 1.5) - expected).ravel()
    return math.sqrt(float(off @ off) / len(off))
