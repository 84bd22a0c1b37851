"""`LandmarkInformation`: normal equations of one recording for its landmarks; its other unknowns are eliminated.

Recordings of one place share landmarks and nothing else.  The normal equations of all recordings together, once each
recording has eliminated its own poses and the errors of its odometry (the Schur complement; Triggs et al. 2000,
section 6), are therefore the sum of these, exactly: recordings can be taken one at a time, in any order, on any
machine.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.geometry.rotations import rotation_log
from lmkit.model.landmark_id import LandmarkId


@dataclass(frozen=True, eq=False)
class LandmarkInformation:
    """A quadratic cost of landmark poses, ``cost - 2 b'd + d' H d``, about a linearization.

    ``d`` holds, landmark by landmark, the shift (m) and the turn about the map's axes (rad) away from the
    linearization; of landmarks in the plane the shift in x and y alone.

    Attributes:
        ids: (L) of the landmarks.
        R, p: (L,3,3), (L,3) T_map_landmark at which the equations hold.
        H: (dL,dL) information, symmetric, with d = 6 or 2; it is singular if the recording does not determine where
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
