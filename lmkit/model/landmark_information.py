"""`LandmarkInformation`: what one recording tells of its landmarks, whatever else it had to find out eliminated.

Recordings of one place share landmarks and nothing else.  The normal equations of all recordings together, once each
recording has eliminated its own poses and the errors of its odometry (the Schur complement; Triggs et al. 2000,
section 6), are therefore the sum of these, exactly: recordings can be taken one at a time, in any order, on any
machine.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse.linalg import splu

from lmkit.arrays import FloatArray, IntArray
from lmkit.geometry.rotations import rotation_log
from lmkit.model.landmark_id import LandmarkId

MOST_PENDING = 20_000_000  # entries that wait to be summed; bounds the memory however many recordings there are
DENSE_BELOW = 3000  # unknowns: a dense factorization is the faster one up to about there


@dataclass(frozen=True, eq=False)
class LandmarkInformation:
    """A quadratic cost of landmark poses, ``cost - 2 b'd + d' H d``, about a linearization.

    ``d`` holds, landmark by landmark, the shift (m) and the turn about the map's axes (rad) away from the
    linearization; of landmarks in the plane the shift in x and y alone.

    Attributes:
        ids: (L) of the landmarks.
        R, p: (L,3,3), (L,3) T_map_landmark at which the equations hold.
        H: (dL,dL) information, symmetric, with d = 6 or 2; it is singular where the recording does not say where
            the map lies.
        b: (dL,) half the negative gradient.
        cost: at the linearization.
    """

    ids: tuple[LandmarkId, ...]
    R: FloatArray
    p: FloatArray
    H: FloatArray
    b: FloatArray
    cost: float = 0.0

    @property
    def size(self) -> int:
        """Unknowns of one landmark: 6 in space, 2 in the plane."""
        return len(self.b) // max(len(self.ids), 1)

    def about(self, R: FloatArray, p: FloatArray) -> LandmarkInformation:
        """Quadratic cost about another linearization, (L,3,3) and (L,3).

        Exact in shifts; in turns to first order, so the two should not differ by more than a few degrees.
        """
        shift = p - self.p
        step = shift[:, : self.size].ravel()
        if self.size == 6:
            turn = rotation_log(R @ self.R.transpose(0, 2, 1))
            step = np.column_stack([shift, turn]).ravel()
        b = self.b - self.H @ step
        cost = self.cost - float((self.b + b) @ step)
        return LandmarkInformation(self.ids, R, p, self.H, b, cost)

    def __repr__(self) -> str:
        return f"LandmarkInformation({len(self.ids)} landmarks)"


class InformationSum:
    """Normal equations of many recordings in the landmarks that they share.

    Args:
        count: number of landmarks.
        size: unknowns of each.

    Examples:
        >>> import numpy as np
        >>> total = InformationSum(count=2, size=2)
        >>> total.add(np.array([0, 1]), np.eye(4), np.array([0.0, 0.0, 2.0, 2.0]))
        >>> total.add(np.array([1]), np.eye(2), np.zeros(2))
        >>> total.solve().reshape(2, 2).tolist()
        [[0.0, 0.0], [1.0, 1.0]]
    """

    def __init__(self, count: int, size: int) -> None:
        self.count, self.size = count, size
        self.b = np.zeros(count * size)
        self._dense = np.zeros((len(self.b), len(self.b))) if len(self.b) < DENSE_BELOW else None
        self._blocks: list[tuple[IntArray, FloatArray]] = []
        self._pending = 0
        self._sum = sparse.csc_matrix((len(self.b), len(self.b)))

    def add(self, rows: IntArray, H: FloatArray, b: FloatArray) -> None:
        """Add one recording's information.

        Args:
            rows: (L,) which landmarks of the sum its landmarks are, each at most once.
            H, b: (dL,dL), (dL,).
        """
        columns = unknowns_of(rows, self.size)
        self.b[columns] += b
        if self._dense is not None:
            self._dense[columns[:, None], columns] += H
        else:
            self._blocks.append((columns, H))
            self._pending += H.size
            if self._pending > MOST_PENDING:
                self._sum, self._blocks, self._pending = self.matrix(), [], 0

    def matrix(self) -> sparse.csc_matrix | FloatArray:
        """(dC,dC) summed information; sparse where it is large."""
        if self._dense is not None:
            return self._dense
        if not self._blocks:
            return self._sum
        parts = []
        for columns, H in self._blocks:
            block = sparse.coo_matrix(H)
            parts.append((block.data, columns[block.row], columns[block.col]))
        data, row, column = (np.concatenate(part) for part in zip(*parts, strict=True))
        return self._sum + sparse.coo_matrix((data, (row, column)), shape=self._sum.shape).tocsc()

    def solve(self) -> FloatArray:
        """(dC,) the step to the minimum.

        Raises:
            numpy.linalg.LinAlgError: something is not determined at all.
        """
        if self._dense is not None:
            return np.asarray(cho_solve(cho_factor(self._dense, check_finite=False), self.b, check_finite=False))
        try:
            return np.asarray(splu(self.matrix()).solve(self.b))
        except RuntimeError as error:
            raise np.linalg.LinAlgError(str(error)) from None

    def covariance(self) -> FloatArray:
        """(dC,dC) joint covariance of all landmarks.

        Raises:
            numpy.linalg.LinAlgError: something is not determined at all.
        """
        H = self.matrix()
        C = np.linalg.inv(H if isinstance(H, np.ndarray) else H.toarray())
        return np.asarray((C + C.T) / 2)


def unknowns_of(rows: IntArray | Sequence[int], size: int) -> IntArray:
    """(dL,) places of landmarks' unknowns among all."""
    return np.asarray((size * np.asarray(rows, dtype=np.int64)[:, None] + np.arange(size)).ravel())
