"""Errors that images share: what a filter's covariance lacks.

A filter takes every image for news, so its covariance shrinks as if errors averaged out.  Three kinds do not:

- the error of a landmark's place in the map is the same in all images;
- lenses and their calibration err alike wherever a landmark is nearly in the same place of the image;
- the detector errs alike in the same view: of a robot that stands, one image says nearly what the next one says.

The filter goes on weighing images as it does, and the true covariance of its estimate is kept beside it, with these
errors as parameters that are considered and not estimated (Schmidt 1966, "Application of state-space methods to
navigation problems", Advances in Control Systems 3).  Let e be the error of the estimate and b a lasting error in its
standard deviations.  An update from information B to N takes

    e+ = N^-1 B e + N^-1 H'W K b + noise,

with H and K the derivatives of what is seen with the state and with b, W its weights.  In one image K b is part of
what W allows for, so N^-1 is the covariance of e+ as long as e and b have nothing in common.  They have, from the
second image on: with X = cov(e, b), A = N^-1 B, D = N^-1 H'W K, and r the correlation of b with itself in the last
image (a first-order Gauss-Markov process, Gelb 1974, "Applied Optimal Estimation", 3.8)

    X+ = r A X + D        and        E+ = A E A' + r (A X D' + D X' A')

is what must be added to the filter's covariance.
"""

from __future__ import annotations

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.localization.correspondences import ErrorPulls
from lmkit.model.landmark_id import LandmarkId

# Way of the corners in the image over which errors become others.  The detector's correlate by 0.8 to 1 in the same
# view, by 0.5 within 1 px and by 0.1 beyond 3 px (simulated cameras of five kinds); those of the lens by 0.8 up to
# 30 px, 0.7 up to 100 px and 0.6 up to 300 px (recording of TagSLAM).
DETECTOR_PX, LENS_PX = 1.5, 400.0
PER_PX = -1 / np.array([DETECTOR_PX, LENS_PX])
SIX = 6  # errors of a landmark's place


class LastingErrors:
    """Account of the errors that images share.

    Attributes:
        excess: (N,N) to be added to the covariance of the filter's N states.
    """

    def __init__(self, states: int) -> None:
        self._states = states
        self._forget()

    def _forget(self) -> None:
        self.excess: FloatArray = np.zeros((self._states, self._states))
        self._numbers: dict[LandmarkId, int] = {}
        self._places: FloatArray = np.zeros((self._states, 0))  # X of places, side by side
        self._rows: dict[tuple[LandmarkId, int], int] = {}  # of the last image that showed something
        self._seen_at: FloatArray = np.zeros((0, 4, 2))
        self._corners: FloatArray = np.zeros((0, self._states, 16))  # X of the detector's and the lens's errors

    def start(self, pulls: ErrorPulls) -> None:
        """Forget all: the filter begins with one image.

        Args:
            pulls: of that image, on the state: D.
        """
        self._forget()
        self.update(np.zeros_like(self.excess), pulls)

    def predict(self, F: FloatArray) -> None:
        """The state moves on: (N,N) its derivatives with the state before."""
        self.excess = F @ self.excess @ F.T
        self._places, self._corners = F @ self._places, F @ self._corners

    def update(self, A: FloatArray, pulls: ErrorPulls) -> None:
        """An image came.

        Args:
            A: (N,N) share of the error before that is left.
            pulls: of that image, on the state: D.
        """
        self.excess = A @ self.excess @ A.T
        self._update_places(A, pulls)
        self._update_corners(A, pulls)

    def _update_places(self, A: FloatArray, pulls: ErrorPulls) -> None:
        self._places = A @ self._places
        if not pulls.ids:
            return
        numbers = [self._numbers.setdefault(id_, len(self._numbers)) for id_ in pulls.ids]
        missing = SIX * len(self._numbers) - self._places.shape[1]
        if missing:
            self._places = np.hstack([self._places, np.zeros((self._states, missing))])
        columns = (SIX * np.array(numbers)[:, None] + np.arange(SIX)).ravel()
        X, D = self._places[:, columns], _side_by_side(pulls.places)
        self._count(X, D)
        self._places[:, columns] = X + D

    def _update_corners(self, A: FloatArray, pulls: ErrorPulls) -> None:
        lens = np.sqrt(pulls.lens_shares)[:, None, None]
        new = np.concatenate([np.sqrt(1 - lens**2) * pulls.own, lens * pulls.own], axis=2)
        again = [k for k, view in enumerate(pulls.views) if view in self._rows]
        if again:
            before = [self._rows[pulls.views[k]] for k in again]
            steps = pulls.corners[again] - self._seen_at[before]
            way = np.sqrt((steps * steps).sum(axis=(1, 2)) / 4)
            alike = np.exp(way[:, None] * PER_PX).repeat(8, axis=1)
            X = alike[:, None] * (A @ self._corners[before])
            self._count(_side_by_side(X), _side_by_side(new[again]))
            new[again] += X
        self._rows = {view: k for k, view in enumerate(pulls.views)}
        self._seen_at, self._corners = pulls.corners, new

    def _count(self, X: FloatArray, D: FloatArray) -> None:
        """Add what errors have in common with the state before, ``X`` (N,K), and move it by, ``D`` (N,K)."""
        shared = X @ D.T
        self.excess = self.excess + shared + shared.T


def _side_by_side(blocks: FloatArray) -> FloatArray:
    """(N, C K) of (C,N,K)."""
    return blocks.transpose(1, 0, 2).reshape(blocks.shape[1], -1)
