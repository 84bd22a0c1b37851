"""Normal equations of all unknowns of a recording, including the swelling of each landmark's face.

During the adjustment, the swelling of faces is fixed.  The step that estimates it, and the stated covariances, use
these equations.  Face and pose of a landmark are one group of unknowns, so that the border keeps its blocks.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from lmkit.arrays import FloatArray, IntArray
from lmkit.kernels.face_swelling import SIZE, FaceSums
from lmkit.optim.block_chain import ChainEquations
from lmkit.optim.border_blocks import BlockPattern, BorderBlocks


@dataclass(frozen=True, eq=False)
class LandmarkEquations:
    """Equations of the landmarks' poses after elimination of all other unknowns.

    Attributes:
        information, gradient: (k,k), (k,).
    """

    information: FloatArray
    gradient: FloatArray


@dataclass(frozen=True, eq=False)
class StatedEquations:
    """The equations.

    Attributes:
        chain: shared unknowns are the ones before the landmarks, then pose and face of every landmark.
        places: indices of the shared unknowns without faces, in the order of the equations with fixed faces.
        faces: (L,2) indices of the faces' unknowns.
    """

    chain: ChainEquations
    places: IntArray
    faces: IntArray

    @classmethod
    def of(cls, held: ChainEquations, sums: FaceSums, pattern: BlockPattern, own: int) -> StatedEquations:
        """Equations of all unknowns.

        Args:
            held: equations with fixed faces and fixed common swelling, which is the last two of the first ``own``
                shared unknowns.  Fixed landmarks have no unknowns.
            sums: information of the observations on the faces.
            pattern: the blocks of ``sums``.
        """
        size = 0 if held.blocks is None else 6
        wide = replace(pattern, size=size + SIZE)
        groups = own + wide.size * np.arange(len(sums.corner))[:, None] + np.arange(wide.size)
        places, faces = np.concatenate([np.arange(own), groups[:, :size].ravel()]), groups[:, size:]
        common, cameras = np.arange(own - SIZE, own), sums.cameras.reshape(len(faces), -1, SIZE)
        moved = np.arange(own - SIZE - cameras.shape[1], own - SIZE)
        corner, gradient = np.zeros((own + groups.size,) * 2), np.zeros(own + groups.size)
        corner[places[:, None], places], gradient[places] = held.corner, held.shared_gradient
        corner[faces[:, :, None], faces[:, None]] += sums.corner
        corner[common[:, None], common] += sums.corner.sum(axis=0)
        _add(corner, faces, common, sums.corner)
        _add(corner, moved, faces, cameras)
        _add(corner, moved, common, cameras.sum(axis=0))
        if size:
            _add(corner, groups[:, :size], faces, sums.landmarks)
            _add(corner, groups[:, :size], common, sums.landmarks)
        gradient[faces] += sums.gradient
        gradient[common] += sums.gradient.sum(axis=0)
        border = held.border.copy()
        np.add.at(border[:, :, common[0] :], pattern.states, sums.border)
        values = sums.border if held.blocks is None else np.concatenate([held.blocks.values, sums.border], axis=2)
        blocks = BorderBlocks(np.ascontiguousarray(values), wide)
        chain = replace(held, border=border, corner=corner, shared_gradient=gradient, blocks=blocks)
        return cls(chain, places, faces)

    def know_faces(self, swelling: FloatArray, sigmas_px: FloatArray) -> None:
        """Add the prior of the swelling (L,2), px, of faces: 0, with standard deviations (L,)."""
        information = sigmas_px[:, None] ** -2
        self.chain.corner[self.faces, self.faces] += information
        self.chain.shared_gradient[self.faces] -= swelling * information

    def add_known(self, known: FloatArray) -> None:
        """Add information (6L,6L) on the landmarks' poses."""
        rows = self.places[len(self.places) - len(known) :]
        self.chain.corner[rows[:, None], rows] += known

    def solve(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Steps of the states, of the shared unknowns without the faces, and steps (L,2) of the faces."""
        states, shared = self.chain.solve()
        return states, shared[self.places], shared[self.faces]

    def solve_around(self, landmarks: FloatArray, own: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Steps as of `solve`, where landmarks step as is given (6L,); the first ``own`` unknowns are not theirs."""
        left = self.chain.eliminate(own)
        kept, gone = self.places[own:] - own, self.faces.ravel() - own
        H, g = left.information, left.gradient
        steps = np.zeros(len(g))
        steps[kept] = landmarks
        steps[gone] = np.linalg.solve(H[gone[:, None], gone], g[gone] - H[gone[:, None], kept] @ landmarks)
        states, shared = left.solve(steps)
        return states, shared[self.places], shared[self.faces]

    def covariances(self) -> tuple[FloatArray, FloatArray]:
        """(N,6,6) of every state, and that of the shared unknowns without the faces."""
        states, _, shared = self.chain.covariances()
        return states, shared[self.places[:, None], self.places]

    def eliminate(self, own: int) -> LandmarkEquations:
        """Equations of the landmarks' poses; see `ChainEquations.eliminate`."""
        left = self.chain.eliminate(own)
        kept, gone = self.places[own:] - own, self.faces.ravel() - own
        H, g = left.information, left.gradient
        if not len(gone):
            return LandmarkEquations(H, g)
        across = H[gone[:, None], kept]
        solved = cho_solve(cho_factor(H[gone[:, None], gone]), np.column_stack([across, g[gone]]))
        return LandmarkEquations(
            H[kept[:, None], kept] - across.T @ solved[:, :-1], g[kept] - across.T @ solved[:, -1]
        )


def _add(corner: FloatArray, rows: IntArray, columns: IntArray, values: FloatArray) -> None:
    """Add blocks (..., r, c) to a symmetric matrix, on both sides of the diagonal; indices (..., r) and (..., c)."""
    rows, columns = np.broadcast_to(rows, values.shape[:-1])[..., None], columns[..., None, :]
    np.add.at(corner, (rows, columns), values)
    np.add.at(corner, (columns, rows), values)
