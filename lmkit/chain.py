"""Least squares over a chain of states that share some more unknowns: the shape of every drive.

Unknowns are N states of d numbers each, tied to their neighbours alone (by motion), and m numbers that many states
see (landmarks, scales, biases).  The normal equations are block tridiagonal with a border,

    [ T  B ] [x]   [g]
    [ B' C ] [y] = [h],

so that the chain is eliminated with a banded Cholesky factor and what is left is a dense matrix of the border alone
(the Schur complement; Triggs et al. 2000, section 6).  Work grows with N, not with its cube.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve, cho_solve_banded, cholesky_banded

from lmkit.arrays import FloatArray, IntArray


@dataclass(eq=False)
class ChainEquations:
    """Normal equations of a chain with a border.

    Attributes:
        diagonal: (N,d,d) of every state.
        following: (N-1,d,d) between state k (rows) and k + 1 (columns).
        border: (N,d,m) between states and what is shared.
        corner: (m,m) of what is shared.
        gradient: (N,d) of the states.
        shared_gradient: (m,).
    """

    diagonal: FloatArray
    following: FloatArray
    border: FloatArray
    corner: FloatArray
    gradient: FloatArray
    shared_gradient: FloatArray

    @classmethod
    def zeros(cls, count: int, size: int, shared: int) -> ChainEquations:
        """Nothing known yet."""
        return cls(
            np.zeros((count, size, size)),
            np.zeros((max(count - 1, 0), size, size)),
            np.zeros((count, size, shared)),
            np.zeros((shared, shared)),
            np.zeros((count, size)),
            np.zeros(shared),
        )

    def add_to_states(self, states: IntArray, J: FloatArray, r: FloatArray) -> None:
        """Residuals r (M,k) of single states, with derivatives J (M,k,d) of the predicted values."""
        Jt = J.transpose(0, 2, 1)
        np.add.at(self.diagonal, states, Jt @ J)
        np.add.at(self.gradient, states, (Jt @ r[..., None])[..., 0])

    def add_between(self, J_before: FloatArray, J_after: FloatArray, r: FloatArray) -> None:
        """Residuals r (N-1,k) of every two neighbours."""
        before, after = J_before.transpose(0, 2, 1), J_after.transpose(0, 2, 1)
        self.diagonal[:-1] += before @ J_before
        self.diagonal[1:] += after @ J_after
        self.following += before @ J_after
        self.gradient[:-1] += (before @ r[..., None])[..., 0]
        self.gradient[1:] += (after @ r[..., None])[..., 0]

    def add_shared(self, states: IntArray, J: FloatArray, columns: IntArray, K: FloatArray, r: FloatArray) -> None:
        """What residuals of states have to do with the shared unknowns in ``columns`` (M,c); K is (M,k,c)."""
        Kt = K.transpose(0, 2, 1)
        np.add.at(
            self.border,
            (states[:, None, None], np.arange(J.shape[2])[None, :, None], columns[:, None, :]),
            J.transpose(0, 2, 1) @ K,
        )
        np.add.at(self.corner, (columns[:, :, None], columns[:, None, :]), Kt @ K)
        np.add.at(self.shared_gradient, columns, (Kt @ r[..., None])[..., 0])

    def solve(self, damping: float = 0.0) -> tuple[FloatArray, FloatArray]:
        """Steps (N,d) of the states and (m,) of the shared unknowns.

        Args:
            damping: Levenberg's and Marquardt's, on the diagonal.

        Raises:
            numpy.linalg.LinAlgError: something is not determined at all.
        """
        factor = self._factor(damping)
        count, size, shared = self.border.shape
        inner = cho_solve_banded(factor, self.gradient.reshape(-1)).reshape(count, size)
        if shared == 0:
            return inner, np.zeros(0)
        W = cho_solve_banded(factor, self.border.reshape(count * size, shared))
        corner = self.corner + damping * np.diag(np.diag(self.corner))
        S = corner - self.border.reshape(count * size, shared).T @ W
        y = cho_solve(cho_factor(S), self.shared_gradient - np.einsum("ndm,nd->m", self.border, inner))
        return inner - (W @ y).reshape(count, size), y

    def covariances(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """(N,d,d) of every state, (N-1,d,d) between each and the next, and (m,m) of the shared unknowns.

        The states' own part by the forward and backward sweeps of a smoother (Rauch, Tung and Striebel 1965, in
        information form), and what the shared unknowns add.
        """
        count, size, shared = self.border.shape
        own, across = _blocks_of_inverse(self.diagonal, self.following)
        if shared == 0:
            return own, across, np.zeros((0, 0))
        W = cho_solve_banded(self._factor(0.0), self.border.reshape(count * size, shared))
        S = self.corner - self.border.reshape(count * size, shared).T @ W
        C = np.linalg.inv(S)
        W = W.reshape(count, size, shared)
        back = W.transpose(0, 2, 1)
        return own + W @ C @ back, across + W[:-1] @ C @ back[1:], np.asarray((C + C.T) / 2)

    def _factor(self, damping: float) -> tuple[FloatArray, bool]:
        return cholesky_banded(self._band(damping), lower=True), True

    def _band(self, damping: float) -> FloatArray:
        """(2d, N d) the block tridiagonal matrix as LAPACK's lower band."""
        count, size, _ = self.diagonal.shape
        band = np.zeros((2 * size, count, size))
        for i in range(size):
            for j in range(i + 1):
                band[i - j, :, j] = self.diagonal[:, i, j]
            for j in range(size):
                # Row i of state k + 1 and column j of state k.
                band[size + i - j, : count - 1, j] = self.following[:, j, i]
        band[0] *= 1 + damping
        return band.reshape(2 * size, count * size)


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
