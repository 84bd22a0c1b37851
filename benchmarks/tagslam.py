"""A real stereo recording, surveyed: the TagSLAM example (225 s, 140 m, f = 604 px, baseline 20 cm).

    uv run python benchmarks/tagslam.py ../shared/data/tagslam [--every 5] [--sigma 0.05,2] [--no-odometry]
        [--parts 3]

Recorded detections of AprilTags, the hand measurements (`tagslam.yaml`) as known to ``--sigma``, and the
visual-inertial odometry that TagSLAM had, too.  The reference is TagSLAM's own, no motion capture.  With ``--parts``
the recording is cut into as many of equal time, which are surveyed as recordings of one place.
"""

from __future__ import annotations

import argparse
import gzip
import json
import time
from pathlib import Path

import numpy as np
import yaml

from lmkit.evaluation.trajectory_error import compare_trajectories
from lmkit.geometry.camera import CameraModel
from lmkit.geometry.pose import Pose
from lmkit.geometry.stereo_rig import StereoRig
from lmkit.io.recording_tables import read_detections
from lmkit.io.trajectory import read_trajectory
from lmkit.mapping.bundle_adjustment import Anchor
from lmkit.mapping.several_recordings import NamedRecording, survey_recordings
from lmkit.mapping.survey import survey_frames
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import MappedLandmark
from lmkit.model.recording import RigFrame
from lmkit.model.trajectory import Trajectory
from lmkit.odometry.pose_odometry import PoseMotion


def load_rig(folder: Path) -> StereoRig:
    cameras = yaml.safe_load((folder / "cameras.yaml").read_text())
    poses = yaml.safe_load((folder / "camera_poses.yaml").read_text())
    sides, T = [], []
    for name in ("cam0", "cam1"):
        fx, fy, cx, cy = cameras[name]["intrinsics"]
        K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])
        size = tuple(cameras[name]["resolution"])
        sides.append(CameraModel(size, K, np.array(cameras[name]["distortion_coeffs"]), "fisheye"))
        place, turn = (np.array([poses[name]["pose"][part][k] for k in "xyz"]) for part in ("position", "rotation"))
        T.append(Pose.from_rvec("rig", name, turn, place))
    right_left = T[1].inverse() @ T[0]
    odometry = yaml.safe_load((folder / "tagslam.yaml").read_text())["bodies"][-1]["rig"]["T_body_odom"]
    place, turn = (np.array([odometry[part][k] for k in "xyz"]) for part in ("position", "rotation"))
    base_left = (T[0].inverse() @ Pose.from_rvec("rig", "base", turn, place)).inverse()
    return StereoRig(
        sides[0],
        sides[1],
        Pose("right", "left", right_left.R, right_left.t),
        T_base_left=Pose("base", "left", base_left.R, base_left.t),
    )


