"""Errors that consecutive images share, and the covariance that a filter must add for them.

A filter treats images as independent, so its covariance shrinks as if errors averaged out.  Three kinds do not:

- the error of a landmark's place in the map is the same in all images;
- errors of lens and calibration are nearly the same while a landmark is in the same place of the image;
- errors of the detector are nearly the same in the same view: images of a robot that stands still are correlated.

The filter's weights are unchanged.  The true covariance of its estimate is computed in addition, with these
errors as parameters that are considered and not estimated (Schmidt 1966, "Application of state-space methods to
navigation problems", Advances in Control Systems 3).  Let e be the error of the estimate and b a lasting error in its
standard deviations.  An update from information B to N takes

    e+ = N^-1 B e + N^-1 H'W K b + noise,

where H and K are the derivatives of the observations with the state and with b, and W are the weights.  In one image
K b is part of the error that W models, so N^-1 is the covariance of e+ as long as e and b are uncorrelated.  They are
correlated from the second image on.  With X = cov(e, b), A = N^-1 B, D = N^-1 H'W K, and r the correlation of b with
its value in the last image (a first-order Gauss-Markov process, Gelb 1974, "Applied Optimal Estimation", 3.8)

    X+ = r A X + D        and        E+ = A E A' + r (A X D' + D X' A')

is what must be added to the filter's covariance.
"""

from __future__ import annotations

import numpy as np

from lmkit.arrays import BoolArray, FloatArray
from lmkit.kernels.lasting_errors import Image, Shared, lasting_errors
from lmkit.kernels.pose_update import Updated
from lmkit.localization.correspondences import Correspondences
from lmkit.model.landmark_id import LandmarkId

# Motion of the corners in the image over which errors decorrelate.  The detector's correlate by 0.8 to 1 in the same
# view, by 0.5 within 1 px and by 0.1 beyond 3 px (simulated cameras of five kinds); those of the lens by 0.8 up to
# 30 px, 0.7 up to 100 px and 0.6 up to 300 px (recording of TagSLAM).
DETECTOR_PX, LENS_PX = 1.5, 400.0
PER_PX = (-1 / DETECTOR_PX, -1 / LENS_PX)


class LastingErrors:
    """Covariance of the errors that images share."""

    def __init__(self, states: int) -> None:
        self._states = states
        self._forget()

    def _forget(self) -> None:
        N = self._states
        self._shared = Shared(np.zeros((N, N)), np.zeros((0, N, 6)), np.zeros((0, 4, 2)), np.zeros((0, N, 16)))
        self._moved: FloatArray | None = None  # (N,N) derivatives of the states with those of the last image
        self._numbers: dict[LandmarkId, int] = {}
        self._rows: dict[tuple[LandmarkId, int], int] = {}  # of the last image with observations

    @property
    def excess(self) -> FloatArray:
        """(N,N) to be added to the covariance of the filter's N states."""
        E, F = self._shared.excess, self._moved
        return E if F is None else F @ E @ F.T

    def start(
        self, seen: Correspondences, R: FloatArray, p: FloatArray, used: BoolArray, by_pull: FloatArray
    ) -> None:
        """Reset: the filter starts with one image, at the pose R (3,3), p (3,).

        Args:
            used: (S,) the observations that fit.
            by_pull: (N,6) derivatives of the states with gradients on the pose.
        """
        self._forget()
        self._add(seen, R, p, used, np.zeros((self._states, self._states)), by_pull)

    def predict(self, F: FloatArray) -> None:
        """Predict: (N,N) derivatives of the state with the previous state."""
        self._moved = F if self._moved is None else F @ self._moved

    def update(self, seen: Correspondences, done: Updated) -> None:
        """Account for a filter update with an image."""
        left = done.left if self._moved is None else done.left @ self._moved
        self._add(seen, done.R, done.p, done.used, left, done.by_pull)

    def _add(
        self,
        seen: Correspondences,
        R: FloatArray,
        p: FloatArray,
        used: BoolArray,
        left: FloatArray,
        by_pull: FloatArray,
    ) -> None:
        views, counts, known = seen.views, used.tolist(), self._numbers
        numbers = [
            known.setdefault(landmark.id, len(known)) if counted and landmark.covariance is not None else -1
            for landmark, counted in zip(seen.landmarks, counts, strict=True)
        ]
        rows = np.array([self._rows.get(view, -1) for view in views])
        image = Image(np.array(numbers), rows, seen.observed, seen.lens_shares, len(known))
        self._shared = lasting_errors(seen.corners, R, p, used, left, by_pull, image, PER_PX, self._shared)
        self._rows = {view: k for k, (view, counted) in enumerate(zip(views, counts, strict=True)) if counted}
        self._moved = None
