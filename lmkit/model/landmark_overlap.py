"""Mapped landmarks that overlap, and cannot both be mounted where the map has them."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import combinations

import numpy as np

from lmkit.model.landmark_map import MappedLandmark

OVERLAP = 0.5  # of the mean size: no two whole prints on one side of a wall are so near
ALIKE = 0.5  # of two sizes: a marker that is smaller than that can be part of the other one, as on a landing pad


def overlaps(landmarks: Iterable[MappedLandmark]) -> list[tuple[MappedLandmark, MappedLandmark, float]]:
    """Pairs of landmarks that face the same way and overlap, in the order of ids, and how far apart (m)."""
    pairs = []
    for a, b in combinations(sorted(landmarks, key=lambda m: m.id), 2):
        apart = float(np.linalg.norm(a.T_map_landmark.t - b.T_map_landmark.t))
        same_way = a.T_map_landmark.R[:, 2] @ b.T_map_landmark.R[:, 2] > 0
        smaller, larger = sorted((a.size_m, b.size_m))
        near = apart < OVERLAP * (a.size_m + b.size_m) / 2
        if a.id != b.id and same_way and near and smaller > ALIKE * larger:
            pairs.append((a, b, apart))
    return pairs
