"""Cameras with clocks of their own: offsets found, and applied in tracking and surveys."""

import numpy as np
import pytest

from lmkit.demos.five_cameras import ring_of_cameras
from lmkit.errors import InputError
from lmkit.geometry.rig import Rig, with_time_offsets
from lmkit.live.frame_group import FrameGroup
from lmkit.live.loop import LiveLoop, LoopSettings
from lmkit.live.motion import GYRO, WHEELS, MotionRow
from lmkit.mapping.clock_offsets import find_clock_offsets
from lmkit.odometry.wheel_odometry import MotionModel
from lmkit.simulation.recording import make_drive
from lmkit.tracking.batch import track_images
from lmkit.tracking.online import track_images_live

OFFSETS_S = (0.08, -0.05)


@pytest.fixture(scope="module")
def rig():
    ring = ring_of_cameras(np.random.default_rng([1, 9]))
    return Rig(ring.cameras[:3], ring.T_base_left)


@pytest.fixture(scope="module")
def drive(rig):
    return make_drive(5, 16, rig=with_time_offsets(rig, OFFSETS_S), eights=True, count=24)


@pytest.fixture(scope="module")
def motion(drive):
    return MotionModel(drive.odometry, drive.gyro)


def errors_mm(tracked, drive):
    at = np.searchsorted(drive.times_s, tracked.times_s - 1e-9)
    return 1000 * np.linalg.norm(tracked.positions[:, :2] - drive.truth[at, :2], axis=1)


def test_offsets_are_found_with_their_standard_deviations(rig, drive, motion):
    found = find_clock_offsets(drive.frames, rig, drive.landmarks, motion)
    off = found.offsets_s - OFFSETS_S
    assert np.abs(off).max() < 1e-3
    assert (np.abs(off) < 4 * found.sigmas_s).all()
    assert found.sigmas_s.max() < 1e-3
    assert [camera.time_offset_s for camera in found.rig.cameras] == [0.0, *found.offsets_s]


@pytest.mark.parametrize("odometry", [True, False])
def test_a_track_takes_every_exposure_at_its_time(rig, drive, motion, odometry):
    timed = with_time_offsets(rig, OFFSETS_S)
    tracked = track_images(drive.frames, timed, drive.landmarks, motion if odometry else None)
    assert len(tracked) > 0.95 * len(drive.frames)
    off = errors_mm(tracked, drive)
    assert np.sqrt(np.mean(off**2)) < 4  # ignored, the offsets cost 20 mm
    if odometry:
        scaled = [d @ np.linalg.solve(C[:2, :2], d) / 2 for d, C in zip(
            tracked.positions[:, :2] - drive.truth[:, :2], tracked.covariances, strict=True)]  # fmt: skip
        assert np.mean(scaled) < 3


def test_a_filter_takes_every_exposure_at_its_time(rig, drive):
    timed = with_time_offsets(rig, OFFSETS_S)
    tracked = track_images_live(drive.frames, timed, drive.landmarks, drive.odometry, drive.gyro)
    assert set(tracked.times_s) <= set(drive.times_s)
    assert np.sqrt(np.mean(errors_mm(tracked, drive)[10:] ** 2)) < 8


def live_rows(drive, before_s, until_s):
    """Rows of the wheels and the gyro in an interval."""
    o, g = drive.odometry, drive.gyro
    rows = [MotionRow(WHEELS, *row) for row in zip(o.times_s, zip(o.forward_m, o.turn_rad, strict=True), strict=True)]
    rows += [MotionRow(GYRO, t, (rate,)) for t, rate in zip(g.times_s, g.rate_radps, strict=True)]
    return tuple(sorted((r for r in rows if before_s < r.time_s <= until_s), key=lambda row: row.time_s))


def live_errors_mm(rig, drive, motion):
    """Errors of the poses of a live run."""
    loop, before, errors = LiveLoop(rig, drive.landmarks, LoopSettings(motion=motion)), -1.0, []
    for frame, truth in zip(drive.frames, drive.truth, strict=True):
        rows = live_rows(drive, before, frame.time_s) if motion == WHEELS else ()
        group = FrameGroup(frame.time_s, (None,) * 3, (frame.time_s,) * 3, rows, seen=frame.seen)
        state, before = loop.step(group), frame.time_s
        if state.T_map_base is not None:
            errors.append(1000 * np.linalg.norm(state.T_map_base.t[:2] - truth[:2]))
    return np.array(errors[5:])


@pytest.mark.parametrize(("motion", "most_mm"), [(WHEELS, 8), ("none", 15)])
def test_a_live_run_takes_every_exposure_at_its_time(rig, drive, motion, most_mm):
    errors = live_errors_mm(with_time_offsets(rig, OFFSETS_S), drive, motion)
    assert len(errors) > 0.6 * len(drive.frames)
    assert np.sqrt(np.mean(errors**2)) < most_mm


def test_one_camera_has_one_clock(rig, drive, motion):
    with pytest.raises(InputError, match="one clock"):
        find_clock_offsets(drive.frames, Rig(rig.cameras[:1], rig.T_base_left), drive.landmarks, motion)
