"""Exposure times of a rig's cameras, and the motion of the rig until each exposure."""

from __future__ import annotations

from collections.abc import Sequence

from lmkit.geometry.pose import Pose
from lmkit.geometry.rig import AnyRig, mounted_cameras
from lmkit.live.estimators import Estimator
from lmkit.mapping.carried_cameras import TOGETHER_S as EXACT_S

TOGETHER_S = 0.02  # arrival stamps with smaller differences are of one exposure: transport delays vary by this much
MOST_APART_S = 0.1  # images with a larger difference are of another frame


class Exposures:
    """Times of exposure from the images' stamps and the offsets of the rig file."""

    def __init__(self, rig: AnyRig) -> None:
        self._offsets = [camera.time_offset_s for camera in mounted_cameras(rig)]

    def times(self, time_s: float, stamps_s: Sequence[float]) -> tuple[float, ...]:
        """Exposure time of each camera; empty if all are ``time_s``."""
        late = [
            (0.0 if abs(stamp - time_s) < TOGETHER_S else stamp - time_s) + offset
            for stamp, offset in zip(stamps_s, self._offsets, strict=True)
        ]
        return tuple(time_s + seconds for seconds in late) if max(map(abs, late), default=0.0) >= EXACT_S else ()

    def carried(
        self, time_s: float, then_s: Sequence[float], estimator: Estimator
    ) -> tuple[tuple[Pose, ...], frozenset[int]]:
        """Motion of the rig until the exposure of each camera, T_left_left; empty if all expose at ``time_s``.

        Second value: cameras that must be ignored, since the motion of the rig is unknown.
        """
        apart = frozenset(k for k, then in enumerate(then_s) if abs(then - time_s) >= EXACT_S)
        moved = estimator.carried(time_s, then_s) if apart else ()
        return ((), apart) if moved is None else (moved, frozenset())
