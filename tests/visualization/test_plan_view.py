"""Drawings from above: how much ellipses are enlarged."""

import numpy as np
import pytest

from lmkit.visualization.plan_view import _gain

PX_PER_M, LARGEST_PX = 50.0, 80.0


@pytest.mark.parametrize(
    ("pose_m", "poses", "landmark_m", "landmarks", "gain"),
    [(0.001, 600, 0.001, 14, 100), (0.001, 600, 0.02, 14, 10), (0.05, 5, 0.0, 0, 1), (0.0, 0, 0.0, 0, 1)],
)
def test_ellipses_are_seen_and_those_of_few_landmarks_do_not_hide_the_room(
    pose_m, poses, landmark_m, landmarks, gain
):
    of_poses, of_landmarks = [pose_m**2 * np.eye(2)] * poses, [landmark_m**2 * np.eye(2)] * landmarks
    assert _gain(of_poses, of_landmarks, PX_PER_M, LARGEST_PX) == gain
