"""Real recordings through `lmkit fleet`, from scan to report.

    uv run --all-extras python benchmarks/fleet_real.py ../shared/data [--folder FOLDER]

TagSLAM: detections of AprilTags and visual-inertial odometry as TagSLAM had them, cut into three recordings; tags
measured by hand as known landmarks, to 5 cm and 2 deg.  The reference is TagSLAM's own, no motion capture.
MRCLAM: ranges, bearings and wheel odometry of five robots in one hall; the truth is motion capture.
"""

from __future__ import annotations

import argparse
import gzip
import json
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from fleet_site import fleet
from tagslam import load_hand_measured, load_rig
from track import load as load_mrclam

from lmkit.evaluation.trajectory_error import compare_trajectories, umeyama
from lmkit.fleet.store import Store
from lmkit.geometry.stereo_rig import StereoRig
from lmkit.io.external_maps import read_any_map
from lmkit.io.landmark_map import map_to_yaml
from lmkit.io.recording_tables import detections_to_csv, odometry_to_csv, read_detections
from lmkit.io.rig import rig_to_yaml
from lmkit.io.trajectory import poses_to_tum, read_trajectory
from lmkit.model.landmark_map import LandmarkMap
from lmkit.model.recording import Recording
from lmkit.model.trajectory import Trajectory

PARTS = 3  # of the TagSLAM recording
FAMILY = ("--family", "tag36h11")
SIGMA_M, SIGMA_RAD = 0.05, np.deg2rad(2.0)  # of the hand measurements
EVERY = 5  # frames


def unpacked(source: Path, name: str, folder: Path, head: bytes = b"") -> Path:
    """A gzipped file, unpacked; with another first line where one is given."""
    content = gzip.decompress((source / f"{name}.gz").read_bytes())
    path = folder / name
    path.write_bytes(head + content.split(b"\n", 1)[1] if head else content)
    return path


def write_tagslam(source: Path, folder: Path) -> None:
    """``logs/hall/robot/K/`` with detections.csv and odometry.tum, ``rig.yaml``, and the known landmarks."""
    # The detector's corners run against the clock from bottom left: columns are read by their names.
    head = b"time_s,camera,tag_id,x3,y3,x2,y2,x1,y1,x0,y0\n"
    frames = read_detections(unpacked(source, "tag_detections.csv", folder, head), ["tag36h11"])[::EVERY]
    whole = Recording((), (), read_trajectory(unpacked(source, "vio.tum", folder)))
    for k, some in enumerate(np.array_split(np.arange(len(frames)), PARTS), start=1):
        part = whole.around(tuple(frames[i] for i in some))
        place = folder / "logs" / "hall" / "robot" / str(k)
        place.mkdir(parents=True)
        (place / "detections.csv").write_text(detections_to_csv(part.frames))
        odometry = part.odometry
        poses = [(float(t), odometry.pose(i, "odometry", "base")) for i, t in enumerate(odometry.times_s)]
        (place / "odometry.tum").write_text(poses_to_tum(poses))
    (folder / "rig.yaml").write_text(rig_to_yaml(load_rig(source)))
    C = np.diag([SIGMA_M**2] * 3 + [SIGMA_RAD**2] * 3)
    known = LandmarkMap([replace(m, covariance=C) for m in load_hand_measured(source).values()])
    (folder / "known.yaml").write_text(map_to_yaml(known))


def tracked(folder: Path, rig: StereoRig) -> Trajectory:
    """The left camera wherever the store's trajectories are ok."""
    store = Store(str(folder / "store"))
    tables = [store.read_table(f"track/{path.parent.name}/{path.name}")[0]
              for path in (folder / "store" / "track").glob("*/*.parquet")]  # fmt: skip
    tables.sort(key=lambda table: table["time_s"][0])
    ok = np.array([status == "ok" for table in tables for status in table["status"]])
    columns = [np.concatenate([t[name] for t in tables])[ok] for name in ("time_s", "position", "quaternion")]
    base = Trajectory(*columns)
    assert rig.T_base_left is not None
    poses = [base.pose(k, "map", "base") @ rig.T_base_left for k in range(len(base))]
    return Trajectory(base.times_s, np.array([T.t for T in poses]), np.array([T.quaternion_xyzw for T in poses]))


