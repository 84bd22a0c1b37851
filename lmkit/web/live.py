"""Live states to browsers: one message holds the pose and its image, so that they cannot part."""

from __future__ import annotations

import asyncio
import json
import struct
from collections.abc import Mapping
from typing import Any

import numpy as np

from lmkit.live.state import LiveState

WATCHERS = 8  # browsers at once
SHOWN_PX = 480  # width of each camera's image


def pack_message(state: Mapping[str, Any], jpeg: bytes = b"") -> bytes:
    """One WebSocket message: length of the JSON (4 bytes, little endian), the JSON, the JPEG.

    Examples:
        >>> pack_message({"status": "ok"}, b"jpeg")[:4]
        b'\\x10\\x00\\x00\\x00'
    """
    text = json.dumps(state, allow_nan=False, separators=(",", ":")).encode()
    return struct.pack("<I", len(text)) + text + jpeg


class LiveHub:
    """Hands the newest state to every watcher; a slow one misses states, and memory stays bounded.

    `publish` may be called from any thread.  ``watched`` tells a producer whether images are wanted.
    """

    def __init__(self) -> None:
        self._queues: dict[asyncio.Queue[bytes], asyncio.AbstractEventLoop] = {}
        self._last: bytes | None = None

    def __call__(self, state: LiveState) -> None:
        """Publish a step of the live loop; its images only while someone looks."""
        self.publish(state.to_dict(), image_of(state) if self.watched else b"")

    @property
    def watched(self) -> bool:
        """Whether someone looks."""
        return bool(self._queues)

    def publish(self, state: Mapping[str, Any], jpeg: bytes = b"") -> None:
        """Hand a state, and the image it was made from, to every watcher."""
        self._last = message = pack_message(state, jpeg)
        for queue, loop in list(self._queues.items()):
            loop.call_soon_threadsafe(_put_newest, queue, message)

    def publish_line(self, line: bytes) -> None:
        """Publish a step that a run wrote as one line of JSON; other lines are passed over."""
        try:
            state = json.loads(line)
        except ValueError:
            return
        if isinstance(state, dict) and "status" in state:
            self.publish(state)

    def watch(self) -> asyncio.Queue[bytes] | None:
        """A queue of one message, the newest; None when too many watch."""
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


def image_of(state: LiveState) -> bytes:
    """Images of all cameras side by side with the landmarks outlined, as JPEG; empty without an image."""
    import cv2

    from lmkit.visualization.overlay import draw_landmarks, encode_jpeg

    shown = []
    for view in state.views:
        if view.image is None:
            continue
        drawn = draw_landmarks(view.image, view.detections, enlarge=1)
        size = (SHOWN_PX, round(SHOWN_PX * drawn.shape[0] / drawn.shape[1]))
        shown.append(cv2.resize(drawn, size, interpolation=cv2.INTER_AREA))
    if not shown:
        return b""
    height = max(image.shape[0] for image in shown)
    padded = [np.pad(image, ((0, height - image.shape[0]), (0, 0), (0, 0))) for image in shown]
    return encode_jpeg(np.asarray(np.hstack(padded), dtype=np.uint8), 75)


def _put_newest(queue: asyncio.Queue[bytes], message: bytes) -> None:
    if queue.full():
        queue.get_nowait()
    queue.put_nowait(message)
