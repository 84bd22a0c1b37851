"""Doubts about a surveyed map as a whole: landmarks that overlap, known places that are less exact than stated."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from itertools import combinations

import numpy as np

from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import MappedLandmark

OVERLAP = 0.5  # of the mean size: no two whole prints on one side of a wall are so near
DOUBTED = 3  # exact landmarks that the images contradict: fewer may have been moved


def overlap_doubts(landmarks: Iterable[MappedLandmark]) -> list[str]:
    """A sentence for each pair of landmarks that face the same way and cannot both be where the map has them."""
    texts = []
    for a, b in combinations(sorted(landmarks, key=lambda m: m.id), 2):
        apart = float(np.linalg.norm(a.T_map_landmark.t - b.T_map_landmark.t))
        alike = a.T_map_landmark.R[:, 2] @ b.T_map_landmark.R[:, 2] > 0
        if a.id != b.id and alike and apart < OVERLAP * (a.size_m + b.size_m) / 2:
            texts.append(
                f"{a.id} and {b.id} overlap, {1000 * apart:.0f} mm from center to center: one of them was misread, "
                "or was mounted there before the other; check in the room, and delete the wrong one from the map"
            )
    return texts


def exactness_doubts(landmarks: Iterable[MappedLandmark], contradicted: Collection[LandmarkId]) -> list[str]:
    """A sentence where the images contradict several landmarks that count as exact: measured badly, rather."""
    exact = [m.id for m in landmarks if m.covariance is None or not m.covariance.any()]
    wrong = set(exact) & set(contradicted)
    if len(wrong) < DOUBTED:
        return []
    return [
        f"the images contradict {len(wrong)} of {len(exact)} known landmarks that count as exact: if they were "
        "measured by hand, say how well, such as --known-sigma 50mm,3deg"
    ]
