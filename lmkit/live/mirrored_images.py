"""Mirrored images of a live camera: tested while no pose agrees with the detections."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

from lmkit.geometry.rig import AnyRig, mounted_cameras
from lmkit.live.events import Event
from lmkit.localization.mirror import FRAMES, LEAST, find_mirror
from lmkit.model.landmark_map import LandmarkMap
from lmkit.model.observation import Detection
from lmkit.model.pose_status import PoseStatus
from lmkit.model.recording import RigFrame

ENOUGH = 3  # frames without a pose that show landmarks
AGAIN_S = 1.0  # between two tests, which take some milliseconds per frame

NAMED_S = 10.0  # time after which a camera is reported again


class MirroredImages:
    """Keeps the last frames without a pose of every camera, and tests whether they are mirrored.

    Attributes:
        sentence: about the mirrored camera, until a pose is published again; else empty.
    """

    def __init__(self, rig: AnyRig, landmarks: LandmarkMap) -> None:
        self._rig, self._map = rig, landmarks
        self._names = [camera.name for camera in mounted_cameras(rig)]
        self._frames: list[deque[RigFrame]] = [deque(maxlen=FRAMES) for _ in self._names]
        self._asked_s = float("-inf")
        self._named_s: dict[str, float] = {}
        self.sentence = ""

    def add(self, time_s: float, seen: Sequence[Sequence[Detection]], status: PoseStatus) -> tuple[Event, ...]:
        """Add the detections and the status of a step; an event for each camera newly found mirrored."""
        if status == PoseStatus.OK:
            for frames in self._frames:
                frames.clear()
            self.sentence = ""
            return ()
        for k, found in enumerate(seen):
            if len({d.id for d in found}) >= LEAST:
                alone = tuple(tuple(found) if j == k else () for j in range(len(seen)))
                self._frames[k].append(RigFrame(time_s, alone))
        if time_s - self._asked_s < AGAIN_S or max(map(len, self._frames)) < ENOUGH:
            return ()
        self._asked_s = time_s
        return self._ask(time_s)

    def _ask(self, time_s: float) -> tuple[Event, ...]:
        stated = {}
        for name, frames in zip(self._names, self._frames, strict=True):
            cause = find_mirror(list(frames), self._rig, self._map) if len(frames) >= ENOUGH else None
            if cause is not None:
                stated[name] = f"camera {name}: {cause.text}"
        # Frames with fewer landmarks than before do not revoke the result.
        self.sentence = self.sentence or next(iter(stated.values()), "")
        new = {name: text for name, text in stated.items() if time_s - self._named_s.get(name, -NAMED_S) >= NAMED_S}
        self._named_s |= dict.fromkeys(new, time_s)
        return tuple(Event("images_mirrored", text, time_s) for text in new.values())
