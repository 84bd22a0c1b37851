"""Live states to browsers: one message holds the pose and its image, so that they cannot part."""

from __future__ import annotations

import asyncio
import json
import struct
from collections.abc import Mapping
from typing import Any

WATCHERS = 8  # browsers at once


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

    @property
    def watched(self) -> bool:
        """Whether someone looks."""
        return bool(self._queues)

    def publish(self, state: Mapping[str, Any], jpeg: bytes = b"") -> None:
        """Hand a state, and the image it was made from, to every watcher."""
        self._last = message = pack_message(state, jpeg)
        for queue, loop in list(self._queues.items()):
            loop.call_soon_threadsafe(_put_newest, queue, message)

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


def _put_newest(queue: asyncio.Queue[bytes], message: bytes) -> None:
    if queue.full():
        queue.get_nowait()
    queue.put_nowait(message)
