"""Cameras without detections although landmarks should be clearly visible: a covered lens, darkness."""

from __future__ import annotations

from collections.abc import Sequence

from lmkit.live.events import Event
from lmkit.live.state import CameraView
from lmkit.model.landmark_id import LandmarkId

NAMED_AFTER_S = 2.0  # duration of images that should clearly show a landmark, before an event
LONGEST_GAP_S = 1.0  # between two such images


class BlindCameras:
    """Reports cameras without detections, and cameras that detect again."""

    def __init__(self, names: Sequence[str]) -> None:
        self._names = names
        self._blind_s = [0.0] * len(names)
        self._last_s = [float("-inf")] * len(names)
        self._named: set[int] = set()

    def add(
        self, time_s: float, views: Sequence[CameraView], plain: Sequence[Sequence[LandmarkId]]
    ) -> tuple[Event, ...]:
        """Events of a step.

        Args:
            plain: per camera, landmarks that should be clearly visible with a pose confirmed by another camera.
        """
        events = []
        for k, (view, expected) in enumerate(zip(views, plain, strict=True)):
            if view.detections:
                self._blind_s[k] = 0.0
                self._last_s[k] = float("-inf")
                if k in self._named:
                    self._named.remove(k)
                    events.append(Event("camera_sees", f"camera {self._names[k]} reads landmarks again", time_s))
                continue
            if not expected or view.search == "none":
                continue
            gap = time_s - self._last_s[k]
            self._blind_s[k] += gap if 0 < gap <= LONGEST_GAP_S else 0.0
            self._last_s[k] = time_s
            if self._blind_s[k] >= NAMED_AFTER_S and k not in self._named:
                self._named.add(k)
                message = (
                    f"camera {self._names[k]} reads nothing, and {expected[0]} should be plainly in view: "
                    "is its lens covered, or its image dark?"
                )
                events.append(Event("camera_blind", message, time_s))
        return tuple(events)
