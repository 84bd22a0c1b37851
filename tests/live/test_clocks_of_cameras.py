"""Cameras that do not expose together, in a live run."""

from __future__ import annotations

from dataclasses import replace
from itertools import islice

import numpy as np
import pytest

from lmkit.geometry.rig import with_time_offsets
from lmkit.live.estimators import ImageEstimator
from lmkit.live.exposures import Exposures
from lmkit.live.frame_group import FrameGroup
from lmkit.live.loop import LiveLoop, LoopSettings
from lmkit.live.motion import WHEELS, MotionRow
from lmkit.simulation.recording import T_BASE_LEFT, WheelErrors, make_drive
from lmkit.simulation.scene import make_rig

LATE_S = 0.09
EXACT = WheelErrors(1.0, 1.0, 0.1, 0.0, 0.0, gyro_bias=0.0, gyro_noise=0.0)


@pytest.fixture(scope="module")
def drive():
    """A recording without errors whose second camera exposes late."""
    rig = with_time_offsets(replace(make_rig(), T_base_left=T_BASE_LEFT), [LATE_S])
    return make_drive(5, 2.0, 10.0, 32, rig=rig, errors=EXACT, noise_px=0.02)


def test_stamps_and_offsets_say_when_a_camera_exposes(drive):
    exposures = Exposures(drive.rig)
    assert exposures.times(5.0, (5.0, 5.0)) == pytest.approx((5.0, 5.0 + LATE_S))
    # Transport takes 10 ms at times; 50 ms are a clock offset.
    assert exposures.times(5.0, (5.0, 5.01)) == pytest.approx((5.0, 5.0 + LATE_S))
    assert exposures.times(5.0, (5.0, 4.95)) == pytest.approx((5.0, 4.95 + LATE_S))
    assert Exposures(with_time_offsets(drive.rig, [0.0])).times(5.0, (5.0, 5.01)) == ()


def test_a_camera_is_left_out_while_nothing_says_how_the_rig_moves(drive):
    estimator, exposures = ImageEstimator(drive.rig, drive.landmarks), Exposures(drive.rig)
    assert exposures.carried(5.0, (5.0, 5.0 + LATE_S), estimator) == ((), frozenset([1]))
    assert exposures.carried(5.0, (), estimator) == ((), frozenset())


def run(drive, motion):
    """States of a live run, with the true poses."""
    loop, before = LiveLoop(drive.rig, drive.landmarks, LoopSettings(motion=motion)), -1.0
    o = drive.odometry
    for k, frame in enumerate(drive.frames):
        due = np.flatnonzero((before < o.times_s) & (o.times_s <= frame.time_s)) if motion == WHEELS else ()
        rows = tuple(MotionRow(WHEELS, o.times_s[r], (o.forward_m[r], o.turn_rad[r])) for r in due)
        group = FrameGroup(frame.time_s, (None, None), (frame.time_s,) * 2, rows, seen=frame.seen)
        yield loop.step(group), drive.pose(k), frame
        before = frame.time_s


def test_the_late_camera_is_left_out_at_first_and_then_carried(drive):
    """With the time of the frame, the late image contradicts the other one, and there is no pose."""
    for state, true, _ in islice(run(drive, "none"), 4):
        assert state.T_map_base is not None
        assert np.linalg.norm(state.T_map_base.t - true.t) < 0.02


def test_landmarks_are_expected_where_a_late_camera_sees_them(drive):
    far = []
    for state, _, frame in list(run(drive, WHEELS))[4:]:
        for view, seen in zip(state.views, frame.seen, strict=True):
            far += [np.abs(view.expected[d.id] - d.corners).max() for d in seen if d.id in view.expected]
    assert len(far) > 50
    assert np.quantile(far, 0.9) < 1.0


def test_the_motion_between_two_images_goes_on(drive):
    estimator = ImageEstimator(drive.rig, drive.landmarks)
    for k in (3, 4):
        estimator.observe(drive.times_s[k], (drive.frames[k].seen[0], ()))
    moved = estimator.carried(drive.times_s[4], drive.times_s[[3, 4, 5]])
    poses = [drive.pose(k) @ T_BASE_LEFT for k in (3, 4, 5)]
    for found, pose in zip(moved, poses, strict=True):
        true = poses[1].inverse() @ pose
        assert np.abs(found.t - true.t).max() < 2e-3
        assert np.abs(found.R - true.R).max() < 2e-3
