"""A simulated site of the size that a fleet has, locally and on a Dask cluster whose worker and client are killed.

    uv run --all-extras python benchmarks/fleet_site.py [--days 13] [--seconds 60] [--folder FOLDER]

Three halls of 40 landmarks, six robots, one recording a hall and day.  Planted: a landmark moved in each of two halls
before the last day, one robot's camera bumped from the fifth day on, one robot's odometry stamped late, two damaged
recordings.  Detections, odometry and gyro are simulated, images are not.  The site goes through `lmkit fleet` twice:
in this machine's processes, and on a scheduler and two workers on loopback, of which one worker is killed while it
works, and the client as well, which is then started again.  Prints one table of what was found beside the truth.
"""

from __future__ import annotations

import argparse
import json
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from lmkit.io.external_maps import read_any_map
from lmkit.model.landmark_map import LandmarkMap
from lmkit.simulation.site import Planted, Site, day_name, write_site

HALLS, ROBOTS, LANDMARKS, MOVED = 3, 6, 40, 2
PLANTED = Planted(bumped=(3, 4), clock=(2, 5))  # neither drives on the last day where a landmark was moved
FLEET = [sys.executable, "-m", "lmkit", "fleet"]


def fleet(folder: Path, *words: str) -> list[dict]:
    """Rows of one command of `lmkit fleet`."""
    done = subprocess.run([*FLEET, *words, "--json"], cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode not in (0, 1):
        raise SystemExit(f"{' '.join(words)}: {done.stderr}")
    return [json.loads(line) for line in done.stdout.splitlines()]


@contextmanager
def cluster() -> Iterator[tuple[str, list[subprocess.Popen]]]:
    """Address of a scheduler on loopback, and its two workers."""
    with tempfile.TemporaryDirectory() as scratch:
        stated = Path(scratch) / "scheduler.json"
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        scheduler = [sys.executable, "-m", "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0",
                     "--no-dashboard", "--scheduler-file", str(stated)]  # fmt: skip
        started = [subprocess.Popen(scheduler, **quiet)]
        while not stated.exists():
            time.sleep(0.1)
        address = json.loads(stated.read_text())["address"]
        worker = [sys.executable, "-m", "distributed.cli.dask_worker", address, "--nthreads", "1", "--no-dashboard",
                  "--no-nanny"]  # fmt: skip
        started += [subprocess.Popen(worker, **quiet) for _ in range(2)]
        try:
            yield address, started[1:]
        finally:
            for process in started[::-1]:
                process.kill()
                process.wait()


def detect_with_deaths(folder: Path, store: str) -> str:
    """Detect on a cluster; the first worker dies a little later, and then the client, which is started again."""
    with cluster() as (address, workers):
        words = ["detect", "--store", store, "--engine", f"dask:{address}"]
        client = subprocess.Popen([*FLEET, *words, "--json"], cwd=folder, stdout=subprocess.PIPE, text=True)
        assert client.stdout is not None
        for _ in range(3):
            client.stdout.readline()
        workers[0].kill()
        for _ in range(4):
            client.stdout.readline()
        client.send_signal(signal.SIGKILL)
        before = 7 + len(client.stdout.readlines())
        client.wait()
        again = fleet(folder, *words)
        return f"{before} rows before the client was killed, {len(again)} by the second one"


def nees(found: LandmarkMap, true: LandmarkMap, left_out: set) -> tuple[float, int]:
    """Mean NEES / 3 of the places, aligned by the landmark that defines the map, and how many landmarks."""
    first = min(found, key=lambda m: np.trace(m.covariance[:3, :3]))
    align = true.find(first.id).T_map_landmark.matrix @ np.linalg.inv(first.T_map_landmark.matrix)
    values = []
    for m in found:
        if m.id in left_out or m.id == first.id:
            continue
        off = align[:3, :3] @ m.T_map_landmark.t + align[:3, 3] - true.find(m.id).T_map_landmark.t
        C = align[:3, :3] @ m.covariance[:3, :3] @ align[:3, :3].T
        values.append(off @ np.linalg.solve(C, off) / 3)
    return float(np.mean(values)), len(values)


def run(folder: Path, days: int, seconds: float) -> None:
    """Write the site, survey it twice, print what was found."""
    site = write_site(
        folder, HALLS, days, seconds=seconds, count=LANDMARKS, moved=MOVED, robots=ROBOTS, planted=PLANTED
    )
    for hall, text in (("hall0", "time_s,camera,code\n1,left,7\n"), ("hall1", "time_s,camera\n\x00")):
        damaged = folder / "logs" / hall / "robot3" / "damaged"
        damaged.mkdir(parents=True)
        (damaged / "detections.csv").write_text(text)
    pattern = (f"{folder}/logs/{{site}}/{{robot}}/{{date}}", "--rig", f"{folder}/rigs/{{robot}}/{{date}}.yaml")
    maps = {}
    for store in ("here", "there"):
        print(store, fleet(folder, "scan", *pattern, "--store", store)[0], flush=True)
        start = time.monotonic()
        if store == "here":
            rows = fleet(folder, "detect", "--store", store)
            print(f"detected {len(rows)}, failed {sum(row['failure'] is not None for row in rows)}", flush=True)
        else:
            print(detect_with_deaths(folder, store), flush=True)
        detected = time.monotonic()
        surveyed = fleet(folder, "survey", "--store", store, "-o", f"{store}.yaml")
        ended = time.monotonic()
        print(f"{detected - start:.0f} s to detect, {ended - detected:.0f} s to survey (wall time)", flush=True)
        maps[store] = {row["site"]: read_any_map(folder / row["map"]) for row in surveyed}
    apart = max(
        np.abs(a.T_map_landmark.matrix - b.T_map_landmark.matrix).max()
        for name in maps["here"]
        for a, b in zip(maps["here"][name], maps["there"][name], strict=True)
    )
    print(f"largest difference between the maps of both engines: {apart:.1e}")
    print_maps(site, maps["here"])
    fleet(folder, "track", "--store", "here")
    [report] = fleet(folder, "report", "--store", "here", "-o", "fleet.html")
    print(f"planted: bumped robot{PLANTED.bumped[0]} from {day_name(PLANTED.bumped[1])}, late clock of "
          f"robot{PLANTED.clock[0]} from {day_name(PLANTED.clock[1])}, moved before {day_name(days - 1)}: "
          f"{', '.join(str(m.id) for m in site.moved.values())}")  # fmt: skip
    for fault in report["faults"]:
        print(f"- {fault['kind']}: {fault['sentence']}")


def print_maps(site: Site, maps: dict[str, LandmarkMap]) -> None:
    """Errors of the maps, without what was moved."""
    print("| hall | landmarks | error, mm | NEES / 3 |")
    print("|---|---|---|---|")
    for name, found in maps.items():
        moved = {site.moved[name].id} if name in site.moved else set()
        value, count = nees(found, site.maps[name], moved)
        print(f"| {name} | {count + 1} | {1000 * site.map_error_m(name, found):.1f} | {value:.2f} |")


def main() -> None:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--days", type=int, default=13)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--folder", type=Path)
    arguments = parser.parse_args()
    if arguments.folder is not None:
        run(arguments.folder, arguments.days, arguments.seconds)
        return
    with tempfile.TemporaryDirectory() as folder:
        run(Path(folder), arguments.days, arguments.seconds)


if __name__ == "__main__":
    main()
