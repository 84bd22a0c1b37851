"""Declared walls and heights: their equations, what they determine, and landmarks that violate them."""

from dataclasses import replace

import numpy as np
import pytest
from ids import lm8
from scipy.spatial.transform import Rotation

from lmkit.geometry.pose import Pose
from lmkit.mapping.bundle_adjustment import Anchor
from lmkit.mapping.survey import survey_frames
from lmkit.mapping.wall_constraints import LandmarkConstraint, constraint_rows, strays
from lmkit.odometry.wheel_odometry import MotionModel
from lmkit.simulation.observations import look
from lmkit.simulation.recording import make_drive

WALL = LandmarkConstraint("wall", tuple(map(lm8, (1, 2, 3))), 0.005, np.deg2rad(1.0))
HEIGHT = LandmarkConstraint("height", tuple(map(lm8, (1, 2, 3))), 0.005, np.deg2rad(1.0))


def crooked(seed=0):
    rng = np.random.default_rng(seed)
    R = Rotation.from_rotvec(0.2 * rng.normal(size=(3, 3)) + [np.pi / 2, 0, 0]).as_matrix()
    return R, rng.normal(size=(3, 3))


@pytest.mark.parametrize("constraint", [WALL, HEIGHT])
def test_derivatives_are_those_of_the_residuals(constraint):
    R, p = crooked()
    here = constraint_rows(constraint, [0, 1, 2], R, p)
    for landmark in range(3):
        for axis in range(6):
            step = np.zeros(6)
            step[axis] = 1e-6
            moved_p, moved_R = p.copy(), R.copy()
            moved_p[landmark] += step[:3]
            moved_R[landmark] = Rotation.from_rotvec(step[3:]).as_matrix() @ R[landmark]
            there = constraint_rows(constraint, [0, 1, 2], moved_R, moved_p)
            by = sum(
                np.where(here.pairs[:, side] == landmark, here.derivatives[:, 6 * side + axis], 0.0)
                for side in (0, 1)
            )
            assert by == pytest.approx((here.residuals - there.residuals) / 1e-6, abs=1e-3)


def test_a_wall_that_is_one_says_nothing_wherever_it_stands():
    rng = np.random.default_rng(1)
    T = Rotation.random(random_state=2)
    flat = np.column_stack([rng.normal(size=(4, 2)), np.zeros(4)])
    spun = [T * Rotation.from_rotvec([0, 0, angle]) for angle in rng.normal(size=4)]
    rows = constraint_rows(WALL, range(4), np.array([r.as_matrix() for r in spun]), T.apply(flat) + 3.0)
    assert rows.residuals == pytest.approx(0.0, abs=1e-9)
    off, _ = strays(WALL, range(4), np.array([r.as_matrix() for r in spun]), T.apply(flat) + 3.0, np.zeros((24, 24)))
    assert off == pytest.approx(0.0, abs=1e-9)


def test_one_off_the_plane_costs_what_its_deviation_says():
    # One of many is off by 2 sigma: a chi-square of about 4, robustly a little less.
    count = 12
    R = np.repeat(np.eye(3)[None], count, axis=0)
    p = np.column_stack([np.arange(count), np.zeros(count), np.zeros(count)]).astype(float)
    p[5, 2] = 2 * WALL.sigma_m
    assert 2.5 < constraint_rows(WALL, range(count), R, p).cost < 4.0


def along_a_wall(drive):
    """Codes seen on the wall with the most landmarks: those that face in the same direction."""
    walls, seen = {}, {o.id for frame in drive.frames for o in frame.seen[0]}
    for m in drive.landmarks:
        if m.id in seen:
            walls.setdefault(tuple(np.round(m.T_map_landmark.R[:, 2], 1)), []).append(m.id)
    return tuple(max(walls.values(), key=len))


def surveyed(drive, frames, constraints):
    seen = list(dict.fromkeys(o.id for frame in frames for o in frame.seen[0]))
    known = {seen[0]: Anchor(drive.landmarks.find(seen[0]), None)}
    sizes = {m.id: m.size_m for m in drive.landmarks}
    return survey_frames(frames, drive.rig, sizes, known, MotionModel(drive.odometry, drive.gyro), constraints)


def off_the_wall(drive, result, codes):
    """Root mean square distance of landmarks from their plane, and of their angle to its normal."""
    off, turned = [], []
    for code in codes:
        m, true = result.bundle.landmarks.find(code), drive.landmarks.find(code).T_map_landmark
        off.append((m.T_map_landmark.t - true.t) @ true.R[:, 2])
        turned.append(np.arccos(min(1.0, m.T_map_landmark.R[:, 2] @ true.R[:, 2])))
    return float(np.std(off)), float(np.sqrt(np.mean(np.square(turned))))


@pytest.mark.slow
def test_a_declared_wall_makes_the_map_flatter():
    plain, tied = [], []
    for seed in range(2):
        drive = make_drive(seed, seconds=15, noise_px=0.5)
        codes = along_a_wall(drive)
        plain.append(off_the_wall(drive, surveyed(drive, drive.frames, ()), codes))
        result = surveyed(drive, drive.frames, [LandmarkConstraint("wall", tuple(codes), 0.005, np.deg2rad(0.5))])
        assert not result.off_constraint
        tied.append(off_the_wall(drive, result, codes))
    assert np.mean(tied, axis=0)[0] < 0.8 * np.mean(plain, axis=0)[0]


@pytest.mark.slow
def test_landmarks_off_their_wall_are_named_and_distort_nothing():
    drive = make_drive(0, seconds=40, noise_px=0.1)
    codes = along_a_wall(drive)
    other = codes[len(codes) // 2]
    T = drive.landmarks.find(other).T_map_landmark
    out = Pose("map", "landmark", T.R, T.t + 0.1 * T.R[:, 2])
    mapped = type(drive.landmarks)([replace(m, T_map_landmark=out) if m.id == other else m for m in drive.landmarks])
    rng = np.random.default_rng(0)
    frames = [
        replace(m, seen=(left, right))
        for k, m in enumerate(drive.frames)
        for left, right in [look(mapped, drive.rig, drive.pose(k), 0.1, rng)]
    ]
    result = surveyed(
        replace(drive, landmarks=mapped), frames, [LandmarkConstraint("wall", tuple(codes), 0.003, np.deg2rad(0.5))]
    )
    assert [code for code, _, _ in result.off_constraint] == [other]
    assert result.off_constraint[0][2] == pytest.approx(0.1, abs=0.04)
    found = result.bundle.landmarks.find(other).T_map_landmark.t
    assert np.linalg.norm(found - out.t) < 0.03
