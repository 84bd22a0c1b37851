"""Filters of cameras that do not expose together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lmkit.geometry.rig import with_time_offsets
from lmkit.geometry.rotations import rotation_log
from lmkit.simulation.recording import T_BASE_LEFT, make_drive
from lmkit.simulation.scene import make_rig
from lmkit.tracking.exposure_queue import ExposureQueue
from lmkit.tracking.planar_stereo_filter import RigFilter
from lmkit.tracking.spatial_stereo_filter import PoseFilter

LATE_S = 0.09


@pytest.fixture(scope="module")
def late():
    """A recording whose second camera exposes later, and the rig without that offset."""
    rig = replace(make_rig(), T_base_left=T_BASE_LEFT)
    return make_drive(5, 10.0, 10.0, rig=with_time_offsets(rig, [LATE_S])), rig


def test_wheels_carry_a_late_camera_with_their_noise(late):
    drive, rig = late
    tracker, rows, squared = RigFilter(drive.landmarks, rig), 0, []
    o = drive.odometry
    for frame, true in zip(drive.frames, drive.truth, strict=True):
        while rows < len(o.times_s) and o.times_s[rows] <= frame.time_s:
            tracker.wheels.add_odometry(o.times_s[rows], o.forward_m[rows], o.turn_rad[rows])
            rows += 1
        answer = tracker.observe(frame.time_s, frame.seen, (frame.time_s, frame.time_s + LATE_S))
        if answer.state is not None and frame.time_s > drive.times_s[0] + 3:
            d = answer.state - true
            d[2] = np.angle(np.exp(1j * d[2]))
            squared.append(d @ np.linalg.solve(answer.covariance, d))
    assert len(squared) > 40
    # Carried without noise, the mean is over 40.
    assert np.mean(squared) < 4


def test_odometry_carries_a_late_camera_with_its_noise(late):
    drive, rig = late
    tracker, odometry, squared = PoseFilter(drive.landmarks, rig), drive.visual_odometry(3), []
    for k, frame in enumerate(drive.frames):
        tracker.add_odometry(float(odometry.times_s[k]), odometry.pose(k, "odometry", "base"))
        answer = tracker.observe(frame.time_s, frame.seen, (frame.time_s, frame.time_s + LATE_S))
        if answer.T_map_left is not None and frame.time_s > drive.times_s[0] + 3:
            true = drive.pose(k) @ T_BASE_LEFT
            d = np.append(answer.T_map_left.t - true.t, rotation_log(answer.T_map_left.R @ true.R.T))
            squared.append(d @ np.linalg.solve(answer.covariance, d))
    assert len(squared) > 40
    assert np.mean(squared) < 8


def test_exposures_are_taken_in_their_order():
    queue = ExposureQueue()
    assert queue.due(1.0, (["a"], ["b"])) == [(1.0, [["a"], ["b"]])]
    assert queue.due(2.0, (["c"], ["d"]), (2.0, 2.3)) == [(2.0, [["c"], ()])]
    assert queue.due(3.0, (["e"], ["f"]), (3.00001, 2.9)) == [
        (2.3, [(), ["d"]]),
        (2.9, [(), ["f"]]),
        (3.0, [["e"], ()]),
    ]
    assert queue.due(4.0, ([], ["g"]), (4.0, 4.1)) == []
    queue.clear()
    assert queue.due(5.0, ([], [])) == []
