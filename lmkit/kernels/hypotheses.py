"""Decoding of a registered pattern: every code in every quarter turn, each with its own best inks.

The image of a landmark is linear in its inks.  A hypothesis h = (quarter turn, code) only says which columns of the
coverage C are white and which are blue, so its design is C M_h with a matrix M_h of zeros and ones, and its residual
sum of squares with the inks at their best follows from the sums C'C and C'Y alone.
"""

from __future__ import annotations

import ctypes
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lmkit.kernels.load import addresses, contiguous, function
from lmkit.kernels.pattern import GAP, INKS, QUARTERS, RING, TRIANGLE, Drawing, coverage_columns_numpy
from lmkit.kernels.registration import STATE, Samples, View, light_numpy, plane_numpy

FloatArray = NDArray[np.floating[Any]]

HEAD = 18


class Words(NamedTuple):
    """A family's codes.

    Attributes:
        masks: (4,K) open gaps of every code in every quarter turn, as bits.
        sectors: (G,5) radius of the ring's middle and half its thickness (mm), unit vector to the gap's middle, half
            its angle (rad).
    """

    masks: NDArray[np.int32]
    sectors: NDArray[np.float32]

    @classmethod
    def of(cls, masks: Any, sectors: Any) -> Words:
        """Contiguous arrays.

        Raises:
            ValueError: a shape differs, or a mask has bits beyond the gaps.
        """
        masks, sectors = contiguous(masks, (QUARTERS, -1), np.int32), contiguous(sectors, (-1, 5), np.float32)
        if masks.shape[1] == 0 or masks.min() < 0 or masks.max() >= 1 << len(sectors):
            raise ValueError("masks of gaps that are not there")
        return cls(masks, sectors)


class DecodingRules(NamedTuple):
    """Figures of the decoding.

    Attributes:
        ridge: of the inks, relative.
        parts_ridge: of the parts, relative.
        model_share: share of the contrast that no model of blur and print explains.
        worst_residual: a pixel's chi2 counts up to this.
        gap_pixels: fewer pixels around a gap say nothing.
        gap_reach_mm: how far around a gap the chi2 is looked at.
    """

    ridge: float
    parts_ridge: float
    model_share: float
    worst_residual: float
    gap_pixels: float
    gap_reach_mm: float


class Decoded(NamedTuple):
    """The likeliest hypothesis.

    Attributes:
        turn, code: quarter turn and number of the code.
        left: weighted energy that it leaves unexplained; ``left_by_code``, ``left_by_turn``, ``left_by_frame``: what
            another code in the same turn leaves, any code in another turn, a framed square without rings.
        inks: (4,3) linear-light BGR of white, red, blue, surroundings.
        gap_residual: the largest mean squared chi2 around a gap, over the usual one.
        parts, parts_sigma: (2+G,) brightness of triangle, fixed stretches of the rings and every gap, each fitted on
            its own; 0 is the ground, 1 the white; and their standard deviations.
    """

    turn: int
    code: int
    left: float
    left_by_code: float
    left_by_turn: float
    left_by_frame: float
    inks: FloatArray
    gap_residual: float
    parts: FloatArray
    parts_sigma: FloatArray


def decode(
    drawing: Drawing, words: Words, view: View, samples: Samples, state: FloatArray, rules: DecodingRules
) -> Decoded | None:
    """The likeliest code and quarter turn; None where the pixels do not determine the inks."""
    kernel = _kernel()
    if kernel is None:
        return decode_numpy(drawing, words, view, samples, state, rules)
    n, gaps = len(samples.variance), len(drawing.gaps)
    columns = np.empty((n + 64) * drawing.column_count + 2 * n, np.float32)
    subsets, out = np.empty(7 << gaps), np.empty(HEAD + 1 + 2 * (2 + gaps))
    state = contiguous(state, (STATE,))
    flat, seen, numbers = drawing.flat, view.flat, np.array(rules)
    arrays = addresses(flat, seen, *samples, state, words.masks)
    ends = addresses(numbers, words.sectors, columns, subsets, out)
    status = kernel(n, *arrays, words.masks.shape[1], *ends)
    if status:
        return None
    parts = out[HEAD + 1 :].reshape(2, -1)
    inks = out[6:HEAD].reshape(INKS, 3)
    return Decoded(int(out[0]), int(out[1]), out[2], out[3], out[4], out[5], inks, out[HEAD], parts[0], parts[1])


