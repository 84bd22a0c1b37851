"""The HTML report of a tracked robot."""

from __future__ import annotations

import re

import numpy as np
import pytest

from lmkit.geometry.pose import Pose
from lmkit.model.landmark_map import LandmarkMap
from lmkit.model.pose_status import PoseStatus
from lmkit.model.tracked_trajectory import TrackedTrajectory
from lmkit.reports.recording import track_report


def tracked(sigmas: dict[str, float]) -> TrackedTrajectory:
    count = 5
    return TrackedTrajectory(
        np.arange(count) * 0.2,
        [Pose("map", "base", np.eye(3), np.array([0.1 * k, 0, 0])) for k in range(count)],
        np.tile(1e-4 * np.eye(6), (count, 1, 1)),
        [PoseStatus.OK] * count,
        [()] * count,
        parameters={"forward_scale": 0.98},
        nis=np.array([[2.0, 8]] * count),
        parameter_sigmas=sigmas,
    )


def test_the_bound_of_innovations_is_drawn():
    plot = track_report(tracked({}), LandmarkMap(())).split("Innovations")[1].split("Uncertainty")[0]
    assert re.search(r"<path d='M[^']+L[^']+' fill='none'", plot)


@pytest.mark.parametrize("sigmas", [{}, {"forward_scale": 0.003}])
def test_deviations_have_a_column_where_there_are_any(sigmas):
    errors = track_report(tracked(sigmas), LandmarkMap(())).split("Odometry errors")[1]
    assert ("±" in errors) == bool(sigmas)
