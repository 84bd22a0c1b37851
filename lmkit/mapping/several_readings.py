"""One planar map from several recordings of ranges and bearings: `survey_readings` of each, joined and adjusted.

Each recording is surveyed alone and aligned with the previous ones by shared landmarks, and all are adjusted
jointly by summing their information on landmarks (`joint_adjustment.py`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.errors import InputError
from lmkit.geometry.planar import planar_pose
from lmkit.localization.range_bearing_noise import DRIVE_NOISE
from lmkit.mapping.joint_adjustment import JointProblem
from lmkit.mapping.planar_smoother import PlanarProblem
from lmkit.mapping.range_bearing_survey import planar_map, planar_trajectory
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import LandmarkMap
from lmkit.model.recording import Odometry, Recording
from lmkit.model.tracked_trajectory import TrackedTrajectory
from lmkit.odometry.wheel_odometry import MotionModel

STEPS, CONVERGED = 40, 1e-5
LEAST_SHARED = 3  # landmarks that two recordings are joined by
FIT_M = 1.0  # a shared landmark farther off than that after joining does not count


@dataclass(frozen=True, eq=False)
class ReadingsSurvey:
    """The result.

    Attributes:
        landmarks: the map, at height 0; its origin is the first pose of the recording with the most landmarks.
        drives: the trajectory of every recording, by name.
        left_out: names of recordings that share too few landmarks with the others.
    """

    landmarks: LandmarkMap
    drives: Mapping[str, TrackedTrajectory]
    left_out: tuple[str, ...]


def survey_readings_together(recordings: Mapping[str, Recording], size_m: float) -> ReadingsSurvey:
    """Survey landmarks from several recordings of one place.

    Args:
        recordings: by name, with readings and wheel odometry.
        size_m: of the landmarks, meters; ranges do not determine it.

    Raises:
        InputError: no recordings, or one without readings or wheel odometry.
    """
    if not recordings:
        raise InputError("no_recordings", "no recordings are given", "give at least one, by its name")
    problems = {name: _surveyed(name, recording) for name, recording in recordings.items()}
    joined = _joined(problems)
    ids = sorted({id_ for name in joined for id_ in problems[name].ids})
    number = {id_: k for k, id_ in enumerate(ids)}
    places: FloatArray = np.full((len(ids), 3), np.nan)
    for name in reversed(joined):
        places[[number[id_] for id_ in problems[name].ids]] = problems[name].landmark_poses()[1]
    parts = [problems[name] for name in joined]
    rows = [np.array([number[id_] for id_ in part.ids]) for part in parts]
    joint = JointProblem(parts, rows, np.repeat(np.eye(3)[None], len(ids), axis=0), places)
    joint.optimize(STEPS, CONVERGED)
    C = joint.covariance()
    blocks = np.array([C[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] for k in range(len(ids))])
    middle = np.concatenate([part.states[:, :2] for part in parts]).mean(axis=0)
    drives = {}
    for name, part in zip(joined, parts, strict=True):
        track = part.answer()
        drives[name] = planar_trajectory(track.times_s, [planar_pose(s) for s in track.states], track.covariances)
    left_out = tuple(name for name in recordings if name not in joined)
    return ReadingsSurvey(planar_map(ids, joint.p[:, :2], blocks, middle, size_m), drives, left_out)


def _surveyed(name: str, recording: Recording) -> PlanarProblem:
    """One recording, surveyed alone; landmarks never read with both range and bearing are left out."""
    frames, odometry = recording.readings, recording.odometry
    if not frames or not isinstance(odometry, Odometry):
        raise InputError("no_readings", f"{name}: no readings, or no wheel odometry beside them", "give both")
    motion, times = MotionModel(odometry, recording.gyro), recording.times_s
    motion.require_overlap(times)
    full = {r.id for _, seen in frames for r in seen if r.range_m is not None and r.bearing_rad is not None}
    problem = PlanarProblem(
        times, [[r for r in seen if r.id in full] for _, seen in frames], motion, None, DRIVE_NOISE
    )
    problem.take_up()
    return problem


def _joined(problems: Mapping[str, PlanarProblem]) -> list[str]:
    """Names of the recordings that could be aligned, the one with most landmarks first."""
    left = sorted(problems, key=lambda name: -len(problems[name].ids))
    joined = [left.pop(0)]
    known = dict(zip(problems[joined[0]].ids, problems[joined[0]].places, strict=True))
    while left:
        name = max(left, key=lambda name: len(known.keys() & set(problems[name].ids)))
        problem = problems[name]
        left.remove(name)
        aligned = _alignment(problem.ids, problem.places, known)
        if aligned is None:
            continue
        problem.transform(*aligned)
        problem.holds_origin = False
        known = {**dict(zip(problem.ids, problem.places, strict=True)), **known}
        joined.append(name)
    return joined


def _alignment(
    ids: Sequence[LandmarkId], places: FloatArray, known: Mapping[LandmarkId, FloatArray]
) -> tuple[float, FloatArray] | None:
    """Rotation (rad) and shift (m) onto known landmarks, on which most shared landmarks agree."""
    rows = [k for k, id_ in enumerate(ids) if id_ in known]
    if len(rows) < LEAST_SHARED:
        return None
    a, b = places[rows], np.array([known[ids[k]] for k in rows])
    best: tuple[int, float, FloatArray] | None = None
    for i in range(len(rows)):
        for j in range(i + 1, len(rows)):
            turn, shift = _fitted(a[[i, j]], b[[i, j]])
            near = np.hypot(*(_moved(a, turn, shift) - b).T) < FIT_M
            if best is None or near.sum() > best[0]:
                best = (int(near.sum()), *_fitted(a[near], b[near])) if near.sum() > 1 else best
    return None if best is None or best[0] < LEAST_SHARED else best[1:]


def _moved(points: FloatArray, turn: float, shift: FloatArray) -> FloatArray:
    c, s = np.cos(turn), np.sin(turn)
    return np.asarray(points @ np.array([[c, s], [-s, c]]) + shift)


def _fitted(a: FloatArray, b: FloatArray) -> tuple[float, FloatArray]:
    """Rotation and shift that align points a (K,2) with b best."""
    p, q = a - a.mean(axis=0), b - b.mean(axis=0)
    turn = float(np.arctan2((p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]).sum(), (p * q).sum()))
    return turn, b.mean(axis=0) - _moved(a.mean(axis=0)[None], turn, np.zeros(2))[0]
