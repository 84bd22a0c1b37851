"""Alignment of the maps of single recordings by the landmarks that they share.

Every shared landmark has a full pose in both maps, and so gives a hypothesis of their relative pose.  Each hypothesis
is refined on all shared landmarks with Cauchy's loss, separately for positions and rotations, so that landmarks that
were moved, or have their second pose in one map, do not bias it; the most likely hypothesis is chosen.  If another
one is nearly as likely, the maps are not joined.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lmkit.arrays import BoolArray, FloatArray, IntArray
from lmkit.geometry.rotations import rotation_exp, rotation_log, skew
from lmkit.model.landmark_id import LandmarkId
from lmkit.optim.robust_loss import cauchy_cost, cauchy_weight

PLACE_FLOOR_M, TURN_FLOOR_RAD = 0.01, np.deg2rad(1.0)  # best agreement of two surveys of one room
SCALE = 2.0  # of the loss, standard deviations
FITS_SIGMA = 4.0  # root mean square of a landmark's place
STEPS = 15
SURE = 10.0  # of the cost, twice the log likelihood ratio
DIFFERENT_M, DIFFERENT_RAD = 0.3, 0.15
MOST_CANDIDATES = 60


@dataclass(frozen=True, eq=False)
class SingleMap:
    """Landmarks of a single recording in its own frame.

    Attributes:
        ids: (L); an id may come twice, where a landmark was moved.
        R, p: (L,3,3), (L,3) their poses.
        covariances: (L,6,6) of position and rotation.
        ambiguous: (L,) the second pose explains the recording as well.
    """

    ids: tuple[LandmarkId, ...]
    R: FloatArray
    p: FloatArray
    covariances: FloatArray
    ambiguous: BoolArray

    def transformed(self, R: FloatArray, t: FloatArray, covariance: FloatArray) -> SingleMap:
        """The map transformed by x -> R x + t, with the (6,6) covariance of the shift and rotation."""
        turned = np.kron(np.eye(2), R)
        p = self.p @ R.T
        J = np.tile(np.eye(6), (len(p), 1, 1))
        J[:, :3, 3:] = -skew(p)
        C = turned @ self.covariances @ turned.T + J @ covariance @ J.transpose(0, 2, 1)
        return SingleMap(self.ids, R @ self.R, p + t, C, self.ambiguous)

    def with_more(self, other: SingleMap, rows: Sequence[int]) -> SingleMap:
        """The map, and some landmarks of another one."""
        rows = list(rows)
        return SingleMap(
            self.ids + tuple(other.ids[k] for k in rows),
            np.concatenate([self.R, other.R[rows]]),
            np.concatenate([self.p, other.p[rows]]),
            np.concatenate([self.covariances, other.covariances[rows]]),
            np.concatenate([self.ambiguous, other.ambiguous[rows]]),
        )


@dataclass(frozen=True, eq=False)
class Placement:
    """Relative pose of two maps, x -> R x + t.

    Attributes:
        covariance: (6,6) of shift and rotation.
        pairs: (S,2) rows of the shared landmarks in both maps.
        fits: (S,) the positions agree.
        turned: (S,) the positions agree, the rotations do not.
        lead: cost of the next best placement minus that of this one; infinite without another.
    """

    R: FloatArray
    t: FloatArray
    covariance: FloatArray
    pairs: IntArray
    fits: BoolArray
    turned: BoolArray
    lead: float

    @property
    def agreeing(self) -> int:
        """Shared landmarks whose places agree."""
        return int(self.fits.sum())


def place_map(fixed: SingleMap, other: SingleMap) -> Placement | str:
    """Placement of ``other`` in ``fixed``, or a clause with the reason why there is none."""
    where = {id_: [k for k, i in enumerate(fixed.ids) if i == id_] for id_ in set(fixed.ids) & set(other.ids)}
    pairs = np.array([(k, row) for row, id_ in enumerate(other.ids) for k in where.get(id_, ())]).reshape(-1, 2)
    if not len(pairs):
        return "shares no landmark with the others"
    match = _Match(fixed, other, pairs)
    sure = [s for s, (a, b) in enumerate(pairs) if not (fixed.ambiguous[a] or other.ambiguous[b])]
    if not sure:
        return "shares only landmarks whose pose is ambiguous; see them from another side"
    spread = match.spread()
    best_first = sorted(sure, key=lambda s: spread[s])[:MOST_CANDIDATES]
    found = sorted((match.refined(*match.by_one(s)) for s in best_first), key=lambda answer: answer[0])
    cost, R, t = found[0]
    lead = min(
        (
            c - cost
            for c, R_other, t_other in found[1:]
            if np.linalg.norm(match.center @ (R_other - R).T + t_other - t) > DIFFERENT_M
            or np.linalg.norm(rotation_log(R_other @ R.T)) > DIFFERENT_RAD
        ),
        default=float("inf"),
    )
    placement = match.placement(R, t, lead)
    shared = len({other.ids[b] for _, b in pairs})
    if lead < SURE:
        return f"shares {shared} landmarks that allow two places for it, and none is clearly better"
    if 2 * placement.agreeing < shared:
        return f"shares {shared} landmarks, of which only {placement.agreeing} agree with the others on their places"
    return placement


class _Match:
    """Shared landmarks of two maps."""

    def __init__(self, fixed: SingleMap, other: SingleMap, pairs: IntArray) -> None:
        self.pairs = pairs
        a, b = pairs.T
        self.R_fixed, self.p_fixed, self.C_fixed = fixed.R[a], fixed.p[a], fixed.covariances[a]
        self.R, self.p, self.C = other.R[b], other.p[b], other.covariances[b]
        self.center = self.p.mean(axis=0)

    def spread(self) -> FloatArray:
        """(S,) uncertainty of the placement from each landmark alone."""
        both = self.C_fixed + self.C
        return np.asarray(np.trace(both[:, 3:, 3:], axis1=1, axis2=2))

    def by_one(self, s: int) -> tuple[FloatArray, FloatArray]:
        """Placement by one landmark alone."""
        R = self.R_fixed[s] @ self.R[s].T
        return R, self.p_fixed[s] - R @ self.p[s]

    def refined(self, R: FloatArray, t: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        """Cost and placement after refinement on all shared landmarks."""
        for _ in range(STEPS):
            H, g, _ = self._equations(R, t)
            step = np.linalg.solve(H, g)
            R, t = rotation_exp(step[3:]) @ R, t + step[:3]
            # The rotation is about the origin of the aligned map's arms; shifts are exact.
            if np.abs(step).max() < 1e-9:
                break
        return self._equations(R, t)[2], R, t

    def placement(self, R: FloatArray, t: FloatArray, lead: float) -> Placement:
        place, turn = self._standardized(R, t)[:2]
        fits = np.sqrt((place**2).mean(axis=1)) < FITS_SIGMA
        turned = fits & (np.sqrt((turn**2).mean(axis=1)) > FITS_SIGMA)
        return Placement(R, t, np.linalg.inv(self._equations(R, t)[0]), self.pairs, fits, turned, lead)

    def _standardized(self, R: FloatArray, t: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """(S,3) errors of places and of turns, and their (S,3,3) whiteners."""
        C_place = self.C_fixed[:, :3, :3] + R @ self.C[:, :3, :3] @ R.T + PLACE_FLOOR_M**2 * np.eye(3)
        C_turn = self.C_fixed[:, 3:, 3:] + R @ self.C[:, 3:, 3:] @ R.T + TURN_FLOOR_RAD**2 * np.eye(3)
        W_place, W_turn = (np.linalg.inv(np.linalg.cholesky(C)) for C in (C_place, C_turn))
        place = self.p_fixed - self.p @ R.T - t
        turn = rotation_log(self.R_fixed @ (R @ self.R).transpose(0, 2, 1))
        return _times(W_place, place), _times(W_turn, turn), W_place, W_turn

    def _equations(self, R: FloatArray, t: FloatArray) -> tuple[FloatArray, FloatArray, float]:
        place, turn, W_place, W_turn = self._standardized(R, t)
        J = np.concatenate([np.tile(np.eye(3), (len(place), 1, 1)), -skew(self.p @ R.T)], axis=2)
        K = np.concatenate([np.zeros_like(W_turn), np.tile(np.eye(3), (len(place), 1, 1))], axis=2)
        H, g, cost = 1e-9 * np.eye(6), np.zeros(6), 0.0
        for r, A in ((place, W_place @ J), (turn, W_turn @ K)):
            squared = (r**2).mean(axis=1)
            w = cauchy_weight(squared, SCALE)
            H = H + np.einsum("s,sia,sib->ab", w, A, A)
            g = g + np.einsum("s,sia,si->a", w, A, r)
            cost += float(3 * cauchy_cost(squared, SCALE).sum())
        return H, g, cost


def _times(W: FloatArray, r: FloatArray) -> FloatArray:
    return np.asarray((W @ r[..., None])[..., 0])
