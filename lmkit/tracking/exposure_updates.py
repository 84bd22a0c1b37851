"""A filter's updates with the exposures up to a frame, one after the other."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from lmkit.arrays import BoolArray
from lmkit.localization.correspondences import Correspondences
from lmkit.model.landmark_id import LandmarkId
from lmkit.tracking.exposure_queue import Seen

CORNER_COORDINATES = 8  # of a landmark


class ExposureUpdates:
    """Updates with the exposures that are due, and their results.

    Attributes:
        outliers: landmarks that do not fit, or appear twice in an image.
        nis, nis_dof: normalized innovation squared of the inliers, and its degrees of freedom.
        fits: for every exposure that saw a landmark of the map, whether any landmark fits.
    """

    def __init__(
        self,
        due: Sequence[tuple[float, Seen]],
        look: Callable[[float, Seen], Correspondences],
        update: Callable[[Correspondences], tuple[BoolArray, float]],
    ) -> None:
        """Update with every exposure.

        Args:
            due: times and detections of every camera.
            look: predicts to a time and returns the correspondences of that time.
            update: (S,) the inliers of an update, and its innovation.
        """
        self.outliers: set[LandmarkId] = set()
        self.nis, self.nis_dof = 0.0, 0
        self.fits: list[bool] = []
        for at, part in due:
            seen = look(at, part)
            self.outliers |= seen.twice
            if not len(seen):
                continue
            try:
                used, cost = update(seen)
            except np.linalg.LinAlgError:
                # Corners or a covariance out of range: nothing fits.
                used, cost = np.zeros(len(seen), dtype=bool), 0.0
            self.outliers |= seen.ids_of(~used)
            self.fits.append(bool(used.any()))
            if used.any():
                self.nis += cost
                self.nis_dof += CORNER_COORDINATES * int(used.sum())
