"""Queue of images of cameras that do not expose at the time of their frame, for filters.

A camera that exposes 40 ms after another one sees from another pose of the robot.  If it is moved to the time of the
frame without noise, it contradicts the other camera by the odometry error of 40 ms.  So the filters step to every
exposure with odometry's noise, as they step from frame to frame.
"""

from __future__ import annotations

from collections.abc import Sequence

from lmkit.mapping.carried_cameras import TOGETHER_S
from lmkit.model.observation import Detection

Seen = Sequence[Sequence[Detection]]


class ExposureQueue:
    """Detections of all cameras, in the order in which they exposed."""

    def __init__(self) -> None:
        self._waiting: list[tuple[float, Seen]] = []

    def due(self, time_s: float, detections: Seen, then_s: Sequence[float] = ()) -> list[tuple[float, Seen]]:
        """Exposures up to ``time_s``, with the detections of the cameras that exposed then; later ones wait.

        Args:
            then_s: when each camera exposed; empty: all at ``time_s``.
        """
        times = then_s or [time_s] * len(detections)
        parts: dict[float, list[Sequence[Detection]]] = {}
        for k, (then, seen) in enumerate(zip(times, detections, strict=True)):
            if seen:
                at = time_s if abs(then - time_s) < TOGETHER_S else then
                parts.setdefault(at, [()] * len(detections))[k] = seen
        self._waiting = sorted([*self._waiting, *parts.items()], key=lambda part: part[0])
        due = [part for part in self._waiting if part[0] <= time_s]
        self._waiting = self._waiting[len(due) :]
        return due

    def clear(self) -> None:
        """Drop waiting exposures: the filter restarts."""
        self._waiting = []
