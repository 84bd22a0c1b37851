"""Odometry, gyro and readings in other units, of other signs, axes and clocks are refused by name."""

from __future__ import annotations

import numpy as np
import pytest

from lmkit.api.recordings import survey, track
from lmkit.errors import InputError, InputWarning
from lmkit.io.readings import read_readings
from lmkit.localization.rig_contradiction import size_doubt
from lmkit.model.recording import Gyro, Odometry, Recording
from lmkit.odometry.plausibility import require_seconds
from lmkit.simulation.recording import make_drive


@pytest.fixture(scope="module")
def drive():
    return make_drive(3, seconds=30)


def odometry(drive, shift=0.0, way=1.0, turn=1.0):
    o = drive.odometry
    return Odometry(o.times_s + shift, way * o.forward_m, turn * o.turn_rad)


def gyro(drive, shift=0.0, scale=1.0, rate=None):
    rates = drive.gyro.rate_radps if rate is None else rate
    return Gyro(drive.gyro.times_s + shift, scale * rates)


FAULTS = {
    "millimeters": lambda d: (odometry(d, way=1000.0), None),
    "centimeters": lambda d: (odometry(d, way=100.0), None),
    "degrees": lambda d: (odometry(d, turn=57.3), None),
    "backwards": lambda d: (odometry(d, way=-1.0), None),
    "other way than the landmarks": lambda d: (odometry(d, turn=-1.0), None),
    "clock": lambda d: (odometry(d, shift=5.0), None),
    "same clock": lambda d: (odometry(d, shift=1.7e9), None),
    "degrees per second": lambda d: (odometry(d), gyro(d, scale=57.3)),
    "other way than the wheels": lambda d: (odometry(d), gyro(d, scale=-1.0)),
    "clocks": lambda d: (odometry(d), gyro(d, shift=1.7e9)),
    "its clock is": lambda d: (odometry(d), gyro(d, shift=6.0)),
    "stands still": lambda d: (odometry(d, way=0.0), None),
    "milliseconds": lambda d: (odometry(d), Gyro(1000 * d.gyro.times_s, d.gyro.rate_radps)),
    "about another axis": lambda d: (odometry(d), gyro(d, scale=0.0)),
    "another axis": lambda d: (
        odometry(d),
        gyro(d, rate=np.random.default_rng(0).normal(0.0, 0.2, len(d.gyro.times_s))),
    ),
}


def of_readings(drive, own, rate):
    return Recording(readings=tuple((t, tuple(seen)) for t, seen in drive.readings(1)), odometry=own, gyro=rate)


def of_frames(drive, own, rate):
    return Recording(tuple(drive.frames), odometry=own, gyro=rate)


@pytest.mark.parametrize("live", [False, True])
@pytest.mark.parametrize("make", [of_frames, of_readings])
@pytest.mark.parametrize("word", FAULTS)
def test_a_fault_is_refused_by_name(drive, word, make, live):
    recording = make(drive, *FAULTS[word](drive))
    with pytest.raises(InputError) as raised:
        track(recording, drive.rig if recording.frames else None, drive.landmarks, live=live)
    assert word in str(raised.value)


@pytest.mark.parametrize("word", ["millimeters", "degrees per second", "other way than the wheels", "clocks"])
def test_survey_refuses_what_track_refuses(drive, word):
    with pytest.raises(InputError) as raised:
        survey(of_frames(drive, *FAULTS[word](drive)), drive.rig)
    assert word in str(raised.value)


def test_a_survey_without_known_landmarks_names_odometry_that_runs_backwards(drive):
    warnings = survey(of_frames(drive, odometry(drive, way=-1.0), None), drive.rig).warnings
    assert "runs backwards" in warnings[0]


@pytest.mark.parametrize("seed", range(4))
def test_honest_recordings_pass(seed):
    drive = make_drive(seed, seconds=20)
    for own, rate in ((odometry(drive), gyro(drive)), (odometry(drive, way=1.2, turn=1.3), None)):
        track(of_frames(drive, own, rate), drive.rig, drive.landmarks)
        track(of_readings(drive, own, rate), None, drive.landmarks)


@pytest.mark.parametrize(("row", "word"), [("0.1,3,2150.0,0.1", "millimeters"), ("0.1,3,2.1,35.0", "degrees")])
def test_readings_in_other_units_are_refused(tmp_path, row, word):
    path = tmp_path / "readings.csv"
    path.write_text("time_s,code,range_m,bearing_rad\n" + row + "\n")
    with pytest.raises(InputError, match=word):
        read_readings(path, ["lm8"])


@pytest.mark.parametrize(("factor", "unit"), [(1e3, "milliseconds"), (1e6, "microseconds")])
def test_times_of_images_in_other_units_are_warned_of(factor, unit):
    with pytest.warns(InputWarning, match=f"are their times in {unit}"):
        require_seconds(np.arange(20) / 5 * factor)


@pytest.mark.parametrize("times_s", [np.arange(20) / 5, np.arange(3) * 600.0, 1.7e9 + np.arange(20) / 5, np.zeros(0)])
def test_seconds_pass_and_so_do_a_few_still_images(times_s):
    require_seconds(times_s)


def test_times_far_beyond_the_calendar_are_no_seconds():
    with pytest.raises(InputError, match="milliseconds"):
        require_seconds(1.7e12 + 200.0 * np.arange(3))


@pytest.mark.parametrize(
    ("factor", "measured"), [(1.0, None), (1.02, None), (1.055, "180 mm, 190"), (0.83, "180 mm, 149")]
)
def test_a_size_that_the_baseline_contradicts_is_named(drive, factor, measured):
    """No residual of a survey tells it: map and motion are scaled."""
    doubt = size_doubt(drive.frames, drive.rig, {m.id: factor * m.size_m for m in drive.landmarks})
    assert doubt is None if measured is None else f"landmarks measure {measured} mm are stated" in doubt
