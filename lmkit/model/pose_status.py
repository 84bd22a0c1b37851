"""The status of a pose estimate."""

from __future__ import annotations

from enum import StrEnum


class PoseStatus(StrEnum):
    """Status of a pose; members compare equal to their text in JSON."""

    OK = "ok"
    """The pose is unique, and agrees with what was observed."""
    AMBIGUOUS = "ambiguous"
    """Another pose, listed in the alternatives, explains the observations almost as well."""
    IMPRECISE = "imprecise"
    """The pose is unique, but poses half a meter or 5 deg away explain the observations almost as well."""
    NO_LANDMARKS = "no_landmarks"
    """Too few landmarks of the map were read."""
    INCONSISTENT = "inconsistent"
    """Landmarks of the map were read, but no pose explains them; tracking: most of them contradict the pose given."""
    SWAPPED = "swapped"
    """The landmarks fit with left and right image swapped; no pose is given."""
    LOST = "lost"
    """Tracking: not yet found, or known to a meter only."""
