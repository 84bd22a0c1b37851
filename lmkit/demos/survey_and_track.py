"""A simulated recording: the map is surveyed from the first half, and the robot is tracked in the second half."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lmkit.errors import InputError
from lmkit.geometry.planar import follow
from lmkit.geometry.rotations import rotation_angle
from lmkit.geometry.stereo_rig import ahead_of
from lmkit.io.files import write_file
from lmkit.io.landmark_map import map_to_yaml
from lmkit.io.recording_tables import detections_to_csv, gyro_to_csv, odometry_to_csv
from lmkit.io.rig import rig_to_yaml
from lmkit.io.trajectory import poses_to_tum
from lmkit.mapping.bundle_adjustment import Anchor
from lmkit.mapping.survey import survey_frames
from lmkit.mapping.survey_results import Survey
from lmkit.model.landmark_map import LandmarkMap
from lmkit.model.recording import RigFrame
from lmkit.model.tracked_trajectory import TrackedTrajectory
from lmkit.odometry.wheel_odometry import MotionModel
from lmkit.simulation.recording import Drive, WheelErrors, make_drive
from lmkit.tracking.batch import track_images
from lmkit.tracking.online import track_live
from lmkit.visualization.plan_view import Found, draw_plan

SECONDS = 120.0
DRAWN = 40


@dataclass(frozen=True)
class DriveErrors:
    """Root mean squares.

    Attributes:
        landmarks, contradicted: number of surveyed landmarks, and of contradicted ones.
        map_mm, map_deg: errors of the surveyed landmarks.
        smooth_mm, smooth_deg: errors of the robot, tracked with images after the recording.
        live_mm, live_deg: errors with ranges and bearings while driving, in the plane; None if never located.
        wheels_mm: error of wheel odometry alone at the end.
    """

    landmarks: int
    contradicted: int
    map_mm: float
    map_deg: float
    smooth_mm: float
    smooth_deg: float
    live_mm: float | None
    live_deg: float | None
    wheels_mm: float


def run_drive_demo(folder: Path, seed: int, count: int) -> DriveErrors:
    """Drive, survey, track, and compare with the truth; everything is written into ``folder``."""
    drive = make_drive(seed, SECONDS, count=count, errors=WheelErrors(slips=1))
    half = len(drive.frames) // 2
    survey = _survey(drive, drive.frames[:half])
    late = drive.frames[half:]
    smooth = track_images(late, drive.rig, survey.landmarks, MotionModel(drive.odometry, drive.gyro))
    live = track_live(drive.readings(seed)[half:], drive.odometry, drive.gyro, survey.landmarks)
    _write(folder, drive, survey, smooth)
    true = [m for found in survey.landmarks if (m := drive.landmarks.find(found.id)) is not None]
    off = [
        (
            float(np.linalg.norm(a.T_map_landmark.t - b.T_map_landmark.t)),
            rotation_angle(a.T_map_landmark.R.T @ b.T_map_landmark.R),
        )
        for a, b in zip(survey.landmarks, true, strict=True)
    ]
    motion = MotionModel(drive.odometry, drive.gyro)
    turned = motion.increments(drive.times_s[half:], np.array([1.0, 1.0, 0.0, 0.0, 0.0, 0.0])).motions
    end = follow(drive.truth[half], turned)[-1]
    smooth_off, live_off = _off(drive, smooth), _off(drive, live)
    return DriveErrors(
        len(survey.landmarks),
        len(survey.contradicted),
        1000 * _rms([place for place, _ in off]),
        float(np.rad2deg(_rms([turn for _, turn in off]))),
        1000 * _rms([place for place, _ in smooth_off]),
        float(np.rad2deg(_rms([turn for _, turn in smooth_off]))),
        1000 * _rms([place for place, _ in live_off]) if live_off else None,
        float(np.rad2deg(_rms([turn for _, turn in live_off]))) if live_off else None,
        1000 * float(np.linalg.norm(end[:2] - drive.truth[-1, :2])),
    )


def _survey(drive: Drive, frames: tuple[RigFrame, ...]) -> Survey:
    """The first landmark seen, whose pose is fixed."""
    sizes = {m.id: m.size_m for m in drive.landmarks}
    first = next((o for frame in frames for o in frame.seen[0]), None)
    if first is None:
        raise InputError(
            "nothing_seen",
            "the recording passes no landmark",
            "add landmarks (--landmarks 14), or choose another --seed",
        )
    anchor = drive.landmarks.find(first.id)
    assert anchor is not None
    motion = MotionModel(drive.odometry, drive.gyro)
    return survey_frames(frames, drive.rig, sizes, {first.id: Anchor(anchor, None)}, motion)


def _off(drive: Drive, tracked: TrackedTrajectory) -> list[tuple[float, float]]:
    """Meters and rad in the plane, of every pose."""
    answers = []
    for time_s, pose in zip(tracked.times_s, tracked.poses, strict=True):
        true = drive.pose(int(np.argmin(np.abs(drive.times_s - time_s))))
        answers.append((float(np.linalg.norm(pose.t - true.t)), rotation_angle(pose.R.T @ true.R)))
    return answers


def _rms(values: list[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _write(folder: Path, drive: Drive, survey: Survey, smooth: TrackedTrajectory) -> None:
    poses = list(zip(smooth.times_s.tolist(), smooth.poses, strict=True))
    truth = [(float(t), drive.pose(k)) for k, t in enumerate(drive.times_s)]
    step = 1 + len(smooth.poses) // DRAWN
    found = [
        Found(f"{smooth.times_s[k]:.0f} s", smooth.looking(k), smooth.covariances[k][:2, :2])
        for k in range(0, len(smooth.poses), step)
    ]
    true = [ahead_of(drive.pose(len(drive.frames) // 2 + k)) for k in range(0, len(smooth.poses), step)]
    for name, data in (
        ("rig.yaml", rig_to_yaml(drive.rig).encode()),
        ("true_map.yaml", map_to_yaml(drive.landmarks).encode()),
        ("map.yaml", map_to_yaml(survey.landmarks).encode()),
        ("detections.csv", detections_to_csv(drive.frames).encode()),
        ("odometry.csv", odometry_to_csv(drive.odometry).encode()),
        ("gyro.csv", gyro_to_csv(drive.gyro).encode()),
        ("trajectory.tum", poses_to_tum(poses).encode()),
        ("truth.tum", poses_to_tum(truth).encode()),
        (
            "plan.png",
            draw_plan(LandmarkMap(list(survey.landmarks)), found, true, title="Tracked by the surveyed map"),
        ),
    ):
        write_file(folder / name, data, True)
