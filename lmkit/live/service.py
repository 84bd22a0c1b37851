"""A live run as a service: signals, the status line, the health page, a bounded time."""

from __future__ import annotations

import json
import signal
import sys
import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from lmkit.errors import InputError
from lmkit.live.live_run import LiveRun, RunSummary
from lmkit.live.open_outputs import host_and_port
from lmkit.live.run_settings import RunSettings
from lmkit.live.status_line import StatusLine
from lmkit.model.pose_status import PoseStatus

HEALTH_PORT = 8088
FRESH_S = 2.0  # longest time without a step of a healthy run


def run_until_stopped(run: LiveRun, settings: RunSettings, seconds: float | None = None) -> RunSummary:
    """Run until the sources end, SIGINT or SIGTERM, or ``seconds`` are over.

    Raises:
        InputError: the health page's port cannot be opened.
    """
    line = StatusLine()
    run.listeners.append(line)
    page = None if settings.values.health is None else HealthPage(run, settings.values.health)
    timer = None if seconds is None else threading.Timer(seconds, run.stop)
    before = _stop_on_signals(run)
    try:
        if timer is not None:
            timer.daemon = True
            timer.start()
        return run.run()
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        if timer is not None:
            timer.cancel()
        if page is not None:
            page.close()
        line.close()


def _stop_on_signals(run: LiveRun) -> dict[signal.Signals, Any]:
    """Install handlers, and return the previous ones; only the main thread can do so."""
    if threading.current_thread() is not threading.main_thread():
        return {}
    return {number: signal.signal(number, lambda *_: run.stop()) for number in (signal.SIGINT, signal.SIGTERM)}


class HealthPage:
    """``GET /health`` over HTTP: 200 while there are steps, 503 otherwise, with the condition as JSON.

    Args:
        address: ``HOST:PORT``.

    Raises:
        InputError: the port cannot be opened.
    """

    def __init__(self, run: LiveRun, address: str) -> None:
        host, port = host_and_port(address, HEALTH_PORT, "--health")

        class Handler(BaseHTTPRequestHandler):
            """Answers one request."""

            def do_GET(self) -> None:
                good, text = health_text(run)
                body = text.encode()
                self.send_response(200 if good else 503)
                self.send_header("Content-Type", "application/json")
                self.send_header("Content-Length", str(len(body)))
                self.end_headers()
                self.wfile.write(body)

            def log_message(self, format: str, *args: object) -> None:
                """No log, since it would grow without limit."""

        try:
            self._server = ThreadingHTTPServer((host, port), Handler)
        except OSError as error:
            raise InputError(
                "port_in_use", f"--health {address}: {error.strerror or error}", "choose another port"
            ) from None
        self._server.daemon_threads = True
        self.port = int(self._server.server_address[1])
        threading.Thread(target=self._server.serve_forever, name="lmkit-health", daemon=True).start()

    def close(self) -> None:
        """Stop listening."""
        self._server.shutdown()
        self._server.server_close()


def health_text(run: LiveRun) -> tuple[bool, str]:
    """Whether the run is healthy, and its condition as JSON."""
    state, age = run.newest, time.monotonic() - run.newest_at
    fresh = state is not None and age < FRESH_S
    sources = run.feed.health()
    outputs = tuple(output.health() for output in run.outputs)
    good = fresh and all(h.good for h in (*sources, *outputs))
    values = {
        "good": good,
        "status": None if state is None else str(state.status),
        "located": state is not None and state.status == PoseStatus.OK,
        "reason": "" if state is None else state.reason,
        "age_s": age if state is not None else None,
        "rate_hz": 0.0 if state is None else state.rate_hz,
        "latency_p95_ms": 1000 * run.loop.latency_p95_s,
        "steps": run.summary.steps,
        "sources": [h.to_dict() for h in sources],
        "outputs": [h.to_dict() for h in outputs],
        "memory_mb": memory_mb(),
    }
    return good, json.dumps(values, allow_nan=False)


def memory_mb() -> float | None:
    """Memory of this process, MB, if known; Linux only."""
    if not sys.platform.startswith("linux"):
        return None
    from pathlib import Path

    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * 4096 / 1e6
