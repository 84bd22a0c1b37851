"""Laws of rotations by leading axes, and of many poses at once; single poses are the reference."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from lmkit.geometry.pose import Pose
from lmkit.geometry.pose_array import PoseArray, moved_covariance
from lmkit.geometry.rotations import matrix_to_quaternion, quaternion_to_matrix, rotation_exp, rotation_log, skew

ROWS = arrays(np.float64, (3, 6), elements=st.floats(-3.0, 3.0, allow_nan=False))


def listed(rows: np.ndarray, to_frame: str, from_frame: str) -> list[Pose]:
    return [Pose.from_rvec(to_frame, from_frame, row[3:], row[:3]) for row in rows]


@given(ROWS)
def test_rotations_by_leading_axes_are_those_of_single_vectors(rows):
    vectors = rows[:, 3:].reshape(3, 1, 3)
    R = rotation_exp(vectors)
    assert R.shape == (3, 1, 3, 3)
    assert R[:, 0] == pytest.approx(np.array([rotation_exp(v) for v in vectors[:, 0]]), abs=1e-12)
    assert rotation_log(R)[:, 0] == pytest.approx(np.array([rotation_log(one) for one in R[:, 0]]), abs=1e-9)
    quaternions = np.array([matrix_to_quaternion(one) for one in R[:, 0]])
    assert quaternion_to_matrix(quaternions) == pytest.approx(R[:, 0], abs=1e-9)
    assert (skew(vectors[:, 0]) @ rows[:, :3, None])[..., 0] == pytest.approx(np.cross(rows[:, 3:], rows[:, :3]))


def test_rotation_vectors_survive_the_smallest_and_the_largest_angles():
    axis = np.array([0.6, -0.48, 0.64])
    angles = np.array([0.0, 1e-13, 1e-9, 1e-4, np.pi / 2, np.pi - 1e-9, np.pi - 1e-4])
    vectors = angles[:, None] * axis
    assert rotation_log(rotation_exp(vectors)) == pytest.approx(vectors, abs=1e-8)


@given(ROWS, ROWS)
def test_many_poses_chain_invert_and_apply_as_single_ones_do(first, second):
    A, B = listed(first, "a", "b"), listed(second, "b", "c")
    many_A, many_B = PoseArray.from_poses("a", "b", A), PoseArray.from_poses("b", "c", B)
    points = second[:2, :3]
    for k in range(3):
        assert (many_A @ many_B).pose(k).matrix == pytest.approx((A[k] @ B[k]).matrix, abs=1e-9)
        assert (many_A @ B[0]).pose(k).matrix == pytest.approx((A[k] @ B[0]).matrix, abs=1e-9)
        assert many_A.inverse().pose(k).matrix == pytest.approx(A[k].inverse().matrix, abs=1e-9)
        assert many_A.apply(points)[k] == pytest.approx(A[k].apply(points), abs=1e-9)
        step = second[k]
        moved = Pose.from_rvec("a", "b", rotation_log(rotation_exp(step[3:]) @ A[k].R), A[k].t + step[:3])
        assert many_A.retract(second).pose(k).matrix == pytest.approx(moved.matrix, abs=1e-6)


def test_poses_of_other_frames_are_refused():
    many = PoseArray.from_poses("map", "left", [Pose.identity("map", "left")])
    with pytest.raises(ValueError, match="does not chain"):
        many @ Pose.identity("right", "base")
    with pytest.raises(ValueError, match="not T_map_left"):
        PoseArray.from_poses("map", "left", [Pose.identity("map", "base")])
    assert len(PoseArray.from_poses("map", "left", [])) == 0


@given(ROWS, ROWS)
def test_a_covariance_moved_to_another_point_is_that_of_moved_samples(rows, offsets):
    """To first order, a step of the pose moves the point by its shift plus rotation x offset."""
    steps = np.column_stack([rows[:, :3] + np.cross(rows[:, 3:], offsets[0, :3]), rows[:, 3:]])
    moved = moved_covariance(rows.T @ rows, offsets[0, :3])
    assert moved == pytest.approx(steps.T @ steps, abs=1e-9)
    batch = moved_covariance(np.tile(rows.T @ rows, (3, 1, 1)), np.tile(offsets[0, :3], (3, 1)))
    assert batch[2] == pytest.approx(moved, abs=1e-9)
