"""The rendered recording, surveyed from one landmark and tracked by its true map (docs/survey-and-track.md).

    uv run python benchmarks/drive.py ../shared/data/drive

Odometry is the file's own dead reckoning, with the gyro's turns.  One code is mounted twice there: it is left out of
the true map, and `contradicted` shows whether the survey names it.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from locate import read_truth, true_map, true_rig

from lmkit.geometry.pose import Pose
from lmkit.geometry.rotations import rotation_angle, rotation_log
from lmkit.geometry.stereo_rig import StereoRig
from lmkit.io.recording_tables import read_gyro, read_odometry
from lmkit.mapping.bundle_adjustment import Anchor
from lmkit.mapping.survey import survey_frames
from lmkit.model.landmark import LM8
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import LandmarkMap, MappedLandmark
from lmkit.odometry.wheel_odometry import MotionModel
from lmkit.pipelines.detect_recording import see_drive
from lmkit.tracking.batch import track_images
from lmkit.tracking.online import track_images_live


def rms(values: list[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def off(found: Pose, true: Pose) -> tuple[float, float]:
    """Centimeters and degrees."""
    return 100 * float(np.linalg.norm(found.t - true.t)), float(np.rad2deg(rotation_angle(found.R.T @ true.R)))


def nees_of(found: MappedLandmark, true: MappedLandmark) -> float:
    """Squared error of a landmark's place, in standard deviations."""
    assert found.covariance is not None
    error = found.T_map_landmark.t - true.T_map_landmark.t
    return float(error @ np.linalg.solve(found.covariance[:3, :3], error))


def main(folder: Path) -> None:
    truth = read_truth(folder)
    body, cameras = truth["body_T_left"], true_rig(truth)
    T_base_left = Pose.from_quaternion("base", "left", body["position"], body["quaternion_xyzw"])
    rig = StereoRig(cameras.left, cameras.right, cameras.T_right_left, T_base_left)
    images = folder / "images"
    frames = list(see_drive([f"{images}/*_L.jpg", f"{images}/*_R.jpg"], rig, (LM8,), truth["timing"]["camera_hz"]))
    wheels = read_odometry(folder / "odometry.csv"), read_gyro(folder / "gyro.csv")
    mounted = LandmarkMap([m for room in truth["maps"] for m in true_map(truth, int(room))])
    anchor = mounted.find(LandmarkId("lm8", truth["anchor"]["id"]))
    assert anchor is not None
    sizes = {o.id: 0.18 for m in frames for o in m.detections}
    survey = survey_frames(frames, rig, sizes, {anchor.id: Anchor(anchor, None)}, MotionModel(*wheels))
    poses = []
    for pair in truth["pairs"]:
        world = pair["T_world_left"]
        poses.append(Pose.from_quaternion("map", "left", world["position"], world["quaternion_xyzw"]))
    trajectory = [off(found, poses[k]) for k, found in zip(survey.rows, survey.bundle.left_poses(), strict=True)]
    known = [(m, true) for m in survey.landmarks if (true := mounted.find(m.id)) is not None]
    places = [off(m.T_map_landmark, true.T_map_landmark) for m, true in known]
    print(f"survey: {len(survey.rows)} of {len(frames)} frames, {len(survey.landmarks)} landmarks")
    print(
        f"  trajectory {rms([cm for cm, _ in trajectory]):.2f} cm, {rms([deg for _, deg in trajectory]):.2f} deg rmse"
    )
    print(f"  map        {rms([cm for cm, _ in places]):.2f} cm, {rms([deg for _, deg in places]):.2f} deg rmse")
    print(f"  map        mean NEES {np.mean([nees_of(m, true) for m, true in known if m.id != anchor.id]):.1f} of 3")
    print(f"  contradicted {[c.id.code for c in survey.contradicted]}, unplaced {survey.unplaced}")
    drive = track_images(frames, rig, mounted, MotionModel(*wheels))
    times = [frame.time_s for frame in frames]
    tracked = [
        off(pose, poses[times.index(time_s)] @ T_base_left.inverse())
        for time_s, pose in zip(drive.times_s.tolist(), drive.poses, strict=True)
    ]
    print(f"track by the true map: {len(tracked)} frames")
    print(f"  trajectory {rms([cm for cm, _ in tracked]):.2f} cm, {rms([deg for _, deg in tracked]):.2f} deg rmse")
    live = track_images_live(frames, rig, mounted, *wheels)
    errors, nees = [], []
    for time_s, pose, C in zip(live.times_s.tolist(), live.poses, live.covariances, strict=True):
        true = poses[times.index(time_s)] @ T_base_left.inverse()
        place = np.append(pose.t[:2] - true.t[:2], rotation_log(pose.R @ true.R.T)[2])
        errors.append((100 * float(np.hypot(*place[:2])), float(np.rad2deg(abs(place[2])))))
        nees.append(place @ np.linalg.solve(C[np.ix_((0, 1, 5), (0, 1, 5))], place))
    print(f"track live, in the plane: {len(errors)} frames, {len(live.remarks)} restarts")
    print(
        f"  trajectory {rms([cm for cm, _ in errors]):.2f} cm, {rms([deg for _, deg in errors]):.2f} deg rmse, "
        f"mean NEES {np.mean(nees):.1f} of 3"
    )


if __name__ == "__main__":
    main(Path(sys.argv[1]))
