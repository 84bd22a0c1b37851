"""The status line on a terminal, and events as lines."""

from __future__ import annotations

import sys
import time

from lmkit.live.state import LiveState

EVERY_S = 0.2


class StatusLine:
    """A listener that updates one line on stderr, only on a terminal; events are separate lines."""

    def __init__(self) -> None:
        self._terminal = sys.stderr.isatty()
        self._shown = 0.0

    def __call__(self, state: LiveState) -> None:
        """Show a step."""
        for event in state.events:
            if event.code.startswith("status_") and not self._terminal:
                continue
            self._clear()
            sys.stderr.write(f"{event.code}: {event.message}\n")
        if state.events:
            sys.stderr.flush()
        now = time.monotonic()
        if not self._terminal or now - self._shown < EVERY_S:
            return
        self._shown = now
        self._clear()
        sys.stderr.write(describe(state)[:118])
        sys.stderr.flush()

    def _clear(self) -> None:
        if self._terminal:
            sys.stderr.write("\r\x1b[K")

    def close(self) -> None:
        """End the line."""
        self._clear()
        sys.stderr.flush()


def describe(state: LiveState) -> str:
    """One line about a step."""
    parts = [str(state.status), f"{state.rate_hz:4.1f}/s"]
    if state.latency_s is not None:
        parts.append(f"{1000 * state.latency_s:3.0f} ms")
    if state.T_map_base is not None:
        x, y, z = state.T_map_base.t
        parts.append(f"x {x:.3f} y {y:.3f} z {z:.3f} m")
    parts.append(f"{len(state.ids)} landmarks")
    if state.outliers:
        parts.append("outliers " + ", ".join(map(str, state.outliers)))
    if state.reason:
        parts.append(state.reason)
    if state.profile != "balanced":
        parts.append(f"profile {state.profile}")
    parts += [f"{health.name}: {health.problem}" for health in (*state.sources, *state.outputs) if health.problem]
    return " | ".join(parts)
