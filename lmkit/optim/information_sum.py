"""`InformationSum`: summed normal equations of many recordings in their common landmarks, and their solution."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from lmkit.arrays import FloatArray, IntArray
from lmkit.optim.nested_dissection import solve_by_dissection

MOST_PENDING = 20_000_000  # entries not yet summed; bounds the memory for any number of recordings
DENSE_BELOW = 3000  # unknowns: a dense factorization is faster up to about this number


class InformationSum:
    """Normal equations of many recordings in their common landmarks.

    With many landmarks, only blocks of landmarks in the same recording are stored.

    Args:
        count: number of landmarks.
        size: unknowns of each, d.

    Examples:
        >>> import numpy as np
        >>> total = InformationSum(count=2, size=2)
        >>> total.add(np.array([0, 1]), np.eye(4), np.array([0.0, 0.0, 2.0, 2.0]))
        >>> total.add(np.array([1]), np.eye(2), np.zeros(2))
        >>> total.solve().reshape(2, 2).round(6).tolist()
        [[0.0, 0.0], [1.0, 1.0]]
    """

    def __init__(self, count: int, size: int) -> None:
        self.count, self.size = count, size
        self.b = np.zeros(count * size)
        self._dense = np.zeros((len(self.b), len(self.b))) if len(self.b) < DENSE_BELOW else None
        # Blocks of the upper triangle by row * count + column; the first item of the lists is already summed.
        self._keys: list[IntArray] = [np.zeros(0, dtype=np.int64)]
        self._blocks: list[FloatArray] = [np.zeros((0, size, size))]

    def add(self, rows: IntArray, H: FloatArray, b: FloatArray) -> None:
        """Add one recording's information.

        Args:
            rows: (L,) indices in the sum of the recording's landmarks, each at most once.
            H, b: (dL,dL), (dL,).
        """
        columns = unknowns_of(rows, self.size)
        self.b[columns] += b
        if self._dense is not None:
            self._dense[columns[:, None], columns] += H
            return
        rows = np.asarray(rows, dtype=np.int64)
        upper = rows[:, None] <= rows
        self._keys.append((rows[:, None] * self.count + rows)[upper])
        self._blocks.append(H.reshape(len(rows), self.size, len(rows), self.size).transpose(0, 2, 1, 3)[upper])
        if sum(blocks.size for blocks in self._blocks[1:]) > MOST_PENDING:
            self._sum_up()

    def solve(self) -> FloatArray:
        """(dC,) the step to the minimum.

        Raises:
            numpy.linalg.LinAlgError: something is not determined at all.
        """
        if self._dense is not None:
            return np.asarray(cho_solve(cho_factor(self._dense, check_finite=False), self.b, check_finite=False))
        self._sum_up()
        pairs = np.divmod(self._keys[0], self.count)
        return solve_by_dissection(self.count, self.size, pairs, self._blocks[0], self.b)

    def covariance(self) -> FloatArray:
        """(dC,dC) joint covariance of all landmarks.

        Raises:
            numpy.linalg.LinAlgError: something is not determined at all.
        """
        C = np.linalg.inv(self._as_dense())
        return np.asarray((C + C.T) / 2)

    def _sum_up(self) -> None:
        keys, blocks = np.concatenate(self._keys), np.concatenate(self._blocks)
        order = np.argsort(keys, kind="stable")
        keys = keys[order]
        first = np.flatnonzero(np.diff(keys, prepend=-1))
        self._keys = [keys[first]]
        self._blocks = [np.add.reduceat(blocks[order], first, axis=0)]

    def _as_dense(self) -> FloatArray:
        if self._dense is not None:
            return self._dense
        self._sum_up()
        row, column = np.divmod(self._keys[0], self.count)
        H = np.zeros((self.count, self.size, self.count, self.size))
        H[row, :, column, :] = self._blocks[0]
        H[column, :, row, :] = self._blocks[0].transpose(0, 2, 1)
        return H.reshape(len(self.b), len(self.b))


def unknowns_of(rows: IntArray | Sequence[int], size: int) -> IntArray:
    """(dL,) indices of landmarks' unknowns."""
    return np.asarray((size * np.asarray(rows, dtype=np.int64)[:, None] + np.arange(size)).ravel())