def tagslam(source: Path, folder: Path) -> None:
    """From scan to report, beside TagSLAM's result."""
    write_tagslam(source, folder)
    print(fleet(folder, "scan", "logs/{site}/{robot}/*", "--rig", "rig.yaml", "--store", "store")[0])
    seen: set[str] = set()
    for row in fleet(folder, "detect", "--store", "store", *FAMILY):
        print({name: row[name] for name in ("recording", "failure", "frames", "detections", "landmarks")})
    for path in (folder / "store" / "detect").glob("*/*/detections.parquet"):
        seen.update(Store(str(path.parent)).read_table(path.name)[0]["id"])
    size = ("--size", "0.15m", "--known", "known.yaml")
    [surveyed] = fleet(folder, "survey", "--store", "store", "-o", "map.yaml", *FAMILY, *size, "--force")
    print({name: surveyed[name] for name in ("moved", "left_out", "warnings")})
    refined = json.loads((source / "tags_refined_from_reference_tf.json").read_text())
    for name in ("known.yaml", "map.yaml"):
        pairs = [(m.T_map_landmark.t, refined[f"tag_{m.code}"][:3]) for m in read_any_map(folder / name)
                 if f"tag_{m.code}" in refined and str(m.id) in seen]  # fmt: skip
        off = 100 * np.linalg.norm([np.subtract(a, b) for a, b in pairs], axis=1)
        print(f"{name}: {len(off)} tags, {np.median(off):.1f} cm median, {np.percentile(off, 90):.1f} cm at 90 %")
    track_and_report(folder, *FAMILY)
    reference = read_trajectory(unpacked(source, "tagslam_reference.tum", folder))
    error = compare_trajectories(reference, tracked(folder, load_rig(source)), "rigid")
    print(f"trajectory: {100 * error.position_m.rmse:.1f} cm rmse, {100 * error.position_m.median:.1f} cm median, "
          f"{error.rotation_deg.median:.2f} deg median, {error.pairs} poses")  # fmt: skip


def mrclam(source: Path, folder: Path) -> None:
    """From scan to report, beside the truth."""
    true: dict[int, np.ndarray] = {}
    for robot in range(1, 6):
        readings, wheels, landmarks, _ = load_mrclam(source, robot)
        true |= {m.code: m.T_map_landmark.t for m in landmarks}
        place = folder / "logs" / "hall" / f"robot{robot}" / "1"
        place.mkdir(parents=True)
        lines = [f"{t:.6f},{r.id.code},{r.range_m},{r.bearing_rad}" for t, seen in readings for r in seen]
        (place / "readings.csv").write_text("\n".join(["time_s,code,range_m,bearing_rad", *lines]) + "\n")
        (place / "odometry.csv").write_text(odometry_to_csv(wheels))
    print(fleet(folder, "scan", "logs/{site}/{robot}/*", "--store", "store")[0])
    for row in fleet(folder, "detect", "--store", "store"):
        print({name: row[name] for name in ("recording", "failure", "frames", "detections", "landmarks")})
    [surveyed] = fleet(folder, "survey", "--store", "store", "-o", "map.yaml", "--force")
    print({name: surveyed[name] for name in ("moved", "left_out", "warnings")})
    found = {m.code: m.T_map_landmark.t for m in read_any_map(folder / "map.yaml")}
    a, b = (np.array([places[code] for code in sorted(found)]) for places in (found, true))
    R, t, _ = umeyama(a, b, with_scale=False)
    off = 100 * np.linalg.norm(a @ R.T + t - b, axis=1)
    print(f"map: {len(off)} landmarks, {np.sqrt((off**2).mean()):.1f} cm rms, {off.max():.1f} cm at most")
    track_and_report(folder)


def track_and_report(folder: Path, *options: str) -> None:
    """Track all recordings; print what is located, and every fault."""
    for row in fleet(folder, "track", "--store", "store", *options):
        print({name: row[name] for name in ("recording", "failure", "frames", "ok", "remarks")})
    [report] = fleet(folder, "report", "--store", "store", "-o", "fleet.html", *options, "--force")
    for fault in report["faults"]:
        print(f"{fault['kind']}: {fault['sentence']} {fault['recordings']}")


def main() -> None:
    """Run in a folder, a temporary one without ``--folder``."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path)
    parser.add_argument("--folder", type=Path)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        for name, run in (("tagslam", tagslam), ("mrclam", mrclam)):
            folder = (arguments.folder or Path(scratch)).absolute() / name
            folder.mkdir(parents=True)
            print(f"## {name}")
            run(arguments.data / name, folder)


if __name__ == "__main__":
    main()
