"""Joint adjustment of several recordings of one place, without building one large problem.

Every recording eliminates its own poses and its odometry's errors; information on landmarks remains;
the sum over recordings is solved for the landmarks, and every recording is back-substituted.  This is the Levenberg-
Marquardt step of the one large problem, not an approximation.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from lmkit.arrays import FloatArray, IntArray
from lmkit.geometry.rotations import rotation_exp
from lmkit.mapping.stated_equations import LandmarkEquations, StatedEquations
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_information import LandmarkInformation
from lmkit.optim.block_chain import ChainEquations, EliminatedChain
from lmkit.optim.information_sum import InformationSum
from lmkit.optim.levenberg_marquardt import Damping, minimize

CONVERGED = 1e-2  # of the cost
DAMPING = Damping(grow=50.0)
MOST_KEPT = 128_000_000  # bytes of all recordings' equations


class RecordingProblem(Protocol):
    """One recording: a chain of poses, and shared unknowns; all but the first ``own`` of these are its landmarks.

    Attributes:
        own: of the shared unknowns, before the landmarks.
        size: unknowns of one landmark: 6 in space, 2 in the plane.
        landmark_ids: (L) in the order of its unknowns.
    """

    own: int

    @property
    def size(self) -> int: ...
    @property
    def landmark_ids(self) -> tuple[LandmarkId, ...]: ...

    def own_state(self) -> Any:
        """Snapshot of all unknowns except the landmarks."""

    def restore_own(self, state: Any) -> None:
        """Restore such a snapshot."""

    def own_moved(self, states: FloatArray, own: FloatArray) -> Any:
        """The snapshot after a step of the poses and of its own shared unknowns."""

    def landmark_poses(self) -> tuple[FloatArray, FloatArray]:
        """(L,3,3), (L,3) of its landmarks."""

    def put_landmarks(self, R: FloatArray, p: FloatArray) -> None:
        """Set the poses of its landmarks."""

    def equations(self) -> tuple[ChainEquations, float]:
        """Normal equations and cost at the current state."""


def recording_information(
    problem: RecordingProblem, equations: tuple[ChainEquations | StatedEquations, float] | None = None
) -> LandmarkInformation:
    """Information of a recording on its landmarks, at its current state.

    Args:
        equations: its normal equations and cost; None: computed here.
    """
    chain, cost = problem.equations() if equations is None else equations
    left = chain.eliminate(problem.own)
    R, p = problem.landmark_poses()
    return LandmarkInformation(problem.landmark_ids, R.copy(), p.copy(), left.information, left.gradient, cost)


@dataclass(frozen=True, eq=False)
class JointEquations:
    """Normal equations of all recordings at a state.

    Attributes:
        state: where they are linearized.
        kept: of each recording; empty: computed again when needed, one recording at a time.
    """

    state: JointState
    kept: tuple[ChainEquations, ...]


@dataclass(frozen=True, eq=False)
class JointState:
    """Landmarks (C,3,3), (C,3), and the own unknowns of each recording."""

    R: FloatArray
    p: FloatArray
    recordings: tuple[Any, ...]


class JointProblem:
    """Several recordings, and the landmarks that they share.

    Equations of few recordings are kept for a step; with many, they are computed for one recording at a time, three
    times a step, so that memory does not grow with their number.  The steps are identical.

    Args:
        problems: the recordings.
        rows: (L,) of each: which of the joint landmarks its landmarks are.
        R, p: (C,3,3), (C,3) poses of these cameras.
    """

    def __init__(
        self, problems: Sequence[RecordingProblem], rows: Sequence[IntArray], R: FloatArray, p: FloatArray
    ) -> None:
        self.problems, self.rows = list(problems), list(rows)
        self.R, self.p, self.size = R, p, problems[0].size
        self._put()

    def optimize(self, steps: int, least_gain: float = CONVERGED) -> float:
        """Levenberg-Marquardt from the current unknowns; the final cost.

        Args:
            steps: largest number of steps.
            least_gain: of the cost; a step that lowers it by less is the last one.
        """
        end = minimize(self, self.state(), steps, least_gain, DAMPING)
        self.restore(end.state)
        return end.cost

    def state(self) -> JointState:
        """Snapshot of the unknowns."""
        return JointState(self.R, self.p, tuple(problem.own_state() for problem in self.problems))

    def restore(self, state: JointState) -> None:
        """Restore a snapshot."""
        self.R, self.p = state.R, state.p
        for problem, own in zip(self.problems, state.recordings, strict=True):
            problem.restore_own(own)
        self._put()

    def linearize(self, state: JointState) -> tuple[JointEquations, float]:
        """Normal equations of all recordings, and the cost of all, at a state."""
        self.restore(state)
        kept: list[ChainEquations] = []
        cost, held = 0.0, 0
        for problem in self.problems:
            equations, own_cost = problem.equations()
            cost += own_cost
            held += equations.nbytes
            if held <= MOST_KEPT:
                kept.append(equations)
            else:
                kept.clear()
        return JointEquations(state, tuple(kept) if held <= MOST_KEPT else ()), cost

    def solve(
        self, equations: JointEquations, damping: float
    ) -> tuple[FloatArray, list[tuple[FloatArray, FloatArray]]]:
        """Steps of the landmarks (dC,), and of each recording's states and shared unknowns."""
        self.restore(equations.state)
        left = self._eliminated(equations.kept, damping)
        parts = list(left) if equations.kept else None
        step = self.sum_of(left if parts is None else parts).solve()
        again = self._eliminated((), damping) if parts is None else iter(parts)
        return step, [part.solve(step[mine]) for part, mine in zip(again, self._columns(), strict=True)]

    def retract(self, state: JointState, step: tuple[FloatArray, list[tuple[FloatArray, FloatArray]]]) -> JointState:
        """The state moved by a step."""
        self.restore(state)
        moved = step[0].reshape(-1, self.size)
        R, p = state.R, state.p.copy()
        p[:, : min(self.size, 3)] += moved[:, :3]
        if self.size == 6:
            R = rotation_exp(moved[:, 3:]) @ R
        own = [
            problem.own_moved(states, shared[: problem.own])
            for problem, (states, shared) in zip(self.problems, step[1], strict=True)
        ]
        return JointState(R, p, tuple(own))

    def information(self) -> list[LandmarkInformation]:
        """Information of each recording, at the current landmarks."""
        return [recording_information(problem) for problem in self.problems]

    def sum_of_information(self, parts: Sequence[LandmarkInformation]) -> tuple[FloatArray, FloatArray]:
        """(dC,dC), (dC,) dense sums of the information of all recordings."""
        count = self.size * len(self.p)
        H, b = np.zeros((count, count)), np.zeros(count)
        for columns, part in zip(self._columns(), parts, strict=True):
            H[columns[:, None], columns] += part.H
            b[columns] += part.b
        return H, b

    def covariance(self) -> FloatArray:
        """(dC,dC) joint covariance of all landmarks.

        Raises:
            numpy.linalg.LinAlgError: an unknown is not determined.
        """
        return self.sum_of(self._eliminated()).covariance()

    def sum_of(self, parts: Iterable[EliminatedChain | LandmarkEquations]) -> InformationSum:
        """The recordings' information, summed."""
        total = InformationSum(len(self.p), self.size)
        for rows, part in zip(self.rows, parts, strict=True):
            total.add(rows, part.information, part.gradient)
        return total

    def _eliminated(self, kept: Sequence[ChainEquations] = (), damping: float = 0.0) -> Iterator[EliminatedChain]:
        """Each recording's equations with its own unknowns eliminated, one after the other."""
        for number, problem in enumerate(self.problems):
            equations = kept[number] if kept else problem.equations()[0]
            yield equations.eliminate(problem.own, damping)

    def _columns(self) -> list[IntArray]:
        return [(self.size * rows[:, None] + np.arange(self.size)).ravel() for rows in self.rows]

    def _put(self) -> None:
        for problem, rows in zip(self.problems, self.rows, strict=True):
            problem.put_landmarks(self.R[rows], self.p[rows])
