"""Least squares over a chain of states with additional shared unknowns: the structure of every recording.

Unknowns are N states of d numbers each, linked by motion to their neighbors only, and m numbers shared by many states
(landmarks, scales, biases).  The normal equations are block tridiagonal with a border,

    [ T  B ] [x]   [g]
    [ B' C ] [y] = [h].

The chain is cut into pieces, and the states between two cuts are eliminated (nested dissection; George 1973): a
short piece observes few landmarks, so its border is narrow.  The cut states form a shorter chain of the same
structure.  This chain is eliminated as a whole, which leaves a dense matrix of the
border only (the Schur complement; Triggs et al. 2000, section 6).  Work grows with N, not with its cube.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.linalg.blas import dsyrk
from scipy.linalg.lapack import dpotrf, dpotri

from lmkit.arrays import FloatArray, IntArray
from lmkit.kernels.block_chain import (
    Cuts,
    backward_chain,
    factor_chain,
    forward_chain,
    subtract_piece,
    take_columns,
    used_columns,
)
from lmkit.optim.border_blocks import BlockPattern, BorderBlocks

PIECE = 21  # states between two cuts


@dataclass(eq=False)
class ChainEquations:
    """Normal equations of a chain with a border.

    Attributes:
        diagonal: (N,d,d) of every state.
        following: (N-1,d,d) between state k (rows) and k + 1 (columns).
        border: (N,d,b) between states and the first b shared unknowns: all of them if there are no blocks.
        corner: (m,m) of the shared unknowns.
        gradient: (N,d) of the states.
        shared_gradient: (m,).
        blocks: blocks of the border for the other shared unknowns.
    """

    diagonal: FloatArray
    following: FloatArray
    border: FloatArray
    corner: FloatArray
    gradient: FloatArray
    shared_gradient: FloatArray
    blocks: BorderBlocks | None = None

    @classmethod
    def zeros(cls, count: int, size: int, shared: int, pattern: BlockPattern | None = None) -> ChainEquations:
        """Equations without information; with a pattern, the border has blocks from its first unknown on."""
        return cls(
            np.zeros((count, size, size)),
            np.zeros((max(count - 1, 0), size, size)),
            np.zeros((count, size, shared if pattern is None else pattern.first)),
            np.zeros((shared, shared)),
            np.zeros((count, size)),
            np.zeros(shared),
            None if pattern is None else BorderBlocks.zeros(pattern, size),
        )

    @property
    def nbytes(self) -> int:
        """Memory of the numbers."""
        arrays = [self.diagonal, self.following, self.border, self.corner]
        return sum(array.nbytes for array in arrays) + (0 if self.blocks is None else self.blocks.values.nbytes)

    def dense_border(self) -> FloatArray:
        """(N,d,m) between states and all shared unknowns."""
        return self._border_of(np.arange(len(self.diagonal)))

    def add_to_states(self, states: IntArray, J: FloatArray, r: FloatArray) -> None:
        """Residuals r (M,k) of single states, with derivatives J (M,k,d) of the predicted values."""
        Jt = J.transpose(0, 2, 1)
        np.add.at(self.diagonal, states, Jt @ J)
        np.add.at(self.gradient, states, (Jt @ r[..., None])[..., 0])

    def add_between(self, J_before: FloatArray, J_after: FloatArray, r: FloatArray) -> None:
        """Residuals r (N-1,k) of every two neighbors."""
        before, after = J_before.transpose(0, 2, 1), J_after.transpose(0, 2, 1)
        self.diagonal[:-1] += before @ J_before
        self.diagonal[1:] += after @ J_after
        self.following += before @ J_after
        self.gradient[:-1] += (before @ r[..., None])[..., 0]
        self.gradient[1:] += (after @ r[..., None])[..., 0]

    def add_shared(self, states: IntArray, J: FloatArray, columns: IntArray, K: FloatArray, r: FloatArray) -> None:
        """Add the derivatives K (M,k,c) of residuals by shared unknowns ``columns`` (M,c), which are in no block."""
        Kt = K.transpose(0, 2, 1)
        shared = len(self.corner)
        self.add_across(states, J, columns, K)
        _add_at(self.corner, columns[:, :, None] * shared + columns[:, None], Kt @ K)
        _add_at(self.shared_gradient, columns, (Kt @ r[..., None])[..., 0])

    def add_across(self, states: IntArray, J: FloatArray, columns: IntArray, K: FloatArray) -> None:
        """Add to the border only: the second state of residuals whose first state was added by `add_shared`."""
        _, size, wide = self.border.shape
        rows = size * states[:, None, None] + np.arange(size)[:, None]
        _add_at(self.border, rows * wide + columns[:, None], J.transpose(0, 2, 1) @ K)

    def solve(self, damping: float = 0.0) -> tuple[FloatArray, FloatArray]:
        """Steps (N,d) of the states and (m,) of the shared unknowns.

        Args:
            damping: Levenberg's and Marquardt's, on the diagonal.

        Raises:
            numpy.linalg.LinAlgError: an unknown is not determined.
        """
        pieces, cuts = self._without_pieces(damping)
        at_cuts, y = cuts._solve_whole()
        states = np.empty_like(self.gradient)
        states[PIECE :: PIECE + 1] = at_cuts
        for piece in pieces:
            states[piece.states] = piece.solve(at_cuts, y)
        return states, y

    def eliminate(self, own: int, damping: float = 0.0) -> EliminatedChain:
        """Equations of the shared unknowns that remain after the first ``own`` of them are eliminated.

        Args:
            own: shared unknowns that are eliminated together with the states.
            damping: as for :meth:`solve`.

        Raises:
            numpy.linalg.LinAlgError: a state, or one of the first unknowns, is not determined.
        """
        pieces, cuts = self._without_pieces(damping)
        return EliminatedChain(self.gradient.shape, pieces, cuts, own)

    def covariances(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """(N,d,d) of every state, (N-1,d,d) between each and the next, and (m,m) of the shared unknowns."""
        pieces, cuts = self._without_pieces()
        known = cuts._covariances_whole()
        own, across = np.empty_like(self.diagonal), np.empty_like(self.following)
        own[PIECE :: PIECE + 1] = known[0]
        for piece in pieces:
            piece.covariances(*known, own, across)
        return own, across, known[3]

    def _border_of(self, states: IntArray) -> FloatArray:
        """(K,d,m) between some states and all shared unknowns."""
        if self.blocks is None:
            return np.asarray(self.border[states])
        whole = self.blocks.rows(states, len(self.corner))
        whole[:, :, : self.border.shape[2]] = self.border[states]
        return whole

    def columns_of(self, start: int, end: int) -> tuple[IntArray, int]:
        """Shared unknowns (c,) linked with states ``start`` to ``end``, and the number of them outside blocks."""
        _, size, wide = self.border.shape
        columns = used_columns(self.border[start:end].reshape(size * (end - start), wide))
        if self.blocks is None:
            return columns, len(columns)
        return np.concatenate([columns, self.blocks.pattern.columns_of(start, end)[0]]), len(columns)

    def put_border(self, start: int, end: int, columns: IntArray, into: FloatArray) -> None:
        """Write the border of some states into the zero columns (n d,c) of their shared unknowns.

        Args:
            columns: the first columns: shared unknowns outside blocks.
        """
        rows = self.border[start:end].reshape(len(into), self.border.shape[2])
        take_columns(rows, columns, into[:, : len(columns)])
        if self.blocks is not None:
            self.blocks.put(start, end, into[:, len(columns) :])

    def _without_pieces(self, damping: float = 0.0) -> tuple[list[_Piece], ChainEquations]:
        """The pieces between the cuts, and the equations of the cuts after eliminating the pieces."""
        count, size = self.gradient.shape
        at = slice(PIECE, None, PIECE + 1)
        damped = replace(self, diagonal=_damped(self.diagonal, damping))
        cuts = ChainEquations(
            damped.diagonal[at].copy(),
            np.zeros((max(len(damped.diagonal[at]) - 1, 0), size, size)),
            self._border_of(np.arange(PIECE, count, PIECE + 1)),
            _damped(self.corner[None], damping)[0],
            self.gradient[at].copy(),
            self.shared_gradient.copy(),
        )
        into = Cuts(cuts.diagonal, cuts.following, cuts.gradient, cuts.border, cuts.corner, cuts.shared_gradient)
        pieces, scratch = [], np.empty((2 * size + len(self.corner) + 1) ** 2)
        for number, first in enumerate(range(0, count, PIECE + 1)):
            piece = _Piece.of(damped, number, slice(first, min(first + PIECE, count)))
            piece.take_from(into, scratch)
            pieces.append(piece)
        return pieces, cuts

    def _solve_whole(self) -> tuple[FloatArray, FloatArray]:
        """Steps as of `solve`, without pieces; overwrites the corner, since allocating its size takes long."""
        count, size = self.gradient.shape
        if count == 0:
            return self.gradient, _solved(self.corner.T, self.shared_gradient)
        factor, half = self._eliminated()
        border, right = half[:, :-1], half[:, -1]
        y: FloatArray = self.shared_gradient - border.T @ right
        if len(y):
            S = dsyrk(-1.0, border.T, beta=1.0, c=self.corner.T, overwrite_c=True, lower=True)
            y = _solved(S, y)
        return _backward(factor, right - border @ y).reshape(count, size), y

    def _eliminated(self) -> tuple[FloatArray, FloatArray]:
        """The factor L of all states, and the inverse of L on the border and the gradient (N d,m+1)."""
        factor = factor_chain(self.diagonal, self.following)
        half = np.column_stack([self.border.reshape(len(factor), self.border.shape[2]), self.gradient.reshape(-1)])
        forward_chain(factor, half)
        return factor, half

    def _covariances_whole(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """(N,d,d) of every state, (N-1,d,d) between each and the next, (N,d,m) and (m,m) with the shared unknowns.

        The states' own part comes from forward and backward passes of a smoother (Rauch, Tung and Striebel 1965, in
        information form); the part of the shared unknowns is added.
        """
        (count, size), shared = self.gradient.shape, len(self.corner)
        own, across = _blocks_of_inverse(self.diagonal, self.following)
        if shared == 0 or count == 0:
            return own, across, self.border, _inverse(self.corner)
        factor, half = self._eliminated()
        half = half[:, :-1]
        C = _inverse(self.corner - half.T @ half)
        W = _backward(factor, half)
        WC = (W @ C).reshape(count, size, shared)
        back = W.reshape(count, size, shared).transpose(0, 2, 1)
        return own + WC @ back, across + WC[:-1] @ back[1:], -WC, C


class EliminatedChain:
    """A chain whose states, and whose first shared unknowns, are eliminated (Schur complement).

    Attributes:
        information: (k,k) of the remaining shared unknowns.
        gradient: (k,) of the remaining shared unknowns.
    """

    def __init__(self, shape: tuple[int, ...], pieces: list[_Piece], cuts: ChainEquations, own: int) -> None:
        self._shape, self._pieces, self._cuts, self._own = shape, pieces, cuts, own
        S, g = cuts.corner, cuts.shared_gradient
        if len(cuts.diagonal):
            self._factor, self._half = cuts._eliminated()
            S, g = S - self._half[:, :-1].T @ self._half[:, :-1], g - self._half[:, :-1].T @ self._half[:, -1]
        across = np.column_stack([S[:own, own:], g[:own]])
        solved = cho_solve(cho_factor(S[:own, :own]), across) if own else across
        self._own_by_kept, self._own_alone = solved[:, :-1], solved[:, -1]
        self.information: FloatArray = S[own:, own:] - S[own:, :own] @ self._own_by_kept
        self.gradient: FloatArray = g[own:] - S[own:, :own] @ self._own_alone

    def solve(self, kept: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Steps (N,d) of the states and (m,) of all shared unknowns, from the steps (k,) of the remaining ones."""
        shared = np.concatenate([self._own_alone - self._own_by_kept @ kept, kept])
        states, size = np.empty(self._shape), self._shape[1]
        at_cuts: FloatArray = np.empty((len(self._cuts.diagonal), size))
        if len(at_cuts):
            right = self._half[:, -1] - self._half[:, :-1] @ shared
            at_cuts = _backward(self._factor, right).reshape(-1, size)
            states[PIECE :: PIECE + 1] = at_cuts
        for piece in self._pieces:
            states[piece.states] = piece.solve(at_cuts, shared)
        return states, shared


