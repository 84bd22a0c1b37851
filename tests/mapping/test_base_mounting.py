"""Places of cameras on a robot, found by driving through a mapped room."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import run_command

import lmkit
from lmkit.errors import InputError
from lmkit.geometry.pose import Pose
from lmkit.geometry.rig import AnyRig, MountedCamera, Rig, mounted_cameras, with_time_offsets
from lmkit.geometry.rotations import rotation_exp, rotation_log
from lmkit.io.landmark_map import map_to_yaml
from lmkit.io.recording_tables import detections_to_csv
from lmkit.io.rig import read_rig, rig_to_yaml
from lmkit.mapping.base_mounting import BaseMounting, find_base_mounting
from lmkit.model.recording import Gyro, Odometry, Recording
from lmkit.odometry.wheel_odometry import MotionModel
from lmkit.simulation.recording import T_BASE_LEFT, Drive, WheelErrors, make_drive
from lmkit.simulation.scene import make_rig


def looking_around(seed: int, count: int) -> Rig:
    """Cameras in a ring, that share no view, tilted a little."""
    rng, model, places = np.random.default_rng([seed, 8]), make_rig().left, []
    for k in range(count):
        yaw = 2 * np.pi * k / count + rng.uniform(-0.2, 0.2)
        turn = rotation_exp(np.array([[0, 0, yaw], rng.normal(0, 0.05, 3)]))
        arm = np.array([0.15 * np.cos(yaw), 0.15 * np.sin(yaw), 0.8]) + rng.normal(0, 0.03, 3)
        places.append(Pose("base", "left", turn[0] @ turn[1] @ T_BASE_LEFT.R, arm))
    cameras = []
    for k, place in enumerate(places):
        T = place.inverse() @ places[0]
        own = Pose.identity("camera", "left") if k == 0 else Pose("camera", "left", T.R, T.t)
        cameras.append(MountedCamera(f"camera{k}", model, own))
    return Rig(tuple(cameras), places[0])


def drive(seed: int, rig: AnyRig, seconds: float = 40.0, eights: bool = True) -> Drive:
    return make_drive(seed, seconds=seconds, rig=rig, count=24, eights=eights, errors=WheelErrors(slips=seed % 2))


def found_in(made: Drive, height_m: float | None = None) -> BaseMounting:
    motion = MotionModel(made.odometry, made.gyro)
    return find_base_mounting(made.frames, made.rig, made.landmarks, motion, height_m)


def errors_of(found: BaseMounting, rig: AnyRig) -> np.ndarray:
    """(C,6) of places (m) and rotations (rad)."""
    assert rig.T_base_left is not None
    rows = []
    for camera, mounted in zip(found.cameras, mounted_cameras(rig), strict=False):
        T = rig.T_base_left @ mounted.T_camera_left.inverse()
        place = camera.T_base_camera
        rows.append([*(place.t - T.t), *rotation_log(place.R @ T.R.T)])
    return np.array(rows)


def test_a_camera_is_found_on_the_robot() -> None:
    rig = looking_around(0, 1)
    found = found_in(drive(4, rig), float(rig.T_base_left.t[2]))
    error = errors_of(found, rig)[0]
    assert np.abs(error[:3]).max() < 0.012 and np.abs(error[3:]).max() < np.deg2rad(0.1)
    assert found.rig.T_base_left is not None and not found.cameras[0].unobserved


@pytest.mark.slow
def test_a_stereo_pair_is_found_as_one_and_the_height_is_said_to_be_assumed() -> None:
    made = drive(1, replace(make_rig(), T_base_left=T_BASE_LEFT))
    found = found_in(made)
    assert np.abs(errors_of(found, made.rig)[0, :2]).max() < 0.012
    assert found.cameras[0].unobserved[0].startswith("height")
    assert found.cameras[0].covariance[2, 2] > 0.5


def test_rounds_in_one_direction_leave_the_place_along_y_open() -> None:
    rig = looking_around(4, 1)
    found = found_in(drive(4, rig, eights=False))
    sigma = np.sqrt(np.diag(found.cameras[0].covariance))
    assert sigma[1] > 0.01 and any("along y" in text for text in found.cameras[0].unobserved)
    # Noise of the wheels shifts it by more than two of the standard deviations that leave this shift out.
    assert abs(errors_of(found, rig)[0, 1]) < 1.96 * sigma[1]


def test_the_clock_of_a_camera_is_found_with_its_place() -> None:
    rig, late_s = looking_around(6, 2), 0.15
    found = found_in(replace(drive(6, with_time_offsets(rig, [late_s]), 14), rig=rig))
    clock = found.cameras[1].clock
    assert clock is not None and clock.differs
    assert abs(clock.offset_s - late_s) < min(4 * clock.sigma_s, 2e-3)
    assert found.rig.cameras[1].time_offset_s == clock.offset_s
    # If the time stamps were taken as right, the second camera would be off by 50 mm along x.
    assert np.abs(errors_of(found, rig)[:, 0]).max() < 0.004


def test_a_robot_that_stands_still_is_refused() -> None:
    made = drive(1, looking_around(0, 1), seconds=5)
    still = Odometry(
        made.odometry.times_s, np.zeros(len(made.odometry.times_s)), np.zeros(len(made.odometry.times_s))
    )
    with pytest.raises(InputError) as error:
        find_base_mounting(made.frames, made.rig, made.landmarks, MotionModel(still))
    assert error.value.code == "stands_still"


@pytest.mark.parametrize("calibrate", [lmkit.calibrate_base, lmkit.calibrate_clocks])
def test_a_gyro_in_degrees_is_named(calibrate) -> None:
    made = drive(2, looking_around(2, 2), seconds=10)
    gyro = Gyro(made.gyro.times_s, np.rad2deg(made.gyro.rate_radps))
    recording = Recording(made.frames, (), made.odometry, gyro)
    with pytest.raises(InputError, match="degrees per second"):
        calibrate(recording, made.rig, made.landmarks)


def test_the_command_writes_a_rig_with_every_place(tmp_path: Path) -> None:
    rig = looking_around(2, 2)
    made = drive(30, rig, seconds=18)
    names = [camera.name for camera in rig.cameras]
    (tmp_path / "drive").mkdir()
    (tmp_path / "drive/detections.csv").write_text(detections_to_csv(made.frames, names))
    o = made.odometry
    v = np.append(o.forward_m[1:], 0) / 0.02, np.append(o.turn_rad[1:], 0) / 0.02
    lines = [f"{t:.6f},{a:.9f},{b:.9f}" for t, a, b in zip(o.times_s, *v, strict=True)]
    (tmp_path / "drive/odometry.csv").write_text("\n".join(["time_s,forward_mps,turn_radps", *lines]) + "\n")
    (tmp_path / "map.yaml").write_text(map_to_yaml(made.landmarks))
    (tmp_path / "rig.yaml").write_text(rig_to_yaml(replace(rig, T_base_left=None)))
    at = ["--base", tmp_path / "drive", "--rig", tmp_path / "rig.yaml", "--map", tmp_path / "map.yaml"]
    answer = run_command("calibrate", *at, "-o", tmp_path / "out.yaml", "--json")
    assert answer.code == 0, answer.err
    assert [camera["name"] for camera in json.loads(answer.out)["cameras"]] == names
    written = read_rig(tmp_path / "out.yaml")
    assert [camera.time_offset_s for camera in written.cameras] == [0.0, 0.0]  # time stamps are right
    assert written.T_base_left.t[:2] == pytest.approx(rig.T_base_left.t[:2], abs=0.03)
    assert run_command("calibrate", "--base", tmp_path / "drive").code == 2


@pytest.mark.slow
def test_places_of_five_cameras_without_overlap_and_their_intervals() -> None:
    rows, scaled = [], []
    for seed in range(2):
        rig = looking_around(seed, 5)
        found = found_in(drive(seed, rig), float(rig.T_base_left.t[2]))
        errors = errors_of(found, rig)
        rows.append(errors)
        scaled += [e / np.sqrt(np.diag(c.covariance)) for e, c in zip(errors, found.cameras, strict=True)]
    rms = np.sqrt(np.mean(np.square(np.concatenate(rows)), axis=0))
    assert rms[:3].max() < 0.004 and rms[3:].max() < np.deg2rad(0.05)
    # The cameras of one robot have correlated errors, above all along y.
    assert np.mean(np.abs(scaled) < 1.96) > 0.85
