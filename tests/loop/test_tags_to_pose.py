"""AprilTags from simulated images to poses: detected, located, surveyed, tracked, and by a field layout of WPILib."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import lmkit
from lmkit.geometry.camera import CameraModel
from lmkit.io.external_maps import map_to_wpilib, read_any_map
from lmkit.io.marker_maps import MarkerDefaults
from lmkit.model.landmark_map import LandmarkMap
from lmkit.model.recording import Recording, RigFrame
from lmkit.model.square_marker import SQUARE_FAMILIES
from lmkit.simulation.quick_images import QuickCamera
from lmkit.simulation.scene import Scene, drive, make_rig, make_room

pytestmark = pytest.mark.slow
TAG, PAIRS = SQUARE_FAMILIES["tag36h11"], 12
RIG = make_rig((480, 360), 345.0)
Seen = list[tuple[lmkit.Detections, lmkit.Detections]]


@pytest.fixture(scope="module")
def room() -> Scene:
    return make_room(5, TAG, 12, size_m=(4.0, 3.0, 2.6))


@pytest.fixture(scope="module")
def poses(room: Scene) -> list[lmkit.Pose]:
    return drive(5, room, PAIRS)


@pytest.fixture(scope="module")
def seen(room: Scene, poses: list[lmkit.Pose]) -> Seen:
    """Detections of the left and the right image of every pair."""

    def taken(camera: CameraModel, seed: int, T_left_camera: lmkit.Pose) -> list[lmkit.Detections]:
        detector, photograph = lmkit.Detector("tag36h11", camera=camera), QuickCamera(room, camera, seed)
        places = (lmkit.Pose("camera", "camera", T_left_camera.R, T_left_camera.t) for _ in poses)
        return [detector.detect(photograph(T @ place)) for T, place in zip(poses, places, strict=True)]

    still = lmkit.Pose("camera", "camera", np.eye(3), np.zeros(3))
    return list(zip(taken(RIG.left, 1, still), taken(RIG.right, 2, RIG.T_right_left.inverse()), strict=True))


@pytest.fixture(scope="module")
def recording(seen: Seen) -> Recording:
    return Recording(tuple(RigFrame(0.5 * k, (tuple(a), tuple(b))) for k, (a, b) in enumerate(seen)))


def test_every_code_is_one_of_the_room(room: Scene, seen: Seen) -> None:
    codes = {d.id for pair in seen for detections in pair for d in detections}
    assert len(codes) >= 10
    assert codes <= {landmark.id for landmark in room.landmarks}


def test_images_to_poses(room: Scene, poses: list[lmkit.Pose], seen: Seen) -> None:
    estimates = [lmkit.locate(*pair, rig=RIG, landmarks=room.landmarks) for pair in seen]
    errors = [
        float(np.linalg.norm(estimate.T_map_camera.t - T.t))
        for estimate, T in zip(estimates, poses, strict=True)
        if estimate.status == "ok" and estimate.T_map_camera is not None
    ]
    assert len(errors) >= 0.6 * PAIRS
    assert np.median(errors) < 0.01
    assert max(errors) < 0.05


def test_field_layout_of_wpilib(tmp_path: Path, room: Scene, seen: Seen) -> None:
    (tmp_path / "field.json").write_text(map_to_wpilib(room.landmarks, (4.0, 3.0)))
    field = read_any_map(tmp_path / "field.json", MarkerDefaults("tag36h11", 0.18))
    pair = max(seen, key=lambda pair: len(pair[0]))
    own, by_field = (lmkit.locate(*pair, rig=RIG, landmarks=landmarks) for landmarks in (room.landmarks, field))
    assert own.status == by_field.status == "ok"
    assert own.T_map_camera is not None and by_field.T_map_camera is not None
    assert np.abs(own.T_map_camera.t - by_field.T_map_camera.t).max() < 1e-6


def test_map_and_trajectory(room: Scene, poses: list[lmkit.Pose], recording: Recording) -> None:
    known = LandmarkMap([mark for mark in room.landmarks if mark.id == recording.frames[0].detections[0].id])
    survey = lmkit.survey(recording, RIG, known=known)
    found = {mark.id: mark for mark in survey.landmarks}
    both = [(found[mark.id], mark) for mark in room.landmarks if mark.id in found]
    off = [np.linalg.norm(one.T_map_landmark.t - other.T_map_landmark.t) for one, other in both]
    assert len(off) >= 10
    assert np.median(off) < 0.03
    poor = {name for name, _, _ in survey.poorly_determined} | set(survey.ambiguous)
    assert all(one.id in poor for (one, _), distance in zip(both, off, strict=True) if distance > 0.1)
    tracked = lmkit.track(recording, RIG, room.landmarks)
    errors = [np.linalg.norm(seen.t - T.t) for seen, T in zip(tracked.poses, poses, strict=True)]
    assert np.median(errors) < 0.01