@dataclass(frozen=True, eq=False)
class _Piece:
    """Eliminated states between two cuts: their matrix A = L L', and their off-diagonal equations E.

    Attributes:
        states: range of the states.
        cuts: numbers of the existing cuts before and after.
        columns: (c,) shared unknowns linked with the piece.
        factor: (nd,2d) L, as `factor_chain` stores it.
        whole: (nd,ld+c+1) the inverse of L on E, and on the gradient.
    """

    states: slice
    cuts: IntArray
    columns: IntArray
    factor: FloatArray
    whole: FloatArray

    @classmethod
    def of(cls, chain: ChainEquations, number: int, states: slice) -> _Piece:
        """Eliminate the states of piece ``number``."""
        count, size = chain.gradient.shape
        first, end = states.start, states.stop
        columns, own = chain.columns_of(first, end)
        cuts = [cut for cut in (number - 1, number) if cut >= 0 and cut * (PIECE + 1) + PIECE < count]
        # E, and the gradient as its last column.
        inner = size * len(cuts)
        whole = np.zeros((size * (end - first), inner + len(columns) + 1))
        if number > 0:
            whole[:size, :size] = chain.following[first - 1].T
        if number in cuts:
            whole[-size:, inner - size : inner] = chain.following[end - 1]
        chain.put_border(first, end, columns[:own], whole[:, inner:-1])
        whole[:, -1] = chain.gradient[states].ravel()
        factor = factor_chain(chain.diagonal[states], chain.following[first : end - 1])
        forward_chain(factor, whole)
        return cls(states, np.array(cuts, dtype=np.int64), columns, factor, whole)

    @property
    def half(self) -> FloatArray:
        """(nd,ld+c) the inverse of L on E: l cuts, then the shared unknowns."""
        return self.whole[:, :-1]

    def take_from(self, cuts: Cuts, scratch: FloatArray) -> None:
        """Eliminate the piece from the equations of the cuts.

        Args:
            scratch: memory for a square matrix of all columns and one more; allocating it for every piece costs
                more than computing the product.
        """
        wide = self.whole.shape[1]
        S = np.matmul(self.whole.T, self.whole, out=scratch[: wide * wide].reshape(wide, wide))
        subtract_piece(S, int(self.cuts[0]) if len(self.cuts) else 0, len(self.cuts), self.columns, cuts)

    def solve(self, at_cuts: FloatArray, shared: FloatArray) -> FloatArray:
        """(n,d) steps of its states from the steps of all cuts and shared unknowns."""
        z = np.concatenate([at_cuts[self.cuts].ravel(), shared[self.columns]])
        return _backward(self.factor, self.whole[:, -1] - self.half @ z).reshape(-1, at_cuts.shape[1])

    def covariances(
        self,
        own: FloatArray,
        across: FloatArray,
        with_shared: FloatArray,
        shared: FloatArray,
        all_own: FloatArray,
        all_across: FloatArray,
    ) -> None:
        """Write the covariance blocks of its states into the full result, from the covariances of the cuts."""
        size = own.shape[1]
        inner, count = size * len(self.cuts), len(self.cuts)
        C = np.empty((self.half.shape[1], self.half.shape[1]))
        C[inner:, inner:] = shared[np.ix_(self.columns, self.columns)]
        blocks = C[:inner, :inner].reshape(count, size, count, size)
        blocks[np.arange(count), :, np.arange(count)] = own[self.cuts]
        if count == 2:
            blocks[0, :, 1], blocks[1, :, 0] = across[self.cuts[0]], across[self.cuts[0]].T
        C[:inner, inner:] = with_shared[self.cuts][:, :, self.columns].reshape(inner, len(self.columns))
        C[inner:, :inner] = C[:inner, inner:].T
        inverse = np.eye(len(self.factor))
        forward_chain(self.factor, inverse)
        length = len(self.factor) // size
        alone = (inverse.T @ inverse).reshape(length, size, length, size)
        F = _backward(self.factor, self.half)
        FC = (F @ C).reshape(length, size, -1)
        back = F.reshape(length, size, -1).transpose(0, 2, 1)
        with_cuts = -FC[:, :, :inner].reshape(length, size, count, size)
        k = np.arange(length)
        first, end = self.states.start, self.states.stop
        all_own[self.states] = alone[k, :, k] + FC @ back
        all_across[first : end - 1] = alone[k[:-1], :, k[1:]] + FC[:-1] @ back[1:]
        if first > 0:
            all_across[first - 1] = with_cuts[0, :, 0].T
        if end < len(all_own):
            all_across[end - 1] = with_cuts[-1, :, -1]


