"""`lmkit demo --navigate`: landmarks planned and printed, and a simulated robot that drives through rooms by them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from lmkit.arrays import ByteArray, FloatArray
from lmkit.geometry.planar import planar_pose, wrap_heading
from lmkit.geometry.stereo_rig import StereoRig
from lmkit.io.files import write_file
from lmkit.io.floor_plan import read_floor
from lmkit.io.landmark_map import map_to_yaml
from lmkit.io.rig import rig_to_yaml
from lmkit.io.trajectory import poses_to_tum
from lmkit.localization.absolute_pose import locate_rig
from lmkit.localization.correspondences import CORNER_FLOOR_PX
from lmkit.model.floor_plan import FloorPlan
from lmkit.model.landmark import LM8
from lmkit.model.landmark_map import LandmarkMap
from lmkit.model.pose_status import PoseStatus
from lmkit.navigation.navigator import Journey, Site, drive_to
from lmkit.pipelines.rendered_cameras import RenderedCameras
from lmkit.planning.coverage import Demand, predict_coverage
from lmkit.planning.mounting_plan import mounting_csv, sheets_to_print
from lmkit.planning.mounting_sites import MountingOptions
from lmkit.planning.placement import Placement, place_landmarks
from lmkit.planning.route import Goal, find_goal
from lmkit.reports.planning import draw_coverage
from lmkit.simulation.recording import T_BASE_LEFT, WheelErrors
from lmkit.simulation.robot import SimulatedRobot
from lmkit.simulation.scene import Scene, floor_scene, make_rig
from lmkit.tracking.range_bearing_filter import TrackedPose
from lmkit.visualization.floor_layer import floor_underlay, wall_notes
from lmkit.visualization.overlay import draw_landmarks, encode_jpeg
from lmkit.visualization.plan_view import BLUE, GREEN, ORANGE, Note, Polyline, draw_plan

FLOOR = """format: lmkit-floor/1
walls:
  - {from: [0, 0], to: [10, 0]}
  - {from: [10, 0], to: [10, 7]}
  - {from: [10, 7], to: [0, 7]}
  - {from: [0, 7], to: [0, 0]}
  - {from: [0, 4.2], to: [3.5, 4.2]}
  - {from: [4.7, 4.2], to: [10, 4.2]}
  - {from: [5.5, 0], to: [5.5, 2.6]}
places:
  dock: {position: [1.2, 1.2], heading_deg: 180}
  bench: {position: [8.6, 1.4], heading_deg: 0}
  shelf: {position: [8.4, 5.8], heading_deg: 90}