def load_hand_measured(folder: Path) -> dict[int, MappedLandmark]:
    """Tags of the static body, by code."""
    data = yaml.safe_load((folder / "tagslam.yaml").read_text())
    mounted = {}
    for body in data["bodies"]:
        for values in body.values():
            if not values.get("is_static"):
                continue
            for tag in values.get("tags", []):
                if "pose" not in tag:
                    continue
                place, turn = (np.array([tag["pose"][part][k] for k in "xyz"]) for part in ("position", "rotation"))
                T = Pose.from_rvec("map", "landmark", turn, place)
                mounted[tag["id"]] = MappedLandmark(LandmarkId("tag36h11", tag["id"]), tag.get("size", 0.15), T)
    return mounted


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--every", type=int, default=5)
    parser.add_argument("--no-odometry", action="store_true")
    parser.add_argument("--sigma", default="0.05,2", help="of the hand measurements: meters, degrees")
    parser.add_argument("--parts", type=int, default=1)
    arguments = parser.parse_args()
    folder, (meters, degrees) = arguments.folder, map(float, arguments.sigma.split(","))
    unpacked = Path("/tmp/tag_detections.csv")
    _, rows = gzip.decompress((folder / "tag_detections.csv.gz").read_bytes()).split(b"\n", 1)
    # The detector's corners run against the clock from bottom left: columns are read by their names.
    unpacked.write_bytes(b"time_s,camera,tag_id,x3,y3,x2,y2,x1,y1,x0,y0\n" + rows)
    frames = read_detections(unpacked, ["tag36h11"])[:: arguments.every]
    rig, hand = load_rig(folder), load_hand_measured(folder)
    covariance = np.diag([meters**2] * 3 + [np.deg2rad(degrees) ** 2] * 3)
    seen = {o.id for m in frames for o in m.detections}
    anchors = {("tag36h11", code): Anchor(m, covariance) for code, m in hand.items()}
    sizes = {key: hand[key[1]].size_m if key[1] in hand else 0.15 for key in seen}
    poses = Path("/tmp/vio.tum")
    poses.write_bytes(gzip.decompress((folder / "vio.tum.gz").read_bytes()))
    motion = None if arguments.no_odometry else PoseMotion(read_trajectory(poses))
    start = time.thread_time()
    if arguments.parts > 1:
        joint = survey_recordings(cut(frames, arguments.parts, rig, motion), sizes, anchors)
        results, landmarks = list(joint.surveys), joint.landmarks
        print(
            "parts:",
            joint.names,
            "left out:",
            dict(joint.left_out),
            "moved:",
            [str(m.before.id) for m in joint.moved],
        )
    else:
        results = [survey_frames(frames, rig, sizes, anchors, motion)]
        landmarks = results[0].bundle.landmarks
    took = time.thread_time() - start
    refined = json.loads((folder / "tags_refined_from_reference_tf.json").read_text())
    found = {m.code: m.T_map_landmark.t for m in landmarks}
    codes = [code for _, code in sorted(seen) if f"tag_{code}" in refined and code in found and code in hand]
    off = np.array([np.linalg.norm(found[code] - refined[f"tag_{code}"][:3]) for code in codes])
    before = np.array([np.linalg.norm(hand[code].T_map_landmark.t - refined[f"tag_{code}"][:3]) for code in codes])
    print(
        f"{len(frames)} frames, {sum(len(r.rows) for r in results)} located, {len(codes)} tags seen, {took:.1f} s CPU"
    )
    for name, values in (("hand measured", before), ("surveyed", off)):
        print(
            f"tags, {name}: {100 * np.median(values):.1f} cm median, {100 * np.percentile(values, 90):.1f} cm at 90 %"
        )
    unpacked.with_suffix(".tum").write_bytes(gzip.decompress((folder / "tagslam_reference.tum.gz").read_bytes()))
    poses = [T for result in results for T in result.bundle.left_poses()]
    times = np.concatenate([result.bundle.times_s for result in results])
    mine = Trajectory(times, np.array([T.t for T in poses]), np.array([T.quaternion_xyzw for T in poses]))
    error = compare_trajectories(read_trajectory(unpacked.with_suffix(".tum")), mine, "rigid")
    print(
        f"trajectory: {100 * error.position_m.rmse:.1f} cm rmse, {100 * error.position_m.median:.1f} cm median, "
        f"{error.rotation_deg.median:.2f} deg median, {error.pairs} poses"
    )
    for result in results:
        odometry = {name: round(value, 4) for name, value in result.odometry.items()}
        print("odometry:", odometry, "jumps:", len(result.bundle.jumps))
        print("contradicted:", result.contradicted, "unplaced:", result.unplaced)


def cut(frames: list[RigFrame], parts: int, rig: StereoRig, motion: PoseMotion | None) -> list[NamedRecording]:
    """Recordings of equal time."""
    ends = np.linspace(frames[0].time_s, frames[-1].time_s + 1e-6, parts + 1)
    return [
        NamedRecording(str(k), tuple(f for f in frames if ends[k] <= f.time_s < ends[k + 1]), rig, motion)
        for k in range(parts)
    ]


if __name__ == "__main__":
    main()
