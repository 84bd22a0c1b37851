"""Doubtful landmarks: codes that were read in too few frames to exclude a misreading.

The confidence of a reading is the probability that it is right.  Two independent readings of a code at one place
leave little doubt.  Readings of one frame are not independent: both cameras see the same print in the same light.
So frames are counted.  A code at the place of another landmark is a misreading of it, if the landmark is read ten
times as often, or twice as often and before and after the code: a landmark that took the place of another is read
only afterwards.  A code that is read only sometimes, in full view, comes from a print that resembles a landmark
(`reading_rate.py`).
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass

from scipy.special import bdtr

from lmkit.arrays import FloatArray
from lmkit.mapping.reading_rate import LocatedFrames, most_neighbors, neighbors_read
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import MappedLandmark
from lmkit.model.landmark_overlap import overlaps

LEAST_FRAMES = 2
RARE = 0.1  # of the frames of the landmark at the same place
# The same for a code that is read between readings of that landmark; and the required share of its frames in between.
RARE_BETWEEN, BETWEEN = 0.5, 0.5
# Least share of the frames next to readings in which a landmark is read; and the probability that a landmark with
# this share is read in so few of them by chance, below which a code is doubtful.
STEADY, BY_CHANCE = 0.5, 0.1


@dataclass(frozen=True)
class KeptOut:
    """A code that was read, but is not in the map.

    Attributes:
        reason: a clause for the message.
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
    landmarks: Iterable[MappedLandmark],
    recordings: Sequence[LocatedFrames],
    known: Collection[LandmarkId],
) -> tuple[KeptOut, ...]:
    """Landmarks to keep out of the map, with the reason.

    Args:
        recordings: of the place, in the frame of the landmarks.
        known: landmarks that are known beforehand, or define the frame; these are never doubtful.
    """
    landmarks = list(landmarks)
    times = {m.id: [recording.times_of(m.id) for recording in recordings] for m in landmarks}
    frames = {m.id: sum(map(len, times[m.id])) for m in landmarks}
    found = {
        m.id: "it was read in one frame only, and may be a misreading"
        for m in landmarks
        if m.id not in known and frames[m.id] < LEAST_FRAMES
    }
    for a, b, _ in overlaps(m for m in landmarks if m.id not in found):
        rare, often = sorted((a.id, b.id), key=lambda id_: frames[id_])
        few, many = frames[rare], frames[often]
        if rare in known:
            continue
        between = _between(times[rare], times[often])
        if few <= RARE * many or (few <= RARE_BETWEEN * many and between >= BETWEEN * few):
            found[rare] = f"it was read in {few} frames in the place of {often}, which was read in {many}"
    for m in landmarks:
        if m.id in known or m.id in found or _is_read_steadily(*most_neighbors(m.id, recordings)):
            continue
        beside, read = neighbors_read(m, recordings)
        if not _is_read_steadily(beside, read):
            found[m.id] = (
                f"of {beside} frames just before and after readings, in full view, only {read} read it: it may be a "
                "print that looks like a landmark, or be dirty or damaged"
            )
    return tuple(KeptOut(id_, reason) for id_, reason in sorted(found.items()))


def _is_read_steadily(beside: int, read: int) -> bool:
    """Whether ``read`` readings in ``beside`` frames that should have one are compatible with steady readings."""
    return bool(bdtr(read, beside, STEADY) >= BY_CHANCE)


def _between(times: Sequence[FloatArray], others: Sequence[FloatArray]) -> int:
    """Number of times between the first and last of others, in the same recording."""
    pairs = [(own, other) for own, other in zip(times, others, strict=True) if len(other)]
    return sum(int(((own > other.min()) & (own < other.max())).sum()) for own, other in pairs)
