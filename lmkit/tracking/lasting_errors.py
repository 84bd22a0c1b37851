"""Errors that all images of a landmark share, such as that of its place in the map: what a filter's covariance lacks.

A filter takes every image for news, so its covariance shrinks as if errors averaged out.  That of a landmark's place
stays the same in all of them.  The filter goes on weighing images as it does, and the true covariance of its estimate
is kept beside it, with the lasting errors as parameters that are considered and not estimated (Schmidt 1966,
"Application of state-space methods to navigation problems", Advances in Control Systems 3).

Let e be the error of the estimate and b a lasting error in its standard deviations.  An update from information B to
N takes

    e+ = N^-1 B e + N^-1 H'W K b + noise,

with H and K the derivatives of what is seen with the state and with b, W its weights.  In one image K b is part of
what W allows for, so N^-1 is the covariance of e+ as long as e and b have nothing in common.  They have, from the
second image on: with X = cov(e, b), A = N^-1 B and D = N^-1 H'W K

    X+ = A X + D        and        E+ = A E A' + A X D' + D X' A'

is what must be added to the filter's covariance.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.model.landmark_id import LandmarkId

Pulls = Mapping[LandmarkId, FloatArray]


class LastingErrors:
    """Account of the errors that images share.

    Attributes:
        excess: (N,N) to be added to the covariance of the filter's N states.
    """

    def __init__(self, states: int) -> None:
        self.excess: FloatArray = np.zeros((states, states))
        self._shared: Pulls = {}

    def start(self, pulls: Pulls) -> None:
        """Forget all: the filter begins with one image.

        Args:
            pulls: D of that image: (N,6) by landmark.
        """
        self.excess = np.zeros_like(self.excess)
        self._shared = dict(pulls)

    def predict(self, F: FloatArray) -> None:
        """The state moves on: (N,N) its derivatives with the state before."""
        self.excess = F @ self.excess @ F.T
        self._shared = {id_: F @ X for id_, X in self._shared.items()}

    def update(self, A: FloatArray, pulls: Pulls) -> None:
        """An image came.

        Args:
            A: (N,N) share of the error before that is left.
            pulls: D: (N,6) by landmark, by how much its error moves the state.
        """
        excess = A @ self.excess @ A.T
        shared: dict[LandmarkId, FloatArray] = {id_: A @ X for id_, X in self._shared.items()}
        for id_, D in pulls.items():
            X = shared.get(id_)
            if X is not None:
                excess += X @ D.T + D @ X.T
            shared[id_] = D if X is None else X + D
        self.excess, self._shared = excess, shared
