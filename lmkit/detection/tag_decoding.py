"""Decoding of a registered square marker: every code in every quarter turn, scored by likelihood.

Black, white and surroundings are free for every hypothesis and channel; the score is what the pixels leave
unexplained.  The cells are fitted on their own too: in a square with some other content they are not those of any
code.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from lmkit.arrays import BoolArray, Float32Array, FloatArray
from lmkit.detection.decoding import CORRELATED_PIXELS
from lmkit.kernels.grid_moments import OTHERS, grid_moments
from lmkit.kernels.grid_pattern import GridDrawing
from lmkit.kernels.registration import Samples, View
from lmkit.model.square_marker import SquareMarkerFamily

SHORTLIST = 64  # readings that are scored in full
MODEL_SHARE = 0.02  # of the contrast, which no model of blur and print gets better


@dataclass(frozen=True)
class TagDecoding:
    """Decoding of a registered square.

    Attributes:
        code, quarter: the likeliest reading.
        margin: log likelihood ratio against the likeliest other reading, of another code or quarter turn.
        pattern: share of what a border with a plain inside leaves unexplained that the code's cells explain.
        white, black: linear light, mean over the channels.
        cells: (bits,bits) each cell fitted on its own: 0 black, 1 white; in the square's frame.
        expected: (bits,bits) what the code says of them, in the square's frame.
    """

    code: int
    quarter: int
    margin: float
    pattern: float
    white: float
    black: float
    cells: FloatArray
    expected: BoolArray

    @property
    def cell_error(self) -> float:
        """Root mean square distance of the cells from what the code says of them; 0.5 is nothing."""
        return float(np.sqrt(np.mean((np.clip(self.cells, -0.5, 1.5) - self.expected) ** 2)))

    def is_same_code(self, other: TagDecoding) -> bool:
        """Same code in the same quarter turn."""
        return (self.code, self.quarter) == (other.code, other.quarter)


@dataclass(frozen=True, eq=False)
class TagTables:
    """Data of a family for decoding, computed once.

    Attributes:
        white: (4 * codes, bits * bits) white cells in the square's frame, by quarter turn, then code.
        empty: a drawing with all cells black.
    """

    white: Float32Array
    empty: GridDrawing


@lru_cache(maxsize=16)
def tag_tables_of(family: SquareMarkerFamily) -> TagTables:
    """Tables of a family."""
    turned = np.concatenate([np.rot90(family.white, -quarter, axes=(1, 2)) for quarter in range(4)])
    flat = np.ascontiguousarray(turned.reshape(len(turned), -1), dtype=np.float32)
    return TagTables(flat, drawing_of_cells(family, np.zeros((family.bits, family.bits))))


def drawing_of_cells(family: SquareMarkerFamily, white: FloatArray) -> GridDrawing:
    """The drawing of a marker with these (bits,bits) shares of white in the square's frame."""
    darkness = np.pad(1.0 - white, family.border_cells, constant_values=1.0)
    return GridDrawing.of(family.half_mm + family.margin_mm, family.half_mm, darkness)


def decode_tag(
    family: SquareMarkerFamily, view: View, state: FloatArray, samples: Samples, channel_repeats: int
) -> TagDecoding | None:
    """Score every code in every quarter turn at this state of a registration; None where nothing looks like one."""
    tables = tag_tables_of(family)
    sums = _sums(family, tables.empty, view, state, samples)
    G, S, energy, bits = sums.gram, sums.seen, sums.energy, family.bits**2
    plain, gray = _left(np.full((1, bits), 0.5, np.float32), G, S, energy)
    if not np.isfinite(plain[0]):
        return None
    # The likeliest two are among those that look most like the cells as they appear.
    alike = tables.white @ (_cells(G, S, gray[0]) - 0.5).astype(np.float32)
    likely = np.argpartition(-alike, SHORTLIST)[:SHORTLIST]
    left, inks = _left(tables.white[likely], G, S, energy)
    first, second = np.argsort(left)[:2].tolist()
    if not np.isfinite(left[second]):
        return None
    best = int(likely[first])
    evidence = samples.values.size / CORRELATED_PIXELS / 2 / channel_repeats
    # No model explains print and blur to the last bit.
    floor = MODEL_SHARE**2 * float(np.mean((inks[first, 0] - inks[first, 1]) ** 2)) * sums.weight
    least = max(float(left[first]), 1e-9) + floor
    return TagDecoding(
        code=best % family.code_count,
        quarter=best // family.code_count,
        margin=evidence * math.log(max((float(left[second]) + floor) / least, 1.0)),
        pattern=1 - float(left[first]) / max(float(plain[0]), 1e-9),
        white=float(inks[first, 0].mean()),
        black=float(inks[first, 1].mean()),
        cells=_cells(G, S, inks[first]).reshape(family.bits, family.bits),
        expected=tables.white[best].reshape(family.bits, family.bits) > 0.5,
    )


