"""Long running of the live loop: memory, rate, latency, processor time and errors in each tenth of it.

    uv run python benchmarks/live_hour.py [--minutes 60] [--fps 30] [--images] [--live]

A simulated robot drives round a room with six landmarks, and a WebSocket output with a reader takes the steps.
Frames come as fast as the loop takes them, or with ``--live`` at their times, through the thread of a camera.
Corners are simulated unless ``--images`` renders them (``--live`` always does, beside the loop).  Memory is the
resident set of the process; milliseconds are processor time of the loop's thread a step,
largest errors those of published poses.
"""

from __future__ import annotations

import argparse
import gc
import os
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np

from lmkit.live.live_run import LiveRun
from lmkit.live.open_run import open_run
from lmkit.live.outputs.base import OutputRunner
from lmkit.live.outputs.websocket import WebSocketServer
from lmkit.live.run_settings import settings_of
from lmkit.live.state import LiveState

PARTS = 10


def resident_mb() -> float:
    """Resident set of this process."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def read_all(port: int, stop: threading.Event) -> None:
    """A client that reads every step."""
    from websockets.exceptions import ConnectionClosed
    from websockets.sync.client import connect

    with connect(f"ws://127.0.0.1:{port}") as peer:
        while not stop.is_set():
            try:
                peer.recv(timeout=0.5)
            except TimeoutError:
                continue
            except ConnectionClosed:
                return


@dataclass
class Part:
    """Figures of a tenth."""

    poses: int = 0
    times: list[float] = field(default_factory=list)
    errors_mm: list[float] = field(default_factory=list)
    late_ms: list[float] = field(default_factory=list)
    stamps: list[float] = field(default_factory=list)

    def row(self, minute: float) -> str:
        """The row of the table."""
        off = np.array(self.errors_mm or [np.nan])
        late = np.array(self.late_ms or [np.nan])
        rate = (len(self.stamps) - 1) / max(self.stamps[-1] - self.stamps[0], 1e-6)
        return (
            f"| {minute:.0f} | {len(self.stamps)} | {rate:.2f} | {self.poses} | {resident_mb():.0f} "
            f"| {np.mean(self.times):.2f} | {np.median(late):.0f} | {np.percentile(late, 95):.0f} "
            f"| {np.sqrt(np.mean(off**2)):.1f} | {off.max():.0f} |"
        )


class Watch:
    """Listener that prints a row for each tenth."""

    def __init__(self, seconds: float) -> None:
        self._seconds, self._start = seconds, float("nan")
        self._part, self._parts, self._cpu = Part(), 0, time.thread_time()

    def __call__(self, state: LiveState) -> None:
        """Take a step."""
        part = self._part
        cpu = time.thread_time()
        part.times.append(1000 * (cpu - self._cpu))
        part.stamps.append(state.time_s)
        part.late_ms += [] if state.latency_s is None else [1000 * state.latency_s]
        if state.T_map_base is not None and state.truth is not None:
            part.poses += 1
            part.errors_mm.append(1000 * float(np.linalg.norm((state.T_map_base.t - state.truth.t)[:2])))
        if not self._start <= state.time_s:
            self._start = state.time_s
        if state.time_s - self._start >= (self._parts + 1) * self._seconds / PARTS:
            gc.collect()
            print(part.row((state.time_s - self._start) / 60), flush=True)
            self._part, self._parts = Part(), self._parts + 1
        self._cpu = time.thread_time()


def watched(run: LiveRun, seconds: float) -> None:
    """Run, and stop after a time of the stamps."""
    watch, first = Watch(seconds), list[float]()

    def listen(state: LiveState) -> None:
        watch(state)
        if not first:
            first.append(state.time_s)
        if state.time_s - first[0] > seconds + 1:
            run.stop()

    run.listeners.append(listen)
    run.run()


def main() -> None:
    """Print a row for each tenth."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--fps", type=float, default=30.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--images", action="store_true")
    parser.add_argument("--live", action="store_true")
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    seconds = 60 * arguments.minutes
    source = f"sim:?seconds={seconds + 5:.0f}&seed={arguments.seed}&fps={arguments.fps}"
    source += "" if arguments.live else "&speed=max" + ("" if arguments.images else "&images=no")
    run = open_run(settings_of({"sources": [source]}, Path()))
    server = WebSocketServer(port=0)
    output, stop = OutputRunner("ws", lambda: server, time.time), threading.Event()
    run.outputs.append(output)
    threading.Thread(target=read_all, args=(server.port, stop), daemon=True).start()
    images = arguments.live or arguments.images
    print(f"{arguments.minutes:g} minutes at {arguments.fps:g} a second, {'images' if images else 'corners'}\n")
    print(
        "| minute | steps | a second | poses | memory MB | ms a step | latency 50 % | 95 % | error mm rms | largest |"
    )
    print("|---|---|---|---|---|---|---|---|---|---|", flush=True)
    start = time.monotonic()
    watched(run, seconds)
    print(f"\n{time.monotonic() - start:.0f} s of wall time; output: {output.health().count} sent")
    print(f"statuses {dict(run.summary.statuses)}; events {dict(run.summary.events)}")
    stop.set()


if __name__ == "__main__":
    main()