"""
LEGS = (("dock", "bench"), ("bench", "shelf"), ("shelf", "dock"))
RADIUS_M = 0.25
BOX_AT, BOX_RADIUS_M = (5.0, 3.45), 0.2  # obstacle on the second leg, not on the plan
PLACES = 6
STRIP_WIDTH_PX = 480

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class Leg:
    """One leg between two places, and the true pose at its end."""

    name: str
    status: str
    why: str
    way_m: float
    seconds: float
    off_mm: float
    off_deg: float


@dataclass(frozen=True)
class NavigateResult:
    """Result of the demo.

    Attributes:
        landmarks, share: number of placed landmarks, and share of the floor that meets the requirement.
        inside: share of steps with the truth inside the 95 % ellipse.
        images, located, image_error_mm: places photographed, located from detection, and their median error.
    """

    landmarks: int
    share: float
    legs: tuple[Leg, ...]
    inside: float
    images: int
    located: int
    image_error_mm: float | None


def run_navigate_demo(folder: Path, seed: int, from_images: bool, tell: Progress) -> NavigateResult:
    """Plan, print, drive three legs (with a box on the second), and write the results.

    Args:
        from_images: render the cameras' images for the detector; else simulate corners.
    """
    rig = replace(make_rig(), T_base_left=T_BASE_LEFT)
    write_file(folder / "floor.yaml", FLOOR, True)
    write_file(folder / "rig.yaml", rig_to_yaml(rig), True)
    floor, demand = read_floor(folder / "floor.yaml"), Demand()
    tell("placing", 0, 1)
    placement = place_landmarks(floor, [], rig, RADIUS_M, demand, MountingOptions(LM8.name))
    tell("placing", 1, 1)
    write_file(folder / "landmarks.pdf", sheets_to_print(placement), True)
    write_file(folder / "map.yaml", map_to_yaml(placement.landmarks), True)
    write_file(folder / "mounting.csv", mounting_csv(placement), True)
    coverage = predict_coverage(floor, list(placement.landmarks), rig, RADIUS_M)
    # Simulated corners have no errors of lens and paper, so the error floor is not needed.
    floor_px = CORNER_FLOOR_PX if from_images else 0.0
    scene = floor_scene(seed, floor, placement.landmarks)
    site = Site(floor, placement.landmarks, rig, RADIUS_M, demand, coverage, corner_floor_px=floor_px)
    boxed = floor.blocked(np.array([BOX_AT]), BOX_RADIUS_M)
    x, y, heading = floor.places[LEGS[0][0]]
    start = np.array([x, y, heading])
    legs: list[Leg] = []
    truth: list[FloatArray] = []
    believed: list[TrackedPose] = []
    inside: list[bool] = []
    for number, (a, b) in enumerate(LEGS):
        tell("driving", number, len(LEGS))
        errors = WheelErrors(slips=2, delay_s=0.1)
        ground = boxed if number == 1 else floor
        cameras = RenderedCameras(scene, rig, seed + number) if from_images else None
        robot = SimulatedRobot(ground, placement.landmarks, rig, start, RADIUS_M, errors, seed + number, cameras)

        def note(pose: TrackedPose, robot: SimulatedRobot = robot) -> None:
            if pose.state is None or pose.covariance is None:
                return
            truth.append(robot.seen_from.copy())
            believed.append(pose)
            off = pose.state[:2] - robot.seen_from[:2]
            inside.append(bool(off @ np.linalg.solve(pose.covariance[:2, :2], off) < 5.991))

        goal = find_goal(b, floor, placement.landmarks, RADIUS_M)
        first = len(truth)
        journey = drive_to(robot, site, goal, on_pose=note)
        legs.append(_leg(f"{a} to {b}", journey, robot, goal, truth[first:]))
        start = robot.state
    tell("driving", len(LEGS), len(LEGS))
    strip, located, off_mm = _photograph(seed, scene, placement.landmarks, rig, truth, tell)
    write_file(folder / "strip.jpg", encode_jpeg(strip), True)
    _draw(folder, floor, placement, truth, believed)
    poses = [(0.2 * k, planar_pose(pose.state)) for k, pose in enumerate(believed) if pose.state is not None]
    write_file(folder / "believed.tum", poses_to_tum(poses), True)
    write_file(folder / "truth.tum", poses_to_tum([(0.2 * k, planar_pose(s)) for k, s in enumerate(truth)]), True)
    return NavigateResult(
        len(placement.mounts),
        placement.share,
        tuple(legs),
        float(np.mean(inside)),
        PLACES,
        located,
        float(np.median(off_mm)) if off_mm else None,
    )


def _leg(name: str, journey: Journey, robot: SimulatedRobot, goal: Goal, truth: Sequence[FloatArray]) -> Leg:
    way = float(np.linalg.norm(np.diff(np.array(truth)[:, :2], axis=0), axis=1).sum())
    off = float(np.hypot(goal.x_m - robot.state[0], goal.y_m - robot.state[1]))
    turn = 0.0 if goal.heading_rad is None else robot.state[2] - goal.heading_rad
    off_deg = float(np.rad2deg(abs(wrap_heading(turn))))
    why = "ran into something" if robot.touched else journey.why
    return Leg(name, journey.status, why, way, robot.time_s, 1000 * off, off_deg)


def _photograph(
    seed: int, scene: Scene, landmarks: LandmarkMap, rig: StereoRig, truth: Sequence[FloatArray], tell: Progress
) -> tuple[ByteArray, int, list[float]]:
    """Images along the way, located from detection: the video strip, the number located, and errors in mm."""
    cameras = RenderedCameras(scene, rig, seed)
    frames, off_mm = [], []
    rows = np.linspace(0, len(truth) - 1, PLACES + 2).astype(int)[1:-1]
    for number, k in enumerate(rows):
        tell("photographing", number, PLACES)
        T_map_base = planar_pose(truth[k])
        image, seen = cameras.look(T_map_base)
        found = locate_rig(seen, rig, landmarks)
        if found.status == PoseStatus.OK and found.T_map_camera is not None:
            off_mm.append(1000 * float(np.linalg.norm(found.T_map_camera.t - (T_map_base @ T_BASE_LEFT).t)))
        frame = draw_landmarks(image, seen[0])
        scale = STRIP_WIDTH_PX / frame.shape[1]
        frames.append(cv2.resize(frame, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA))
    tell("photographing", PLACES, PLACES)
    upper, lower = np.hstack(frames[: PLACES // 2]), np.hstack(frames[PLACES // 2 :])
    return np.asarray(np.vstack([upper, lower])), len(off_mm), off_mm


def _draw(
    folder: Path, floor: FloorPlan, placement: Placement, truth: Sequence[FloatArray], believed: Sequence[TrackedPose]
) -> None:
    polylines = [
        Polyline(np.array(truth)[:, :2], GREEN, "true path", 6),
        Polyline(
            np.array([pose.state[:2] for pose in believed if pose.state is not None]), ORANGE, "believed path", 2
        ),
    ]
    notes = [*wall_notes(floor), *(Note(name, (x, y - 0.25)) for name, (x, y, _) in floor.places.items())]
    notes.append(Note("box", BOX_AT))
    plan = draw_plan(
        placement.landmarks,
        [],
        title="Driven by landmarks: true and believed path; the box is on no plan",
        underlay=floor_underlay(floor),
        polylines=[*polylines, _circle(BOX_AT, BOX_RADIUS_M)],
        notes=notes,
    )
    write_file(folder / "plan.png", plan, True)
    drawn = draw_coverage(floor, placement.landmarks, placement.coverage, Demand())
    write_file(folder / "coverage.png", drawn, True)


def _circle(at: tuple[float, float], radius_m: float) -> Polyline:
    turns = np.linspace(0, 2 * np.pi, 48)
    return Polyline(
        np.array(at) + radius_m * np.column_stack([np.cos(turns), np.sin(turns)]), BLUE, "box in the way", 3
    )
