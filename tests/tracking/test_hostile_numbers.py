"""Numbers that no sensor gives: every solver answers or names the error, with one frame and with many."""

from __future__ import annotations

import random
from dataclasses import replace

import numpy as np
import pytest

from lmkit.api.recordings import survey, track
from lmkit.errors import LmkitError
from lmkit.model.observation import RangeBearing
from lmkit.model.recording import Gyro, Odometry, Recording, RigFrame
from lmkit.simulation.recording import make_drive

HARMFUL = (0.0, -1.0, 1e9, -1e9, 1e8, 1e-9, 1e6)


@pytest.fixture(scope="module")
def drive():
    return make_drive(1, seconds=4)


def harmed(values, rng):
    """(N,...) with none, one, three or all of the values replaced."""
    values = np.array(values, dtype=float)
    for _ in range(rng.choice((0, 1, 3))):
        values.flat[rng.randrange(values.size)] = rng.choice(HARMFUL)
    if rng.random() < 0.1:
        values[...] = rng.choice(HARMFUL)
    return values


def harmed_reading(reading, rng):
    values = harmed([reading.range_m, reading.bearing_rad], rng) * rng.choice((1.0, 1e-7, 1e-8))
    return RangeBearing(reading.id, *values.tolist())


def harmed_recording(drive, rng, of_readings):
    own, count = drive.odometry, rng.choice((1, 2, 3, len(drive.frames)))
    odometry = Odometry(own.times_s, harmed(own.forward_m, rng), harmed(own.turn_rad, rng))
    gyro = Gyro(drive.gyro.times_s, harmed(drive.gyro.rate_radps, rng)) if rng.random() < 0.5 else None
    if of_readings:
        readings = [
            (t, tuple(harmed_reading(r, rng) if rng.random() < 0.1 else r for r in seen))
            for t, seen in drive.readings(1)[:count]
        ]
        return Recording(readings=tuple(readings), odometry=odometry, gyro=gyro)

    def harmed_camera(seen):
        return tuple(replace(o, corners=harmed(o.corners, rng)) if rng.random() < 0.3 else o for o in seen)

    frames = [RigFrame(f.time_s, tuple(map(harmed_camera, f.seen)), f.name) for f in drive.frames[:count]]
    without = rng.random() < 0.3
    return Recording(tuple(frames), odometry=None if without else odometry, gyro=None if without else gyro)


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("work", ["track", "live", "survey", "readings"])
def test_harmed_recordings_are_solved_or_refused(drive, work):
    rng = random.Random(work)
    for _ in range(40):
        recording = harmed_recording(drive, rng, work == "readings")
        try:
            if work == "survey":
                survey(recording, drive.rig)
            else:
                live = work == "live" and recording.odometry is not None
                rig = None if work == "readings" else drive.rig
                tracked = track(recording, rig, drive.landmarks, live=live)
                assert np.isfinite(tracked.positions).all()
                assert np.isfinite(tracked.covariances).all()
        except LmkitError as error:
            assert error.message
