"""How much larger or smaller a camera shows landmarks than they are: two numbers that a recording finds for itself.

Exposure, sharpening, tone curves and prints of the wrong size move the edges of all faces alike, by 0.03 to 0.1 px to
the inside or the outside.  That does not average out over images: a face of 25 px that seems 0.1 px smaller seems
0.4 % farther away, in all images of all landmarks.  Corners stand outside their places by one way along the width of
the face and by another along its height, in all images alike.  The baseline, the odometry and the faces' different
distances tell of both.
"""

from __future__ import annotations

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.kernels.face_swelling import SIZE, add_swelling_equations, outward
from lmkit.kernels.landmark_bundle import Bundle, Sums
from lmkit.optim.block_chain import ChainEquations

SIGMA_PX = 0.06  # simulated cameras of five kinds: 0.01 to 0.09 px


def without_swelling(bundle: Bundle, swelling: FloatArray) -> FloatArray:
    """(S,4,2) the observed rays, put back by a swelling (2,) in px."""
    return np.asarray(bundle.rays - (outward(bundle) @ swelling).reshape(-1, 4, 2))


def hold_swelling(e: ChainEquations, first: int) -> None:
    """Let equations leave the swelling as it stands, which are the shared unknowns from ``first`` on."""
    rows = np.arange(first, first + SIZE)
    e.corner[rows, rows] += SIGMA_PX**-2


def add_swelling(bundle: Bundle, weights: FloatArray, swelling: FloatArray, sums: Sums) -> None:
    """Add what observations say of the swelling, to equations that hold it.

    Args:
        bundle: without the swelling, as it stands.
        weights: (S,) of the observations.
        swelling: (2,) px.
        sums: the equations; the swelling is the last of the shared unknowns before the landmarks.
    """
    add_swelling_equations(bundle, weights, sums)
    sums.shared_gradient[sums.own - SIZE : sums.own] -= swelling / SIGMA_PX**2