def decode_numpy(
    drawing: Drawing, words: Words, view: View, samples: Samples, state: FloatArray, rules: DecodingRules
) -> Decoded | None:
    """Definition of :func:`decode`."""
    values, variance = samples.values.T.astype(np.float64), samples.variance.astype(np.float64)
    points, spread, _, _ = plane_numpy(view, state, samples.at.T.astype(np.float64))
    columns = coverage_columns_numpy(drawing, points, spread).T * light_numpy(view, state, points)[:, None]
    root = 1 / np.sqrt(variance)[:, None]
    gram = (columns * root).T @ (columns * root)
    seen = (columns * root).T @ (values * root)
    energy = float(((values * root) ** 2).sum())
    ridge = rules.ridge * np.trace(gram[:INKS, :INKS]) / INKS * np.eye(INKS)
    selections = selection_matrices(words, drawing.column_count)
    explained = explained_energy_numpy(selections, gram, seen, ridge)
    if not np.isfinite(explained).all():
        return None
    left = energy - explained.reshape(QUARTERS, -1)
    turn, code = divmod(int(left.argmin()), left.shape[1])
    others = np.delete(left[turn], code)
    frame = explained_energy_numpy(np.eye(drawing.column_count)[None, :, :INKS], gram, seen, ridge)
    M = selections[turn * left.shape[1] + code]
    inks = np.linalg.solve(M.T @ gram @ M + ridge, M.T @ seen)
    parts, sigmas = _parts(gram, seen, (values * root).T @ (values * root), len(values), turn, inks, rules)
    return Decoded(
        turn=turn,
        code=code,
        left=float(left[turn, code]),
        left_by_code=float(others.min()) if len(others) else energy,
        left_by_turn=float(np.delete(left, turn, axis=0).min()),
        left_by_frame=energy - float(frame[0]),
        inks=inks,
        gap_residual=_gap_residual(points, values - columns @ M @ inks, variance, inks, words, rules),
        parts=parts,
        parts_sigma=sigmas,
    )


def selection_matrices(words: Words, columns: int) -> FloatArray:
    """(4K,C,4) the matrices M_h, quarter turn by quarter turn."""
    masks = words.masks.ravel()
    turns = np.repeat(np.arange(QUARTERS), words.masks.shape[1])
    M = np.zeros((len(masks), columns, INKS))
    M[:, range(INKS), range(INKS)] = 1
    M[:, RING, 0], M[:, RING, 2] = 1, -1
    every = np.arange(len(masks))
    M[every, TRIANGLE + turns, 0], M[every, TRIANGLE + turns, 2] = 1, -1
    for gap in range(columns - GAP):
        is_open = masks >> gap & 1
        M[:, GAP + gap, 0], M[:, GAP + gap, 2] = -is_open, is_open
    return M


def explained_energy_numpy(
    selections: FloatArray, gram: FloatArray, seen: FloatArray, ridge: FloatArray
) -> FloatArray:
    """(H,) weighted energy that hypotheses (H,C,4) explain, from C'C, C'Y and the (4,4) ridge of the inks."""
    transposed = selections.transpose(0, 2, 1)
    normal = transposed @ (gram @ selections) + ridge
    projected = transposed @ seen
    return np.asarray(np.sum(projected * np.linalg.solve(normal, projected), axis=(1, 2)))


def _parts(
    gram: FloatArray,
    seen: FloatArray,
    square: FloatArray,
    n: int,
    turn: int,
    inks: FloatArray,
    rules: DecodingRules,
) -> tuple[FloatArray, FloatArray]:
    contrast = inks[0] - inks[2]
    along = contrast / max(float(contrast @ contrast), 1e-9)
    gaps = len(gram) - GAP
    M = np.zeros((6 + gaps, len(gram)))
    M[0, TRIANGLE + turn] = M[1, RING] = 1
    M[1, GAP:] = -1
    M[2 : 2 + gaps, GAP:] = np.eye(gaps)
    M[2 + gaps :, :INKS] = np.eye(INKS)
    A, b = M @ gram @ M.T, M @ seen @ along
    inverse = np.linalg.inv(A + rules.parts_ridge * np.trace(A) / len(A) * np.eye(len(A)))
    x = inverse @ b
    chi2 = max(float(along @ square @ along - 2 * x @ b + x @ A @ x), 0.0) / n
    return x[: 2 + gaps], np.sqrt(np.diag(inverse)[: 2 + gaps] * chi2)


def _gap_residual(
    points: FloatArray, off: FloatArray, variance: FloatArray, inks: FloatArray, words: Words, rules: DecodingRules
) -> float:
    """An object that hides a gap reaches over the ring's edges from outside, so the surroundings show it,
    even where it is as dark as the ground or as bright as the ring.  Usual is the median of all
    pixels, or the expected variance, or a share of the contrast, which no model of blur and print
    gets better; whichever is largest."""
    squared = np.mean(off**2, axis=1)
    median = float(np.median(squared / variance))
    usual = np.maximum(variance * max(median, 1.0), np.mean((rules.model_share * (inks[0] - inks[2])) ** 2))
    chi2 = np.minimum(squared / usual, rules.worst_residual)
    radius = np.maximum(np.hypot(points[:, 0], points[:, 1]), 1.0)
    worst = 0.0
    for middle, half_thickness, x, y, half_angle in words.sectors.astype(np.float64):
        near = np.abs(radius - middle) < rules.gap_reach_mm + half_thickness
        angle = np.minimum(half_angle + rules.gap_reach_mm / radius, np.pi)
        around = near & (points @ np.array([x, y]) > radius * np.cos(angle))
        if around.sum() >= rules.gap_pixels:
            worst = max(worst, float(chi2[around].mean()))
    return worst


@lru_cache(maxsize=1)
def _kernel() -> Any:
    p, n = ctypes.c_void_p, ctypes.c_int64
    return function("lmkit_decode", n, *[p] * 7, n, *[p] * 5)
