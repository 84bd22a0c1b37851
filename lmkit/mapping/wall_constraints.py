"""Constraints declared beforehand: landmarks that share one flat wall, or one height.

Deviations with standard deviation s from an unknown common plane are equivalent to
deviations of all pairs of n landmarks from each other with s sqrt(n): so no plane is estimated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np

from lmkit.arrays import FloatArray, IntArray
from lmkit.model.landmark_id import LandmarkId, ids_text
from lmkit.optim.block_chain import ChainEquations
from lmkit.optim.robust_loss import cauchy_cost, cauchy_weight

LOSS_SCALE = 3.0  # of a landmark's own deviation, scale of the loss of motions


@dataclass(frozen=True)
class LandmarkConstraint:
    """Landmarks that share a wall or a height.

    Attributes:
        kind: ``wall`` (one plane, one direction) or ``height``.
        ids: two landmarks or more.
        sigma_m, sigma_rad: standard deviations, out of the plane or in height, and off its normal.
    """

    kind: str
    ids: tuple[LandmarkId, ...]
    sigma_m: float
    sigma_rad: float

    def __str__(self) -> str:
        return f"{self.kind} {ids_text(self.ids)}"


@dataclass(frozen=True, eq=False)
class ConstraintRows:
    """Standardized residuals (M,) of pairs of landmarks, derivatives (M,12) with both, and which they are (M,2)."""

    residuals: FloatArray
    derivatives: FloatArray
    pairs: IntArray

    @property
    def weights(self) -> FloatArray:
        """(M,) Cauchy weights, so that a landmark off its constraint does not distort the map."""
        return cauchy_weight(self.residuals**2, self._loss_scale)

    @property
    def cost(self) -> float:
        """Cauchy's loss of all of them."""
        return float(cauchy_cost(self.residuals**2, self._loss_scale).sum())

    @property
    def _loss_scale(self) -> float:
        return float(LOSS_SCALE / np.sqrt(len(np.unique(self.pairs))))


def add_constraint(
    equations: ChainEquations,
    constraint: LandmarkConstraint,
    members: Sequence[int],
    R: FloatArray,
    p: FloatArray,
    first: int,
) -> float:
    """Add a constraint to equations whose shared unknowns from ``first`` on are the landmarks'; its cost.

    Args:
        members: indices of the constraint's landmarks.
        R, p: (L,3,3), (L,3) T_map_landmark of all.
    """
    if len(members) < 2:
        return 0.0
    rows = constraint_rows(constraint, members, R, p)
    root = np.sqrt(rows.weights)
    J, r = rows.derivatives * root[:, None], rows.residuals * root
    columns = (first + 6 * rows.pairs[:, :, None] + np.arange(6)).reshape(-1, 12)
    np.add.at(equations.corner, (columns[:, :, None], columns[:, None]), J[:, :, None] * J[:, None])
    np.add.at(equations.shared_gradient, columns, J * r[:, None])
    return rows.cost


def constraint_rows(
    constraint: LandmarkConstraint, members: Sequence[int], R: FloatArray, p: FloatArray
) -> ConstraintRows:
    """Residual rows of a constraint for landmarks as they are mounted.

    Args:
        members: rows of the constraint's landmarks in ``R`` (L,3,3) and ``p`` (L,3), of T_map_landmark.
    """
    spread = np.sqrt(len(members))
    residuals: list[float] = []
    derivatives: list[FloatArray] = []
    pairs: list[tuple[int, int]] = []

    def say(a: int, b: int, value: float, by_a: FloatArray, by_b: FloatArray, sigma: float) -> None:
        residuals.append(-value / sigma)
        derivatives.append(np.concatenate([by_a, by_b]) / sigma)
        pairs.append((a, b))

    # Each pair in both orders, at half the weight.
    sigma_m, sigma_rad = constraint.sigma_m * spread * np.sqrt(2), constraint.sigma_rad * spread * np.sqrt(2)
    none, up = np.zeros(3), np.array([0.0, 0.0, 1.0])
    for a, b in permutations(members, 2):
        away = p[b] - p[a]
        if constraint.kind == "height":
            say(a, b, away[2], np.concatenate([-up, none]), np.concatenate([up, none]), sigma_m)
            continue
        x, y, z = R[a].T
        say(a, b, z @ away, np.concatenate([-z, np.cross(z, away)]), np.concatenate([z, none]), sigma_m)
        for axis in (x, y):
            off = np.cross(R[b][:, 2], axis)
            say(a, b, R[b][:, 2] @ axis, np.concatenate([none, -off]), np.concatenate([none, off]), sigma_rad)
    return ConstraintRows(np.array(residuals), np.array(derivatives), np.array(pairs))


def strays(
    constraint: LandmarkConstraint, members: Sequence[int], R: FloatArray, p: FloatArray, joint: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Deviation of each landmark from most of the others: (n,) meters, and in standard deviations.

    Args:
        joint: (6L,6L) covariance of all landmarks; their common errors cancel in the differences.
    """
    C = joint.reshape(len(p), 6, len(p), 6)
    off, standardized = np.zeros(len(members)), np.zeros(len(members))
    for k, member in enumerate(members):
        others = [m for m in members if m != member]
        away = p[member] - p[others]
        normals = R[others][:, :, 2] if constraint.kind == "wall" else np.tile([0.0, 0.0, 1.0], (len(others), 1))
        out = (normals * away).sum(axis=1)
        turned = np.cross(normals, away) if constraint.kind == "wall" else np.zeros_like(away)
        by_other, by_member = np.hstack([-normals, turned]), np.hstack([normals, np.zeros_like(away)])
        J = np.stack([by_other, by_member], axis=1)  # (n-1,2,6)
        pairs = np.array([[other, member] for other in others])
        own = C[pairs[:, :, None], :, pairs[:, None]]  # (n-1,2,2,6,6)
        known = np.einsum("nai,nabij,nbj->n", J, own, J)
        leaning = constraint.sigma_rad * np.linalg.norm(turned, axis=1)
        spread = np.sqrt(2 * constraint.sigma_m**2 + np.maximum(known, 0.0) + leaning**2)
        off[k], standardized[k] = np.median(np.abs(out)), np.median(np.abs(out) / spread)
    return off, standardized
