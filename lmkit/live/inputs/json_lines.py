"""Odometry and gyro as JSON lines over WebSocket (extra ``web``): a server that the robot connects to."""

from __future__ import annotations

import json
import threading
from collections.abc import Sequence
from typing import Any

from lmkit.live.inputs.base import InputLost, Reading
from lmkit.live.inputs.waiting import WaitingReadings
from lmkit.live.motion import GYRO, POSE, WHEELS

MOST_BYTES = 1 << 16
PORT = 8766


class JsonInput:
    """Listens on ``HOST:PORT``; every text message has one or more lines.

    Raises:
        InputLost: the port cannot be opened.
    """

    def __init__(self, host: str = "127.0.0.1", port: int = PORT) -> None:
        from websockets.sync.server import serve

        self._waiting = WaitingReadings()
        try:
            self._server: Any = serve(self._welcome, host, port, compression=None, max_size=MOST_BYTES)
        except OSError as error:
            raise InputLost(f"cannot listen on {host}:{port}: {error.strerror}") from None
        self.port = int(self._server.socket.getsockname()[1])
        threading.Thread(target=self._server.serve_forever, name="lmkit-motion", daemon=True).start()

    def _welcome(self, peer: Any) -> None:
        for text in peer:
            for line in text.splitlines():
                reading = reading_of(line)
                if reading is not None:
                    self._waiting.put(reading)

    def read(self, timeout_s: float) -> Sequence[Reading]:
        """See `MotionInput`."""
        return self._waiting.take(timeout_s)

    def close(self) -> None:
        """See `MotionInput`."""
        self._server.shutdown()


def reading_of(line: str | bytes) -> Reading | None:
    """The reading in a line of JSON; None without one.

    Examples:
        >>> reading_of('{"time_s": 1.5, "forward_m": 0.02, "turn_rad": 0.001}')
        Reading(kind='wheels', time_s=1.5, values=(0.02, 0.001))
        >>> reading_of('{"rate_radps": 0.3}').kind
        'gyro'
    """
    try:
        row = json.loads(line)
        time_s = None if row.get("time_s") is None else float(row["time_s"])
        if "forward_m" in row:
            return Reading(WHEELS, time_s, (float(row["forward_m"]), float(row["turn_rad"])))
        if "rate_radps" in row:
            return Reading(GYRO, time_s, (float(row["rate_radps"]),))
        if "position" in row:
            numbers = tuple(float(v) for v in (*row["position"], *row["quaternion"]))
            return Reading(POSE, time_s, numbers)
    except (AttributeError, KeyError, TypeError, ValueError):
        return None
    return None
