"""Landmarks that too few frames support to be believed: one misreading of one frame is no landmark.

A reading's confidence says how often such readings are right, and two readings of a code in one place leave next to
no doubt that it is mounted there, if they err independently.  Those of one frame do not: both cameras look at the
same print in the same light.  So frames are counted.  A code that stands in the place of another one, which is read
ten times as often, is a misreading of that, however often.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass

from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import MappedLandmark
from lmkit.model.landmark_overlap import overlaps

LEAST_FRAMES = 2
RARE = 0.1  # of the frames of the landmark in whose place it stands


@dataclass(frozen=True)
class KeptOut:
    """A code that was read, and is kept out of the map.

    Attributes:
        reason: as a clause about it.
    """

    id: LandmarkId
    reason: str

    def __str__(self) -> str:
        return (
            f"{self.id} is kept out of the map: {self.reason}; if it is mounted there, drive past it again "
            "(`lmkit survey --keep-doubtful` keeps such landmarks)"
        )

    def to_dict(self) -> dict[str, str]:
        """JSON of ``lmkit survey``."""
        return {"id": str(self.id), "reason": self.reason}


def doubtful_landmarks(
    landmarks: Iterable[MappedLandmark], frames: Mapping[LandmarkId, int], known: Collection[LandmarkId]
) -> tuple[KeptOut, ...]:
    """Landmarks that are not to be believed.

    Args:
        frames: in how many frames an observation fits each landmark.
        known: landmarks that are known beforehand, or define the frame; those are believed.
    """
    landmarks = list(landmarks)
    found = {
        m.id: "it was read in one frame only, and may be a misreading"
        for m in landmarks
        if m.id not in known and frames.get(m.id, 0) < LEAST_FRAMES
    }
    for a, b, _ in overlaps(m for m in landmarks if m.id not in found):
        rare, often = sorted((a.id, b.id), key=lambda id_: frames.get(id_, 0))
        few, many = frames.get(rare, 0), frames.get(often, 0)
        if rare not in known and few <= RARE * many:
            found[rare] = f"it was read in {few} frames in the place of {often}, which was read in {many}"
    return tuple(KeptOut(id_, reason) for id_, reason in sorted(found.items()))
