"""Mapped landmarks that overlap, so that they cannot both be mounted at these places."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from lmkit.model.landmark_map import MappedLandmark

OVERLAP = 0.5  # of the mean size: no two whole prints on one side of a wall are so near
ALIKE = 0.5  # of two sizes: a marker that is smaller than that can be part of the other one, as on a landing pad


def overlaps(landmarks: Iterable[MappedLandmark]) -> list[tuple[MappedLandmark, MappedLandmark, float]]:
    """Pairs of landmarks that face the same way and overlap, in the order of ids, and their distance (m)."""
    pairs = []
    mapped = sorted(landmarks, key=lambda m: m.id)
    places, sizes = np.array([m.T_map_landmark.t for m in mapped]), np.array([m.size_m for m in mapped])
    for k, a in enumerate(mapped):
        later = slice(k + 1, None)
        apart = np.linalg.norm(places[later] - a.T_map_landmark.t, axis=1)
        for other in np.flatnonzero(apart < OVERLAP * (sizes[later] + a.size_m) / 2).tolist():
            b = mapped[k + 1 + other]
            same_way = a.T_map_landmark.R[:, 2] @ b.T_map_landmark.R[:, 2] > 0
            smaller, larger = sorted((a.size_m, b.size_m))
            if a.id != b.id and same_way and smaller > ALIKE * larger:
                pairs.append((a, b, float(apart[other])))
    return pairs
