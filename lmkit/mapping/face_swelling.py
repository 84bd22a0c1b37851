"""Swelling of faces: landmarks appear larger or smaller than they are, by amounts that each recording estimates.

Exposure, sharpening, tone curves and prints of the wrong size move the edges of all faces by the same 0.03 to 0.1 px
to the inside or the outside.  That does not average out over images: a face of 25 px that seems 0.1 px smaller seems
0.4 % farther away, in all images of all landmarks.  Corners are shifted outward by one amount along the width of the
face and by another along its height, the same in all images: two parameters of the recording.  Single landmarks
deviate from them less, because of light, distance and print: two parameters of each landmark.  The baseline, the
odometry and the different distances of the faces determine these parameters.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.kernels.face_swelling import SIZE, FaceSums, add_face_equations, outward
from lmkit.kernels.landmark_bundle import Bundle
from lmkit.mapping.stated_equations import StatedEquations
from lmkit.optim.block_chain import ChainEquations
from lmkit.optim.border_blocks import BlockPattern

# Prior of cameras whose corners are stated to `STATED_PX` or worse.  What shifts edges also leaves residuals: below,
# the prior is proportional (decision 66).  The least share allows for prints of the wrong size.
SIGMA_PX, STATED_PX, LEAST_SHARE = 0.06, 0.12, 1 / 3
# Of one landmark relative to all, at this side; it falls with the square of the side.
FACE_SIGMA_PX, FACE_SIDE_PX = 0.018, 30.0
LEAST_SIDE_PX = 15.0  # smaller faces are treated as this large


@dataclass(frozen=True)
class SwellingPrior:
    """Standard deviations of the swelling, whose mean is 0.

    Attributes:
        share: of the standard deviations of cameras with large errors of corners.
    """

    share: float

    @classmethod
    def of(cls, variances: FloatArray) -> SwellingPrior:
        """Prior of a recording with these stated variances (S,) of corners, px^2; 0 is an unknown one."""
        stated = np.sqrt(np.where(variances > 0, variances, np.inf))
        middle = float(np.median(stated)) if len(stated) else np.inf
        return cls(min(max(middle / STATED_PX, LEAST_SHARE), 1.0))

    @property
    def common_px(self) -> float:
        """Standard deviation of the swelling of all faces, px."""
        return SIGMA_PX * self.share

    def faces_px(self, sides: FloatArray) -> FloatArray:
        """(L,) standard deviation of the swelling of single faces with these sides, px."""
        return np.asarray(self.share * FACE_SIGMA_PX * (FACE_SIDE_PX / np.maximum(sides, LEAST_SIDE_PX)) ** 2)


def without_swelling(bundle: Bundle, swelling: FloatArray, faces: FloatArray) -> FloatArray:
    """(S,4,2) the observed rays, corrected for a swelling (2,) of all, and (L,2) of each landmark, px."""
    shifts = (outward(bundle) @ (swelling + faces[bundle.of])[:, :, None])[:, :, 0]
    return np.asarray(bundle.rays - shifts.reshape(-1, 4, 2))


def face_sides(bundle: Bundle) -> FloatArray:
    """(L,) mean side of each landmark in its observations, px; 0 of those without any."""
    pixels = (bundle.by_ray @ bundle.rays[..., None])[..., 0]
    sides = np.linalg.norm(pixels - np.roll(pixels, 1, axis=1), axis=2).mean(axis=1)
    count = len(bundle.p_landmark)
    seen = np.bincount(bundle.of, minlength=count)
    return np.asarray(np.bincount(bundle.of, sides, count) / np.maximum(seen, 1))


def hold_swelling(e: ChainEquations, first: int, prior: SwellingPrior) -> None:
    """Fix the swelling, the shared unknowns from ``first`` on, in equations."""
    rows = np.arange(first, first + SIZE)
    e.corner[rows, rows] += prior.common_px**-2


def with_swelling(
    held: ChainEquations,
    bundle: Bundle,
    weights: FloatArray,
    sums: FaceSums,
    pattern: BlockPattern,
    own: int,
    swelling: FloatArray,
    faces: FloatArray,
    prior: SwellingPrior,
) -> StatedEquations:
    """Equations of all unknowns, from equations with fixed swelling.

    Args:
        bundle: without the swelling, at the current state.
        weights: (S,) of the observations.
        sums: zeros, of the blocks of ``pattern``.
        own: shared unknowns before the landmarks, the last of which are the swelling of all.
        swelling, faces: (2,), (L,2) px, current values.
        prior: of both.
    """
    add_face_equations(bundle, weights, sums)
    stated = StatedEquations.of(held, sums, pattern, own)
    stated.know_faces(faces, prior.faces_px(face_sides(bundle)))
    stated.chain.shared_gradient[own - SIZE : own] -= swelling / prior.common_px**2
    return stated