@dataclass(frozen=True)
class _Sums:
    """Products of the columns (cells, border, margin), freed of the surroundings, and of them with the values."""

    gram: FloatArray
    seen: FloatArray
    energy: float
    weight: float


def _sums(family: SquareMarkerFamily, empty: GridDrawing, view: View, state: FloatArray, samples: Samples) -> _Sums:
    sums = grid_moments(empty, family.border_cells, view, samples, state)
    count = family.bits**2 + OTHERS
    gram, seen = sums[:count, :count], sums[:count, count:]
    energy, weight = float(np.trace(sums[count:, count:])), 3 * float(gram.sum())
    # Free the others of the surroundings, whatever their light.
    beyond, of_beyond = gram[-1] / max(gram[-1, -1], 1e-9), seen[-1]
    energy -= float(np.sum(of_beyond**2)) / max(gram[-1, -1], 1e-9)
    seen = seen - np.outer(beyond, of_beyond)
    gram = gram - np.outer(beyond, gram[-1])
    return _Sums(gram[:-1, :-1], seen[:-1], energy, weight)


def _left(white: Float32Array, G: FloatArray, S: FloatArray, energy: float) -> tuple[FloatArray, FloatArray]:
    """(M,) what every hypothesis leaves unexplained, and (M,2,3) its white and black.

    Args:
        white: (M,K) cells.
        G, S: sums of K cells, border and margin.
    """
    k = white.shape[1]
    total = G[:, :k].sum(axis=1)  # of all cells with every column
    by = white @ np.column_stack([total[:k], G[:k, k:], S[:k]]).astype(np.float32)
    by_total, by_border, by_margin, seen = by[:, 0], by[:, 1], by[:, 2], by[:, 3:].astype(np.float64)
    square = np.einsum("mk,mk->m", white @ G[:k, :k].astype(np.float32), white)
    dark = total[k] + total[:k].sum() + total[k] + G[k, k]  # border and all cells, squared
    ww = G[k + 1, k + 1] + 2 * by_margin + square
    wb = G[k, k + 1] + total[k + 1] + by_border + by_total - by_margin - square
    bb = dark - 2 * (by_border + by_total) + square
    white_seen = S[k + 1] + seen
    black_seen = S[k] + S[:k].sum(axis=0) - seen
    det = np.maximum(ww * bb - wb**2, 1e-6 * ww * bb)[:, None]
    inks = np.stack(
        [
            (bb[:, None] * white_seen - wb[:, None] * black_seen) / det,
            (ww[:, None] * black_seen - wb[:, None] * white_seen) / det,
        ],
        axis=1,
    )
    left = energy - (inks[:, 0] * white_seen + inks[:, 1] * black_seen).sum(axis=1)
    return np.where(inks[:, 0].sum(axis=1) > inks[:, 1].sum(axis=1), left, np.inf), inks


def _cells(G: FloatArray, S: FloatArray, inks: FloatArray) -> FloatArray:
    """(K,) every cell on its own, 0 black to 1 white, pulled weakly toward gray."""
    k = len(G) - 2
    contrast, black = (inks[0] - inks[1]).mean(), inks[1].mean()
    light = S.mean(axis=1) - black * G.sum(axis=1)
    # Border and margin have their inks; the cells explain the rest.
    rest = light[:k] - contrast * G[:k, k + 1]
    ridge = 0.02 * np.trace(G[:k, :k]) / k
    solved = np.linalg.solve(G[:k, :k] + ridge * np.eye(k), rest / max(contrast, 1e-6) + 0.5 * ridge)
    return np.asarray(solved)
