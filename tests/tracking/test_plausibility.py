"""Odometry, gyro and readings in other units, of other signs, axes and clocks are refused by name."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from lmkit.api.recordings import survey, track
from lmkit.errors import InputError, InputWarning
from lmkit.geometry.pose import Pose
from lmkit.io.readings import read_readings
from lmkit.localization.rig_contradiction import size_doubt
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import LandmarkMap
from lmkit.model.recording import Gyro, Odometry, Recording
from lmkit.odometry.plausibility import require_plausible_gyro, require_seconds
from lmkit.odometry.wheel_odometry import NOMINAL, MotionModel
from lmkit.pipelines.recording_checks import LEAST_ORDERED, order_doubt
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


@pytest.mark.parametrize(
    ("kept", "words"),
    [
        (lambda t: t > 8.0, "has no rates from -0.2 to 8.0 s: the wheels' rotation"),
        (lambda t: t < 21.0, "from 21.0 to 29.7 s"),
        (lambda t: (t < 5.0) | (t > 9.0), "from 5.0 to 9.0 s"),
    ],
)
def test_a_gyro_that_misses_a_part_is_named_and_the_wheels_stand_in(drive, kept, words):
    rows = kept(drive.gyro.times_s)
    part = Gyro(drive.gyro.times_s[rows], drive.gyro.rate_radps[rows])
    with pytest.warns(InputWarning, match=words):
        require_plausible_gyro(part, drive.odometry)
    times_s = drive.odometry.times_s
    models = [MotionModel(drive.odometry, some) for some in (part, drive.gyro, None)]
    without_delay = np.append(NOMINAL[:-1], 0.0)
    turned = [model.increments(times_s, without_delay).motions[:, 2] for model in models]
    covered = part.covers(times_s)[1:]
    assert 0.5 < covered.mean() < 0.9
    # Increments are interpolated in the cumulative sums of the rows.
    assert np.abs(turned[0] - turned[1])[covered].max() < 1e-9
    assert np.abs(turned[0] - turned[2])[~covered].max() < 1e-9


@pytest.mark.parametrize("own", [True, False])
def test_shuffled_stamps_are_named(drive, own):
    mixed = np.random.default_rng(1).permutation(len(drive.frames)).tolist()
    frames = [replace(drive.frames[k], time_s=f.time_s) for k, f in zip(mixed, drive.frames, strict=True)]
    with pytest.warns(InputWarning, match="are the time stamps shuffled"):
        survey(Recording(tuple(frames), odometry=drive.odometry if own else None), drive.rig)
    with pytest.raises(ValueError, match=r"in the order of time, and .* follows"):
        Recording(tuple(drive.frames[k] for k in mixed))


@pytest.mark.parametrize("seed", range(100, 106))
@pytest.mark.parametrize("every", [1, 10])
def test_frames_in_their_order_are_believed(seed, every):
    frames = make_drive(seed, seconds=60).frames[::every]
    assert len(frames) >= LEAST_ORDERED and order_doubt(frames) is None


@pytest.mark.parametrize("live", [False, True])
def test_two_floors_in_one_recording_are_named(drive, live):
    """A lift carries the robot up after half of the recording; wheels do not measure this."""

    def above(id_):
        return LandmarkId("lm12", id_.code % 184)

    up = np.array([0.0, 0.0, 3.2])
    upstairs = [
        replace(
            m, id=above(m.id), T_map_landmark=Pose("map", "landmark", m.T_map_landmark.R, m.T_map_landmark.t + up)
        )
        for m in drive.landmarks
    ]
    frames = list(drive.frames)
    for k in range(len(frames) // 2, len(frames)):
        seen = tuple(tuple(replace(o, id=above(o.id)) for o in camera) for camera in frames[k].seen)
        frames[k] = replace(frames[k], seen=seen)
    recording, both = Recording(tuple(frames), odometry=drive.odometry), LandmarkMap([*drive.landmarks, *upstairs])
    with pytest.raises(InputError, match=r"0.0 m high from 0.4 to .* s and 3.2 m high from .* s: two floors"):
        track(recording, drive.rig, both, live=live)
    assert len(track(replace(recording, odometry=None), drive.rig, both)) == len(frames) or live


def test_few_poses_at_another_height_are_no_floor(drive):
    """A landmark with a wrong height in the map causes some where it is seen alone."""
    id_ = Counter(o.id for frame in drive.frames for o in frame.detections).most_common(1)[0][0]
    m = drive.landmarks.find(id_)
    high = replace(m, T_map_landmark=replace(m.T_map_landmark, t=m.T_map_landmark.t + np.array([0.0, 0.0, 2.5])))
    landmarks = LandmarkMap([*(other for other in drive.landmarks if other.id != id_), high])
    frames = list(drive.frames)
    with_it = [k for k, frame in enumerate(frames) if all(any(o.id == id_ for o in some) for some in frame.seen)]
    for k in with_it[::3]:
        frames[k] = replace(frames[k], seen=tuple(tuple(o for o in some if o.id == id_) for some in frames[k].seen))
    track(Recording(tuple(frames), odometry=drive.odometry), drive.rig, landmarks)


def test_a_recording_of_one_frame_is_named(drive):
    warnings = survey(Recording(tuple(drive.frames[40:41])), drive.rig).warnings
    assert sum("kept out of the map" in text for text in warnings) == 1
    assert "the recording has one frame" in warnings[0] and "--keep-doubtful" in warnings[0]


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
    ("factor", "measured"), [(1.0, None), (1.02, None), (1.055, "180 mm, not the 190"), (0.83, "180 mm, not the 149")]
)
def test_a_size_that_the_baseline_contradicts_is_named(drive, factor, measured):
    """No residual of a survey shows this error: map and motion are scaled."""
    doubt = size_doubt(drive.frames, drive.rig, {m.id: factor * m.size_m for m in drive.landmarks})
    assert doubt is None if measured is None else f"landmarks measure {measured} mm stated" in doubt
