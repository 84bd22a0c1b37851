"""Long running of the live loop: memory, processor time and errors in each tenth of it.

    uv run python benchmarks/live_hour.py [--minutes 60] [--fps 30] [--images]

A simulated robot drives round a room with six landmarks, as fast as the loop takes its frames; a WebSocket output
with a reader takes the steps.  Corners are simulated unless ``--images`` renders them.  Memory is the resident set of
the process; milliseconds are thread processor time of a step, largest errors those of published poses.
"""

from __future__ import annotations

import argparse
import gc
import os
import threading
import time
from pathlib import Path

import cv2
import numpy as np

from lmkit.live.loop import LiveLoop, LoopSettings
from lmkit.live.outputs.base import OutputRunner
from lmkit.live.outputs.websocket import WebSocketServer
from lmkit.live.simulated_source import SimulatedRun
from lmkit.live.source_address import parse_source

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


def main() -> None:
    """Print a row for each tenth."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--fps", type=float, default=30.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--images", action="store_true")
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    seconds = 60 * arguments.minutes
    options = f"seconds={seconds:.0f}&seed={arguments.seed}&fps={arguments.fps}&speed=max"
    simulated = SimulatedRun(parse_source(f"sim:?{options}" + ("" if arguments.images else "&images=no")))
    loop = LiveLoop(simulated.course.rig, simulated.course.landmarks, LoopSettings("wheels"))
    server = WebSocketServer(port=0)
    output, stop = OutputRunner("ws", lambda: server, time.time), threading.Event()
    threading.Thread(target=read_all, args=(server.port, stop), daemon=True).start()
    each = max(int(seconds * arguments.fps / PARTS), 1)
    what = "images" if arguments.images else "corners"
    print(f"{arguments.minutes:g} minutes at {arguments.fps:g} a second, {what}\n")
    print("| minute | steps | poses | memory MB | ms a step | 95 % | error mm rms | largest |")
    print("|---|---|---|---|---|---|---|---|")
    start, times, errors = time.monotonic(), [], []
    for k, group in enumerate(simulated.groups(), 1):
        before = time.thread_time()
        state = loop.step(group)
        times.append(1000 * (time.thread_time() - before))
        if state is not None:
            output.put(state)
            if state.T_map_base is not None and state.truth is not None:
                errors.append(1000 * float(np.linalg.norm((state.T_map_base.t - state.truth.t)[:2])))
        if k % each == 0:
            gc.collect()
            off = np.array(errors) if errors else np.array([np.nan])
            print(
                f"| {k / arguments.fps / 60:.0f} | {len(times)} | {len(errors)} | {resident_mb():.0f} "
                f"| {np.mean(times):.2f} | {np.percentile(times, 95):.2f} | {np.sqrt(np.mean(off**2)):.1f} "
                f"| {off.max():.0f} |",
                flush=True,
            )
            times, errors = [], []
    print(f"\n{time.monotonic() - start:.0f} s of wall time; output: {output.health().count} sent")
    stop.set()
    output.close()


if __name__ == "__main__":
    main()
