"""Alarms of `lmkit fleet report`: how many there are without a fault, and how small a fault is found.

    uv run --all-extras python benchmarks/fleet_alarms.py [--sites 8] [--first 500]

Simulated sites of one hall, three robots and six days (20 s each, 12 landmarks); detections, odometry and gyro are
simulated, images are not.  Rig files are off by 0.03 deg about each axis, as calibrations are.  Every site is run
once without a fault, and once for each planted fault, which is there from the fourth day on.  A fault counts as named
if its kind and robot are right; everything else that is named is a false alarm.
"""

from __future__ import annotations

import argparse
import os
import tempfile
from collections import Counter
from pathlib import Path

from lmkit.fleet.detection import STAGE as DETECT
from lmkit.fleet.detection import detect_recording
from lmkit.fleet.faults import Fault
from lmkit.fleet.jobs import run_stage
from lmkit.fleet.mapping import parts_by_site, stored_map, survey_site, write_site
from lmkit.fleet.recordings import add_recordings, find_recordings
from lmkit.fleet.report import fleet_state
from lmkit.fleet.rig_checks import STAGE as CHECK
from lmkit.fleet.rig_checks import bumped_recordings, check_options, check_recording, store_check_options
from lmkit.fleet.store import Store
from lmkit.fleet.tracking import STAGE as TRACK
from lmkit.fleet.tracking import track_recording
from lmkit.simulation.site import Planted
from lmkit.simulation.site import write_site as write_files

ROBOTS, DAYS, SECONDS, LANDMARKS = 3, 6, 20.0, 12
RIG_ERROR_DEG = 0.03
SIZE_M = 0.18
USUAL_DELAY_S = 0.25  # of the simulated odometry
OPTIONS = {"families": ["lm8"], "hz": None}
BUMPED, LATE = 1, 2  # robots
KINDS = {
    "no fault": Planted(),
    **{f"camera turned by {deg:g} deg": Planted((BUMPED, 3), bump_deg=deg) for deg in (0.1, 0.2, 0.4)},
    **{f"odometry late by {delay_s - USUAL_DELAY_S:g} s": Planted(clock=(LATE, 3), delay_s=delay_s)
       for delay_s in (0.45, 0.65, 1.05)},
}  # fmt: skip


def faults_of(folder: Path, seed: int, planted: Planted) -> list[Fault]:
    """A simulated site through all stages."""
    write_files(folder, 1, DAYS, SECONDS, LANDMARKS, False, ROBOTS, 5.0, planted, RIG_ERROR_DEG, seed)
    store = Store(str(folder / "store"))
    pattern = f"{folder}/logs/{{site}}/{{robot}}/{{date}}"
    add_recordings(store, find_recordings(pattern, f"{folder}/rigs/{{robot}}/{{date}}.yaml"))
    list(run_stage(store, DETECT, detect_recording, OPTIONS))
    check = check_options(OPTIONS, SIZE_M, {})
    list(run_stage(store, CHECK, check_recording, check))
    store_check_options(store, check)
    [(site, parts)] = parts_by_site(store, OPTIONS).items()
    write_site(store, survey_site(store, site, parts, SIZE_M, None, bumped_recordings(store, check)))
    tracked = {"maps": {site: stored_map(store, site)}, "detect": OPTIONS}
    list(run_stage(store, TRACK, track_recording, tracked))
    return fleet_state(store, OPTIONS, tracked).faults()


def main() -> None:
    """Print a row per planted fault."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sites", type=int, default=8)
    parser.add_argument("--first", type=int, default=500, help="first seed")
    arguments = parser.parse_args()
    os.environ["LMKIT_JOBS"] = "1"
    print("| planted | sites | named | false alarms |")
    print("|---|---|---|---|")
    for name, planted in KINDS.items():
        kind, robot = ("rig", BUMPED) if planted.bumped[0] >= 0 else ("clock", planted.clock[0])
        named, false = 0, Counter()
        for seed in range(arguments.first, arguments.first + arguments.sites):
            with tempfile.TemporaryDirectory() as folder:
                faults = faults_of(Path(folder), seed, planted)
            right = [f for f in faults if f.kind == kind and f.robot == f"robot{robot}"]
            named += bool(right)
            for fault in faults:
                if fault not in right:
                    false[fault.kind] += 1
                    print(f"<!-- seed {seed}: {fault} -->", flush=True)
        alarms = ", ".join(f"{count} {kind}" for kind, count in sorted(false.items())) or "none"
        print(f"| {name} | {arguments.sites} | {named if robot >= 0 else '-'} | {alarms} |", flush=True)


if __name__ == "__main__":
    main()
