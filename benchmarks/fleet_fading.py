"""Landmarks that fade, by `lmkit fleet report`: how pale one is when it is named, and how many good ones are named.

    uv run --all-extras python benchmarks/fleet_fading.py [--sites 6] [--first 700]

Simulated sites of one hall with 12 landmarks: eight days, one recording of 24 s a day, four robots in turn.  Images
are simulated (`simulation/quick_images.py`) and detected; every recording has a light of its own, from 0.6 to 1.  In
every site the landmark that is seen most often pales from the fifth day on: its ink comes nearer to its paper by a
share.
A fault counts as named if it names that landmark; every other landmark that is called faded is a false alarm.
"""

from __future__ import annotations

import argparse
import os
import tempfile
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from lmkit.fleet.detection import STAGE as DETECT
from lmkit.fleet.detection import detect_recording
from lmkit.fleet.faults import Fault
from lmkit.fleet.jobs import run_stage
from lmkit.fleet.mapping import parts_by_site, stored_map, survey_site, write_site
from lmkit.fleet.recordings import TABLE, add_recordings, find_recordings
from lmkit.fleet.report import fleet_state
from lmkit.fleet.store import Store
from lmkit.fleet.tracking import STAGE as TRACK
from lmkit.fleet.tracking import track_recording
from lmkit.geometry.rig import mounted_cameras
from lmkit.io.recording_tables import gyro_to_csv, odometry_to_csv
from lmkit.io.rig import rig_to_yaml
from lmkit.model.recording import Gyro, Odometry
from lmkit.simulation.quick_images import QuickCamera
from lmkit.simulation.recording import T_BASE_LEFT, Drive, make_drive
from lmkit.simulation.scene import furnish_room, make_rig
from lmkit.simulation.site import DAY_S, MONDAY_S, day_name, most_seen

ROBOTS, DAYS, SECONDS, HZ, LANDMARKS = 4, 8, 24.0, 2.5, 12
FROM_DAY = 4
ROOM_M = (8.0, 5.0, 2.6)
SIZE_M = 0.18
DARKEST = 0.6
PALE = (0.0, 0.3, 0.5, 0.65)
OPTIONS = {"families": ["lm8"], "hz": None}


def write_recording(folder: Path, drive: Drive, cameras: list[QuickCamera], light: float, start_s: float) -> None:
    """Images, odometry and gyro of one recording."""
    for camera in mounted_cameras(drive.rig):
        (folder / camera.name).mkdir(parents=True)
    for k, time_s in enumerate(drive.times_s):
        T = drive.pose(k) @ drive.rig.T_base_left
        for camera, take in zip(mounted_cameras(drive.rig), cameras, strict=True):
            image = take(T @ camera.T_camera_left.inverse(), light)
            name = folder / camera.name / f"{k:04d}_{start_s + time_s:.3f}.jpg"
            cv2.imwrite(str(name), image, [cv2.IMWRITE_JPEG_QUALITY, 95])
    o, g = drive.odometry, drive.gyro
    (folder / "odometry.csv").write_text(odometry_to_csv(Odometry(o.times_s + start_s, o.forward_m, o.turn_rad)))
    (folder / "gyro.csv").write_text(gyro_to_csv(Gyro(g.times_s + start_s, g.rate_radps)))


def write_days(folder: Path, seed: int, days: range, share: float) -> str:
    """Recordings of some days; the landmark that pales by a share."""
    rig = replace(make_rig(), T_base_left=T_BASE_LEFT)
    landmarks = make_drive(100_000 * seed, 1.0, HZ, count=LANDMARKS, rig=rig).landmarks
    drives = [make_drive(100_000 * seed + day, SECONDS, HZ, rig=rig, landmarks=landmarks) for day in range(DAYS)]
    chosen = most_seen(tuple(frame for drive in drives for frame in drive.frames), landmarks)
    scene = furnish_room(np.random.default_rng([seed, 5]), landmarks, ROOM_M)
    lights = np.random.default_rng([seed, 6]).uniform(DARKEST, 1.0, DAYS)
    for day in days:
        cameras = [QuickCamera(scene, c.model, 100 * seed + day, {chosen.id: share}) for c in mounted_cameras(rig)]
        into = folder / f"robot{day % ROBOTS}" / day_name(day)
        write_recording(into, drives[day], cameras, float(lights[day]), MONDAY_S + DAY_S * day)
    return str(chosen.id)


def site_faults(folder: Path, seed: int) -> Iterator[tuple[float, str, list[Fault]]]:
    """For each paleness the landmark that pales, and what the report names; the days before are those of all."""
    rig = folder / "rig.yaml"
    rig.write_text(rig_to_yaml(replace(make_rig(), T_base_left=T_BASE_LEFT)))
    store = Store(str(folder / "store"))
    write_days(folder / "before", seed, range(FROM_DAY), 0.0)
    for share in PALE:
        chosen = write_days(folder / f"{share:g}", seed, range(FROM_DAY, DAYS), share)
        (folder / "store" / TABLE).unlink(missing_ok=True)
        for part in ("before", f"{share:g}"):
            add_recordings(store, find_recordings(f"{folder}/{part}/{{robot}}/{{date}}", str(rig)))
        list(run_stage(store, DETECT, detect_recording, OPTIONS))
        [(site, parts)] = parts_by_site(store, OPTIONS).items()
        write_site(store, survey_site(store, site, parts, SIZE_M))
        tracked = {"maps": {site: stored_map(store, site)}, "detect": OPTIONS}
        list(run_stage(store, TRACK, track_recording, tracked))
        yield share, chosen, fleet_state(store, OPTIONS, tracked).faults()


def main() -> None:
    """Print a row for each paleness."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sites", type=int, default=6)
    parser.add_argument("--first", type=int, default=700, help="first seed")
    arguments = parser.parse_args()
    os.environ["LMKIT_JOBS"] = "1"
    counts = {share: Counter[str]() for share in PALE}
    for seed in range(arguments.first, arguments.first + arguments.sites):
        with tempfile.TemporaryDirectory() as folder:
            for share, chosen, faults in site_faults(Path(folder), seed):
                counts[share]["sites"] += 1
                for fault in faults:
                    print(f"<!-- {share} seed {seed}, {chosen}: {fault} -->", flush=True)
                    right = share > 0 and fault.kind == "faded" and fault.sentence.startswith(f"{chosen} ")
                    counts[share]["named" if right else fault.kind] += 1
                    counts[share]["day"] += right and fault.day == day_name(FROM_DAY)
                print(f"<!-- {share} seed {seed} done -->", flush=True)
    print("| nearer to white by | sites | named | on its day | good landmarks called faded | other faults |")
    print("|---|---|---|---|---|---|")
    for share, count in counts.items():
        other = sum(count.values()) - sum(count[name] for name in ("sites", "named", "day", "faded"))
        numbers = [count[name] for name in ("sites", "named", "day", "faded")]
        print(f"| {100 * share:.0f} % | {' | '.join(map(str, [*numbers, other]))} |", flush=True)


if __name__ == "__main__":
    main()
