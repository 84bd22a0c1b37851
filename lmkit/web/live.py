"""Live states to browsers: one message contains the pose and its image, so that both belong together."""

from __future__ import annotations

import asyncio
import base64
import json
import struct
from collections.abc import Mapping
from functools import lru_cache
from typing import Any

from lmkit.live.annotated_image import annotated_jpeg
from lmkit.live.state import LiveState

WATCHERS = 8  # browsers at once
IMAGE = b"\x1f"  # between the JSON and the image of a line


def pack_message(state: Mapping[str, Any], jpeg: bytes = b"") -> bytes:
    """One WebSocket message: length of the JSON (4 bytes, little endian), the JSON, the JPEG.

    Examples:
        >>> pack_message({"status": "ok"}, b"jpeg")[:4]
        b'\\x10\\x00\\x00\\x00'
    """
    text = json.dumps(state, allow_nan=False, separators=(",", ":")).encode()
    return struct.pack("<I", len(text)) + text + jpeg


def pack_line(state: Mapping[str, Any], jpeg: bytes = b"") -> bytes:
    """One line of a run's standard output: the JSON and, behind a separator, the JPEG in base64."""
    text = json.dumps(state, allow_nan=False, separators=(",", ":")).encode()
    return text + (IMAGE + base64.b64encode(jpeg) if jpeg else b"") + b"\n"


def shown_state(state: LiveState) -> dict[str, Any]:
    """The step as the page shows it: the data of every output, the innovation band, and the run's condition."""
    return state.to_dict() | {
        "nis_dof": state.nis_dof,
        "band": innovation_band(state.nis_dof) if state.nis_dof else None,
        "sources": [health.to_dict() for health in state.sources],
        "outputs": [health.to_dict() for health in state.outputs],
    }


@lru_cache(maxsize=256)
def innovation_band(dof: int) -> tuple[float, float]:
    """95 % band of the normalized innovation squared, divided by its degrees of freedom."""
    from scipy.special import chdtri

    return float(chdtri(dof, 0.975) / dof), float(chdtri(dof, 0.025) / dof)


class LiveHub:
    """Sends the newest state to every watcher; slow watchers miss states, so memory stays bounded.

    `publish` may be called from any thread.  ``watched`` shows a producer whether images are needed.

    Attributes:
        landmarks: map of the run, as the page draws it; None: the project's.
        walls: walls of its floor plan.
        run: number of the run; a new one has another map.
    """

    def __init__(self) -> None:
        self._queues: dict[asyncio.Queue[bytes], asyncio.AbstractEventLoop] = {}
        self._last: bytes | None = None
        self.landmarks: list[dict[str, Any]] | None = None
        self.walls: list[dict[str, Any]] = []
        self.run = 0

    def __call__(self, state: LiveState) -> None:
        """Publish a step of the live loop; its images only while there are watchers."""
        self.publish(shown_state(state), annotated_jpeg(state) if self.watched else b"")

    @property
    def watched(self) -> bool:
        """Whether there are watchers."""
        return bool(self._queues)

    def publish(self, state: Mapping[str, Any], jpeg: bytes = b"") -> None:
        """Send a state and its image to every watcher."""
        self._last = message = pack_message({**state, "run": self.run}, jpeg)
        for queue, loop in list(self._queues.items()):
            loop.call_soon_threadsafe(_put_newest, queue, message)

    def publish_line(self, line: bytes) -> None:
        """Publish a step from a line of a run's output, or set the map from a line; other lines are ignored."""
        text, _, image = line.partition(IMAGE)
        try:
            state = json.loads(text)
            jpeg = base64.b64decode(image, validate=False)
        except ValueError:
            return
        if not isinstance(state, dict):
            return
        if "landmarks" in state:
            self.landmarks, self.walls, self.run = state["landmarks"], state.get("walls", []), self.run + 1
        elif "status" in state:
            self.publish(state, jpeg)

    def watch(self) -> asyncio.Queue[bytes] | None:
        """A queue with the newest message only; None if there are too many watchers."""
        if len(self._queues) >= WATCHERS:
            return None
        queue: asyncio.Queue[bytes] = asyncio.Queue(1)
        self._queues[queue] = asyncio.get_running_loop()
        if self._last is not None:
            queue.put_nowait(self._last)
        return queue

    def leave(self, queue: asyncio.Queue[bytes]) -> None:
        """End a watch."""
        self._queues.pop(queue, None)


def _put_newest(queue: asyncio.Queue[bytes], message: bytes) -> None:
    if queue.full():
        queue.get_nowait()
    queue.put_nowait(message)
