"""Comparison of every code of a family of cells with one square: the unexplained rest with the best black and white.

Black and white are free for every code and channel.  All codes are compared with the apparent cells; the most
similar codes are scored in full.
"""

from __future__ import annotations

import ctypes
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lmkit.kernels.grid_moments import OTHERS
from lmkit.kernels.load import address, contiguous, function
from lmkit.kernels.workspace import Workspace

FloatArray = NDArray[np.floating[Any]]
Words = NDArray[np.uint64]

MAX_CELLS = 64
SHORTLIST = 64  # codes that are scored in full
RIDGE = 0.02  # pulls single cells toward gray, relative to the mean of their weights
_HEAD = 11
_room = Workspace()


class CellCodes(NamedTuple):
    """The likeliest code.

    Attributes:
        row: index in the words.
        left, next_left, plain_left: unexplained rest of this code, of the second best, and of a plain gray inside.
        weight: total weight of all values.
        inks: (2,3) white and black.
        cells: (K,) every cell on its own: 0 black, 1 white.
    """

    row: int
    left: float
    next_left: float
    plain_left: float
    weight: float
    inks: FloatArray
    cells: FloatArray


def packed(white: NDArray[np.bool_]) -> Words:
    """(N,) words of (N,K) cells: bit k is set where cell k is white.

    Raises:
        ValueError: more cells than a word holds.
    """
    if white.shape[1] > MAX_CELLS:
        raise ValueError(f"{white.shape[1]} cells, at most {MAX_CELLS}")
    bits = np.left_shift(np.uint64(1), np.arange(white.shape[1], dtype=np.uint64))
    return np.asarray((white * bits).sum(axis=1, dtype=np.uint64))


def cell_codes(words: Words, products: FloatArray) -> CellCodes | None:
    """Score codes; None if white would be darker than black.

    Args:
        words: (N,), see :func:`packed`.
        products: (K+6,K+6) from :func:`lmkit.kernels.grid_moments.grid_moments`.
    """
    kernel = _kernel()
    if kernel is None:
        return cell_codes_numpy(words, products)
    cells = len(products) - OTHERS - 3
    out = np.empty(_HEAD + cells)
    words, products = contiguous(words, (-1,), np.uint64), contiguous(products, (-1, len(products)))
    scratch = _room.floats("alike", 2 * len(words))
    if kernel(cells, len(words), SHORTLIST, RIDGE, address(words), address(products), scratch, address(out)):
        return None
    row, left, next_left, plain_left, weight = out[:5].tolist()
    inks = out[5:_HEAD].reshape(2, 3)
    return CellCodes(int(row), left, next_left, plain_left, weight, inks, out[_HEAD:])


def cell_codes_numpy(words: Words, products: FloatArray) -> CellCodes | None:
    """Definition of :func:`cell_codes`."""
    k = len(products) - 3 - OTHERS
    weight = 3 * float(products[:-3, :-3].sum())
    G, S, energy = _without_surroundings(products)
    plain, gray = _left_numpy(np.full((1, k), 0.5), G, S, energy)
    if not np.isfinite(plain[0]):
        return None
    white = ((words[:, None] >> np.arange(k, dtype=np.uint64)) & np.uint64(1)).astype(np.float64)
    alike = white @ (_cells_numpy(G, S, gray[0]) - 0.5)
    likely = np.argsort(-alike, kind="stable")[:SHORTLIST]
    left, inks = _left_numpy(white[likely], G, S, energy)
    first, second = np.argsort(left, kind="stable")[:2].tolist()
    if not np.isfinite(left[second]):
        return None
    cells = _cells_numpy(G, S, inks[first])
    unexplained = (float(left[first]), float(left[second]), float(plain[0]))
    return CellCodes(int(likely[first]), *unexplained, weight, inks[first], cells)


def single_cells(products: FloatArray, inks: FloatArray) -> NDArray[np.float64]:
    """(K,) every cell on its own, 0 black to 1 white, for (2,3) white and black.

    Args:
        products: (K+6,K+6) from :func:`lmkit.kernels.grid_moments.grid_moments`.
    """
    G, S, _ = _without_surroundings(products)
    return _cells_numpy(G, S, inks)


def _without_surroundings(products: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """Products of cells, border and margin with each other and with the values, for any light of the surroundings;
    and the sum of squares of the values."""
    count = len(products) - 3
    gram, seen = products[:count, :count], products[:count, count:]
    own, beyond = max(gram[-1, -1], 1e-9), seen[-1]
    energy = float(np.trace(products[count:, count:]) - np.sum(beyond**2) / own)
    S = (seen - np.outer(gram[-1], beyond) / own)[:-1]
    return (gram - np.outer(gram[-1], gram[-1]) / own)[:-1, :-1], S, energy


def _left_numpy(
    white: FloatArray, G: FloatArray, S: FloatArray, energy: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(M,) unexplained rest of every row of (M,K) cells, and (M,2,3) its white and black."""
    k = white.shape[1]
    is_white = np.column_stack([white, np.zeros(len(white)), np.ones(len(white))])
    is_black = np.column_stack([1 - white, np.ones(len(white)), np.zeros(len(white))])
    ww, wb, bb = (
        np.einsum("mi,ij,mj->m", a, G[: k + 2, : k + 2], b)
        for a, b in ((is_white, is_white), (is_white, is_black), (is_black, is_black))
    )
    white_seen, black_seen = is_white @ S, is_black @ S
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


def _cells_numpy(G: FloatArray, S: FloatArray, inks: FloatArray) -> NDArray[np.float64]:
    """(K,) every cell on its own, 0 black to 1 white, pulled weakly toward gray."""
    k = len(G) - 2
    contrast, black = (inks[0] - inks[1]).mean(), inks[1].mean()
    light = S.mean(axis=1) - black * G.sum(axis=1)
    # Border and margin have known inks; the cells explain the rest.
    rest = light[:k] - contrast * G[:k, k + 1]
    ridge = RIDGE * np.trace(G[:k, :k]) / k
    solved = np.linalg.solve(G[:k, :k] + ridge * np.eye(k), rest / max(contrast, 1e-6) + 0.5 * ridge)
    return np.asarray(solved)


@lru_cache(maxsize=1)
def _kernel() -> Any:
    p, n = ctypes.c_void_p, ctypes.c_int64
    return function("lmkit_cell_codes", n, n, n, ctypes.c_double, *[p] * 4)
