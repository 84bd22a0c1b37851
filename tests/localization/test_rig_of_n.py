"""One pose from one to five cameras, whether or not they share a view."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lmkit.errors import InputError
from lmkit.geometry.pose import Pose
from lmkit.geometry.rig import MountedCamera, Rig, T_map_cameras, mounted_cameras
from lmkit.geometry.stereo_rig import mounted_ahead
from lmkit.localization.absolute_pose import locate_rig
from lmkit.mapping.survey import anchors_of, landmark_sizes, survey_frames
from lmkit.model.landmark_map import LandmarkMap, wall_pose
from lmkit.odometry.wheel_odometry import MotionModel
from lmkit.simulation.observations import look
from lmkit.simulation.recording import make_drive
from lmkit.simulation.scene import make_rig
from lmkit.tracking.batch import track_images
from lmkit.tracking.online import track_images_live

CAMERA = make_rig().left
AROUND = LandmarkMap(
    [
        replace(m, T_map_landmark=wall_pose([2.2 * np.cos(a), 2.2 * np.sin(a), 0.9 + 0.1 * k], a + np.pi))
        for k, (m, a) in enumerate(
            zip(make_drive(0, seconds=2).landmarks, np.deg2rad(np.arange(0, 360, 30)), strict=False)
        )
    ]
)


def ring(count: int) -> Rig:
    """Cameras that look outward all around; of five no two share a view of 60 deg."""
    out = Pose("base", "base", np.eye(3), np.array([0.2, 0.0, 0.0])) @ mounted_ahead(0.9)
    turns = [np.array([0, 0, 2 * np.pi * k / count]) for k in range(count)]
    places = [Pose.from_rvec("base", "base", turn, np.zeros(3)) @ out for turn in turns]
    cameras = [MountedCamera("cam0", CAMERA, Pose.identity("camera", "left"))]
    cameras += [MountedCamera(f"cam{k}", CAMERA, _between(places[k], places[0])) for k in range(1, count)]
    return Rig(tuple(cameras), places[0])


def _between(T_base_camera: Pose, T_base_left: Pose) -> Pose:
    T = T_base_camera.inverse() @ T_base_left
    return Pose("camera", "left", T.R, T.t)


def seen_by(rig: Rig, noise_px: float = 0.1):
    T_map_base = Pose.from_rvec("map", "base", np.array([0, 0, 0.3]), np.array([0.1, -0.2, 0.0]))
    return T_map_base, look(AROUND, rig, T_map_base, noise_px, np.random.default_rng(1))


@pytest.mark.parametrize("count", [1, 2, 3, 5])
def test_one_pose_from_all_cameras(count):
    rig = ring(count)
    T_map_base, seen = seen_by(rig)
    estimate = locate_rig(seen, rig, AROUND)
    assert estimate.status == "ok"
    assert np.linalg.norm(estimate.T_map_camera.t - (T_map_base @ rig.T_base_left).t) < 0.02


def test_every_camera_has_its_place_in_the_map():
    rig = ring(4)
    T_map_base = Pose("map", "base", np.eye(3), np.zeros(3))
    for k, T in enumerate(T_map_cameras(rig, T_map_base @ rig.T_base_left)):
        ahead = np.array([np.cos(np.pi / 2 * k), np.sin(np.pi / 2 * k), 0.0])
        assert np.allclose(T.R[:, 2], ahead, atol=1e-9)
        assert np.allclose(T.t - rig.T_base_left.t, 0.2 * (ahead - [1.0, 0.0, 0.0]), atol=1e-9)


def test_more_cameras_know_the_place_better():
    sigmas = [locate_rig(seen_by(ring(count))[1], ring(count), AROUND).sigma_m for count in (1, 5)]
    assert sigmas[1] < 0.5 * sigmas[0]


def with_one_turned(rig, k):
    """The rig with camera k turned by 0.2 rad."""
    turn = Pose.from_rvec("camera", "camera", np.array([0.0, 0.2, 0.0]), np.zeros(3))
    moved = replace(rig.cameras[k], T_camera_left=turn @ rig.cameras[k].T_camera_left)
    return replace(rig, cameras=(*rig.cameras[:k], moved, *rig.cameras[k + 1 :]))


def test_a_camera_that_was_moved_is_named_and_left_out():
    rig = ring(5)
    _, seen = seen_by(rig)
    estimate = locate_rig(seen, with_one_turned(rig, 2), AROUND)
    assert estimate.status == "ok"
    assert estimate.outlier_cameras == ("cam2",)
    assert seen[2]
    assert {d.id for d in seen[2]} <= set(estimate.outliers)
    T_map_base, _ = seen_by(rig)
    assert np.linalg.norm(estimate.T_map_camera.t - (T_map_base @ rig.T_base_left).t) < 0.02


def test_of_two_cameras_that_disagree_neither_is_believed():
    rig = ring(2)
    _, seen = seen_by(rig)
    estimate = locate_rig(seen, with_one_turned(rig, 1), AROUND)
    assert estimate.status == "inconsistent"
    assert estimate.outlier_cameras == ()


def test_a_stereo_pair_gives_the_same_as_a_rig_of_two():
    stereo = make_rig()
    rig = Rig(mounted_cameras(stereo))
    drive = make_drive(1, seconds=4)
    for frame in drive.frames[:5]:
        one, other = (locate_rig(frame.seen, r, drive.landmarks) for r in (stereo, rig))
        assert one.status == other.status
        if one.T_map_camera is not None:
            assert np.array_equal(one.T_map_camera.t, other.T_map_camera.t)


def test_as_many_images_as_cameras_are_asked_for():
    with pytest.raises(InputError, match="2 images for a rig of 3 cameras"):
        locate_rig([[], []], ring(3), AROUND)


@pytest.mark.slow
@pytest.mark.parametrize("count", [pytest.param(1, marks=pytest.mark.slow), 3])
def test_survey_and_track_with_one_camera_and_with_three(count):
    """Scale comes from the landmarks' size, and from the wheels."""
    drive = make_drive(2, seconds=40, rig=ring(count))
    first = next(d.id for frame in drive.frames for d in frame.detections)
    anchors = anchors_of(LandmarkMap([drive.landmarks.find(first)]))
    motion = MotionModel(drive.odometry, drive.gyro)
    frames = list(drive.frames)
    result = survey_frames(frames, drive.rig, landmark_sizes(frames, 0.18, anchors), anchors, motion)
    off = [np.linalg.norm(m.T_map_landmark.t - drive.landmarks.find(m.id).T_map_landmark.t) for m in result.landmarks]
    assert len(off) > 8
    assert np.median(off) < 0.06
    for tracked in (
        track_images(frames, drive.rig, drive.landmarks, motion),
        track_images_live(frames, drive.rig, drive.landmarks, drive.odometry, drive.gyro),
    ):
        rows = np.searchsorted(drive.times_s, tracked.times_s)
        truth = np.array([drive.pose(int(k)).t for k in rows])
        assert np.median(np.linalg.norm(tracked.positions - truth, axis=1)) < 0.03
