"""Rate and latency of the live loop in real time, threads and queues included.

    uv run python benchmarks/live_rate.py [--seconds 20] [--seed 1] [--runs 640x480@30 1280x720@20]

A simulated robot with two cameras drives through a room with six landmarks.  All images are rendered and kept as JPEG
before; a thread decodes each at its time, as of a camera with MJPEG.  Latency counts from the image's time to the end
of the step; poses a second from the first pose on.  Processor time is that of the process, decoding included.  Wall
times mean something on an idle machine only: the load of the last minute is printed.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2

from lmkit.demos.live_run import run_live_demo


def main() -> None:
    """Print a row per size."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--runs", nargs="+", default=["640x480@30", "1280x720@20", "1280x720@30"])
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    columns = ("size, images a second", "steps a second", "poses a second", "latency ms, 50 %", "95 %", "CPU ms")
    print(f"| {' | '.join(columns)} | error mm | NEES / 3 | load |\n|---|---|---|---|---|---|---|---|---|")
    for text in arguments.runs:
        size, _, fps = text.partition("@")
        with TemporaryDirectory() as folder:
            found = run_live_demo(
                Path(folder), arguments.seconds, arguments.seed, options=f"size={size}&fps={fps or 30}"
            )
        if found is None:
            print(f"| {text} | no pose |", flush=True)
            continue
        late, rates = found.latency_ms, (found.step_hz, found.rate_hz)
        print(
            f"| {size}, {fps or 30} | {rates[0]:.1f} | {rates[1]:.1f} | {late[0]:.0f} | {late[1]:.0f} "
            f"| {found.cpu_ms:.1f} | {found.error_mm[0]:.1f} | {found.nees:.2f} | {os.getloadavg()[0]:.1f} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
