"""WebSocket: every step as one JSON text, to all connected clients (extra ``web``)."""

from __future__ import annotations

import json
from typing import Any

from lmkit.live.outputs.base import OutputLost
from lmkit.live.outputs.extras import require
from lmkit.live.state import LiveState

PORT = 8765
MOST_BEHIND = 1 << 20  # queued bytes of a slow reader, beyond which it misses steps


class WebSocketServer:
    """A server on ``HOST:PORT``; a slow reader misses steps, and does not delay others.

    Args:
        host: 127.0.0.1 by default.

    Raises:
        InputError: websockets is not installed.
        OutputLost: the port cannot be opened.
    """

    def __init__(self, host: str = "127.0.0.1", port: int = PORT) -> None:
        require("websockets", "WebSocket", "web")
        import asyncio
        import threading

        self._peers: set[Any] = set()
        self._loop = asyncio.new_event_loop()
        self._failed: OSError | None = None
        self._stop: asyncio.Event | None = None
        started = threading.Event()
        self.port = port

        async def serve() -> None:
            from websockets.asyncio.server import serve

            self._stop = asyncio.Event()
            try:
                async with serve(self._welcome, host, port, compression=None, max_size=1024) as server:
                    self.port = int(next(iter(server.sockets)).getsockname()[1])
                    started.set()
                    await self._stop.wait()
            except OSError as error:
                self._failed = error
                started.set()

        self._thread = threading.Thread(target=lambda: self._loop.run_until_complete(serve()), daemon=True)
        self._thread.start()
        started.wait(5)
        if self._failed is not None:
            raise OutputLost(f"cannot listen on {host}:{port}: {self._failed.strerror}")

    async def _welcome(self, peer: Any) -> None:
        self._peers.add(peer)
        try:
            async for _ in peer:  # messages from readers are ignored
                pass
        finally:
            self._peers.discard(peer)

    def send(self, state: LiveState) -> bool:
        """See `Output`."""
        if not self._peers:
            return False
        self._loop.call_soon_threadsafe(self._broadcast, json.dumps(state.to_dict(), allow_nan=False))
        return True

    def _broadcast(self, text: str) -> None:
        from websockets.asyncio.server import broadcast

        ready = [p for p in self._peers if p.transport.get_write_buffer_size() < MOST_BEHIND]
        broadcast(ready, text)

    def close(self) -> None:
        """See `Output`."""
        if self._stop is not None:
            self._loop.call_soon_threadsafe(self._stop.set)
        self._thread.join(2)
