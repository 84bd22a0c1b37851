"""Laws of rigid transforms."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from lmkit.geometry.pose import Pose
from lmkit.geometry.rotations import rotation_angle, rotation_exp, rotation_log

vectors = arrays(np.float64, 3, elements=st.floats(-3.0, 3.0, allow_nan=False))


@given(vectors, vectors, vectors)
def test_a_pose_and_its_inverse_undo_each_other(rvec, t, point):
    T = Pose.from_rvec("map", "camera", rvec, t)
    assert np.allclose(T.inverse().apply(T.apply(point)), point, atol=1e-9)
    assert np.allclose((T @ T.inverse()).R, np.eye(3), atol=1e-9)


@given(vectors, vectors, vectors, vectors, vectors)
def test_chaining_is_applying_one_after_the_other(r1, t1, r2, t2, point):
    T_a_b, T_b_c = Pose.from_rvec("a", "b", r1, t1), Pose.from_rvec("b", "c", r2, t2)
    assert np.allclose((T_a_b @ T_b_c).apply(point), T_a_b.apply(T_b_c.apply(point)), atol=1e-9)


@given(vectors)
def test_rotations_agree_with_scipy(rvec):
    R = rotation_exp(rvec)
    reference = Rotation.from_rotvec(rvec)
    assert np.allclose(R, reference.as_matrix(), atol=1e-9)
    assert np.allclose(rotation_exp(rotation_log(R)), R, atol=1e-7)
    assert rotation_angle(R) == pytest.approx(reference.magnitude(), abs=1e-7)


@given(vectors)
def test_quaternions_agree_with_scipy(rvec):
    T = Pose.from_rvec("a", "b", rvec, np.zeros(3))
    theirs = Rotation.from_rotvec(rvec).as_quat()
    assert np.allclose(np.outer(T.quaternion_xyzw, T.quaternion_xyzw), np.outer(theirs, theirs), atol=1e-7)
    assert np.allclose(Pose.from_quaternion("a", "b", [0, 0, 0], T.quaternion_xyzw).R, T.R, atol=1e-7)


def test_unlike_frames_do_not_chain():
    T_map_camera = Pose.identity("map", "camera")
    with pytest.raises(ValueError, match="does not chain"):
        T_map_camera @ T_map_camera


def test_a_mirror_is_no_rotation():
    with pytest.raises(ValueError, match="not a rotation"):
        Pose("a", "b", np.diag([1.0, 1.0, -1.0]), np.zeros(3))


def test_arrays_are_read_only():
    with pytest.raises(ValueError, match="read-only"):
        Pose.identity("a", "b").t[0] = 1.0
