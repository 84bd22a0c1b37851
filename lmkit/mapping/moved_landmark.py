"""MovedLandmark: a landmark that was moved between recordings, or since the known map."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lmkit.geometry.rotations import rotation_log
from lmkit.mapping.bundle_adjustment import Anchor
from lmkit.model.landmark_map import CALENDAR_S, MappedLandmark, day_of

KNOWN_MAP, THIS_RECORDING = "the known map", "this recording"


@dataclass(frozen=True, eq=False)
class MovedLandmark:
    """A landmark that was moved between recordings.

    Attributes:
        before, after: its two places; with `valid_to_s` and `valid_from_s` if the recordings' clocks are comparable.
        seen_before, seen_after: names of recordings.
    """

    before: MappedLandmark
    after: MappedLandmark
    seen_before: tuple[str, ...]
    seen_after: tuple[str, ...]

    @classmethod
    def since_known(
        cls, anchor: Anchor, after: MappedLandmark, since_s: float, names: tuple[str, ...]
    ) -> MovedLandmark:
        """The move from a known landmark to its place in recordings.

        Args:
            since_s: time of the first observation at the new place.
            names: names of the recordings.
        """
        before = replace(anchor.landmark, covariance=anchor.covariance, valid_from_s=None, valid_to_s=since_s)
        return cls(before, replace(after, valid_from_s=since_s), (KNOWN_MAP,), names)

    @property
    def meters(self) -> float:
        """Distance by which its center was moved."""
        return float(np.linalg.norm(self.after.T_map_landmark.t - self.before.T_map_landmark.t))

    @property
    def radians(self) -> float:
        """Angle by which it was rotated."""
        return float(np.linalg.norm(rotation_log(self.after.T_map_landmark.R @ self.before.T_map_landmark.R.T)))

    def __str__(self) -> str:
        text = (
            f"{self.before.id} was moved by {self.meters:.2f} m and {np.rad2deg(self.radians):.0f} deg between "
            f"{_some(self.seen_before)} and {_some(self.seen_after)}"
        )
        last, first = self.before.valid_to_s, self.after.valid_from_s
        if last is None:
            text += "; their clocks overlap, so that the map has its pose in the recording given last"
        elif first is not None and last > CALENDAR_S:
            text += f" (last seen there {day_of(last)}, seen elsewhere from {day_of(first)})"
        return text

    def to_dict(self) -> dict[str, Any]:
        """JSON of a moved landmark in ``lmkit survey`` and ``lmkit fleet survey``."""
        return {
            "id": str(self.before.id),
            "metres": self.meters,
            "radians": self.radians,
            "before": list(self.seen_before),
            "after": list(self.seen_after),
            "valid_to_s": self.before.valid_to_s,
            "valid_from_s": self.after.valid_from_s,
            "sentence": str(self),
        }


def _some(names: Sequence[str]) -> str:
    """Names in a sentence; if there are many, the first and the last."""
    return ", ".join(names) if len(names) <= 4 else f"{names[0]} ... {names[-1]} ({len(names)} recordings)"
