"""Doubts about a surveyed map as a whole: landmarks that overlap, known places that are less exact than stated."""

from __future__ import annotations

from collections.abc import Collection, Iterable

from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import MappedLandmark
from lmkit.model.landmark_overlap import overlaps

DOUBTED = 3  # exact landmarks that the images contradict: fewer may have been moved


def overlap_doubts(landmarks: Iterable[MappedLandmark]) -> list[str]:
    """A sentence for each pair of landmarks that overlap."""
    return [
        f"{a.id} and {b.id} overlap, {1000 * apart:.0f} mm from center to center: one of them was misread, "
        "was mounted there before the other, or is mounted on another floor; check in the room, and delete the wrong "
        "one from the map, or survey each floor by itself"
        for a, b, apart in overlaps(landmarks)
    ]


def exactness_doubts(landmarks: Iterable[MappedLandmark], contradicted: Collection[LandmarkId]) -> list[str]:
    """A sentence if the images contradict several exact landmarks, which were then probably measured by hand."""
    exact = [m.id for m in landmarks if m.covariance is None or not m.covariance.any()]
    wrong = set(exact) & set(contradicted)
    if len(wrong) < DOUBTED:
        return []
    return [
        f"the images contradict {len(wrong)} of {len(exact)} known landmarks that are taken as exact: if they were "
        "measured by hand, state their accuracy, such as --known-sigma 50mm,3deg"
    ]
