"""Decoding of a registered pattern: every code in every quarter turn, each with its best inks.

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
from lmkit.kernels.occlusion import (
    OcclusionRules,
    code_evidence_numpy,
    foreign_rectangle_numpy,
    usual_variance_numpy,
)
from lmkit.kernels.pattern import GAP, INKS, QUARTERS, RING, TRIANGLE, Drawing, coverage_columns_numpy
from lmkit.kernels.plane import STATE, View, light_numpy, plane_numpy
from lmkit.kernels.registration import Samples

FloatArray = NDArray[np.floating[Any]]

HEAD, TAIL = 18, 20  # results before those of the occlusion, and before the parts


class Words(NamedTuple):
    """A family's codes.

    Attributes:
        masks: (4,K) open gaps of every code in every quarter turn, as bits.
        gaps: number of gap positions.
    """

    masks: NDArray[np.int32]
    gaps: int

    @classmethod
    def of(cls, masks: Any, gaps: int) -> Words:
        """A contiguous array.

        Raises:
            ValueError: a shape differs, or a mask has bits beyond the gaps.
        """
        masks = contiguous(masks, (QUARTERS, -1), np.int32)
        if masks.shape[1] == 0 or masks.min() < 0 or masks.max() >= 1 << gaps:
            raise ValueError("masks of gaps that are not there")
        return cls(masks, gaps)


class DecodingRules(NamedTuple):
    """Parameters of the decoding.

    Attributes:
        ridge: of the inks, relative.
        parts_ridge: of the parts, relative.
        occlusion: parameters of the search for an object in front of a landmark.
    """

    ridge: float
    parts_ridge: float
    occlusion: OcclusionRules

    @property
    def flat(self) -> tuple[float, ...]:
        """All parameters, in the order of the kernels."""
        return self.ridge, self.parts_ridge, *self.occlusion


class Decoded(NamedTuple):
    """The likeliest hypothesis.

    Attributes:
        turn, code: quarter turn and number of the code.
        left: unexplained weighted energy; ``left_by_code``, ``left_by_turn``, ``left_by_frame``: the same for
            the best other code in the same turn, the best code in another turn, and a framed square without rings.
        inks: (4,3) linear-light BGR of white, red, blue, surroundings.
        evidence: least chi2 in favor of the code, compared with others in the same turn; no pixel counts for
            more than a limit.
        foreign: the chi2 by which a rectangle, in one color or in any, explains the pixels better than the landmark.
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
    evidence: float
    foreign: float
    parts: FloatArray
    parts_sigma: FloatArray


def decode(
    drawing: Drawing, words: Words, view: View, samples: Samples, state: FloatArray, rules: DecodingRules
) -> Decoded | None:
    """The likeliest code and quarter turn; None if the pixels do not determine the inks."""
    kernel = _kernel()
    if kernel is None:
        return decode_numpy(drawing, words, view, samples, state, rules)
    n, gaps = len(samples.variance), len(drawing.gaps)
    columns = np.empty((n + 64) * drawing.column_count + 3 * n, np.float32)
    subsets, out = np.empty(7 << gaps), np.empty(TAIL + 2 * (2 + gaps))
    state = contiguous(state, (STATE,))
    flat, seen, numbers = drawing.flat, view.flat, np.array(rules.flat)
    arrays = addresses(flat, seen, *samples, state, words.masks)
    ends = addresses(numbers, columns, subsets, out)
    status = kernel(n, *arrays, words.masks.shape[1], *ends)
    if status:
        return None
    parts = out[TAIL:].reshape(2, -1)
    inks, (evidence, foreign) = out[6:HEAD].reshape(INKS, 3), out[HEAD:TAIL]
    turn, code = int(out[0]), int(out[1])
    return Decoded(turn, code, out[2], out[3], out[4], out[5], inks, evidence, foreign, parts[0], parts[1])


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
    off, contrast, hiding = values - columns @ M @ inks, inks[0] - inks[2], rules.occlusion
    usual = usual_variance_numpy(off, variance, contrast, hiding)
    is_open = words.masks[turn, :, None] >> np.arange(words.gaps) & 1
    differ = np.delete(is_open ^ is_open[code], code, axis=0)
    parts, sigmas = _parts(gram, seen, (values * root).T @ (values * root), len(values), turn, inks, rules)
    return Decoded(
        turn=turn,
        code=code,
        left=float(left[turn, code]),
        left_by_code=float(others.min()) if len(others) else energy,
        left_by_turn=float(np.delete(left, turn, axis=0).min()),
        left_by_frame=energy - float(frame[0]),
        inks=inks,
        evidence=code_evidence_numpy(off, usual, columns[:, GAP:], contrast, is_open[code], differ, hiding),
        foreign=foreign_rectangle_numpy(points, values, off, usual, view.half_mm, hiding),
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


@lru_cache(maxsize=1)
def _kernel() -> Any:
    p, n = ctypes.c_void_p, ctypes.c_int64
    return function("lmkit_decode", n, *[p] * 7, n, *[p] * 4)