def _damped(matrices: FloatArray, damping: float) -> FloatArray:
    """A copy of matrices (N,d,d) with their diagonals multiplied by 1 + damping."""
    copy, k = matrices.copy(), np.arange(matrices.shape[1])
    copy[:, k, k] *= 1 + damping
    return copy


def _solved(S: FloatArray, g: FloatArray) -> FloatArray:
    """The inverse of S times g, from the lower triangle of S; overwrites S, which is stored by columns."""
    if not len(g):
        return g
    factor = cho_factor(S, lower=True, overwrite_a=True, check_finite=False)
    return np.asarray(cho_solve(factor, g, check_finite=False))


def _inverse(S: FloatArray) -> FloatArray:
    """Inverse of a symmetric matrix; half the work if it is positive definite."""
    factor, failed = dpotrf(S.T, lower=False)
    if failed:
        inverse = np.linalg.inv(S)
        return np.asarray((inverse + inverse.T) / 2)
    inverse, _ = dpotri(factor, lower=False, overwrite_c=True)  # zero below the diagonal, as the factor
    whole = inverse + inverse.T
    np.fill_diagonal(whole, inverse.diagonal())
    return np.asarray(whole)


def _backward(factor: FloatArray, right: FloatArray) -> FloatArray:
    """The inverse of the transposed factor times ``right`` (N d,) or (N d,w)."""
    solved = np.array(right, order="C").reshape(len(right), -1)
    backward_chain(factor, solved)
    return solved.reshape(right.shape)


def _add_at(array: FloatArray, places: IntArray, values: FloatArray) -> None:
    """Add to an array at flat indices, which is much faster in numpy than several indices."""
    np.add.at(array.reshape(-1), places.ravel(), values.ravel())


def _blocks_of_inverse(diagonal: FloatArray, following: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(N,d,d) diagonal and (N-1,d,d) following blocks of the inverse of a block tridiagonal matrix."""
    count = len(diagonal)
    forward, gains = np.array(diagonal), np.zeros_like(following)
    for k in range(count - 1):
        gains[k] = np.linalg.solve(forward[k], following[k])
        forward[k + 1] -= following[k].T @ gains[k]
    inverse, across = np.linalg.inv(forward), np.zeros_like(following)
    for k in range(count - 2, -1, -1):
        across[k] = -gains[k] @ inverse[k + 1]
        inverse[k] -= across[k] @ gains[k].T
    return inverse, across
