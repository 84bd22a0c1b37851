"""A real stereo recording, surveyed: the TagSLAM example (225 s, 140 m, f = 604 px, baseline 20 cm).

    uv run python benchmarks/tagslam.py ../shared/data/tagslam [--every 5] [--sigma 0.05,2] [--no-odometry]

Recorded detections of AprilTags, the hand measurements (`tagslam.yaml`) as known to ``--sigma``, and the
visual-inertial odometry that TagSLAM had, too.  The reference is TagSLAM's own, no motion capture.
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
from lmkit.mapping.survey import survey_frames
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import MappedLandmark
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
    start = time.perf_counter()
    result = survey_frames(frames, rig, sizes, anchors, motion)
    took = time.perf_counter() - start
    refined = json.loads((folder / "tags_refined_from_reference_tf.json").read_text())
    found = {m.code: m.T_map_landmark.t for m in result.bundle.landmarks}
    codes = [code for _, code in sorted(seen) if f"tag_{code}" in refined and code in found and code in hand]
    off = np.array([np.linalg.norm(found[code] - refined[f"tag_{code}"][:3]) for code in codes])
    before = np.array([np.linalg.norm(hand[code].T_map_landmark.t - refined[f"tag_{code}"][:3]) for code in codes])
    print(f"{len(frames)} frames, {len(result.rows)} located, {len(codes)} tags seen, {took:.1f} s")
    for name, values in (("hand measured", before), ("surveyed", off)):
        print(
            f"tags, {name}: {100 * np.median(values):.1f} cm median, {100 * np.percentile(values, 90):.1f} cm at 90 %"
        )
    unpacked.with_suffix(".tum").write_bytes(gzip.decompress((folder / "tagslam_reference.tum.gz").read_bytes()))
    poses = result.bundle.left_poses()
    mine = Trajectory(
        result.bundle.times_s, np.array([T.t for T in poses]), np.array([T.quaternion_xyzw for T in poses])
    )
    error = compare_trajectories(read_trajectory(unpacked.with_suffix(".tum")), mine, "rigid")
    print(
        f"trajectory: {100 * error.position_m.rmse:.1f} cm rmse, {100 * error.position_m.median:.1f} cm median, "
        f"{error.rotation_deg.median:.2f} deg median, {error.pairs} poses"
    )
    print("odometry:", result.bundle.parameters.round(4), "jumps:", len(result.bundle.jumps))
    print("contradicted:", result.contradicted, "unplaced:", result.unplaced)


if __name__ == "__main__":
    main()
