"""Several recordings of ranges and bearings, surveyed as one map."""

import numpy as np
import pytest

from lmkit.mapping.range_bearing_survey import survey_readings
from lmkit.mapping.several_readings import survey_readings_together
from lmkit.simulation.recording import WheelErrors, make_drive


def recording(seed, landmarks=None):
    made = make_drive(seed, 60, hz=2, count=10, landmarks=landmarks, errors=WheelErrors(slips=0))
    return made.landmarks, (made.readings(seed), made.odometry, made.gyro)


@pytest.fixture(scope="module")
def three():
    landmarks, first = recording(3)
    return landmarks, {"one": first, "two": recording(4, landmarks)[1], "three": recording(5, landmarks)[1]}


def map_error_m(found, true):
    own, mounted = (np.array([m.T_map_landmark.t[:2] for m in some]) for some in (found, map(true.find, ids(found))))
    U, _, Vt = np.linalg.svd((own - own.mean(axis=0)).T @ (mounted - mounted.mean(axis=0)))
    off = (own - own.mean(axis=0)) @ U @ Vt - (mounted - mounted.mean(axis=0))
    return float(np.sqrt((off**2).sum(axis=1).mean()))


def ids(landmarks):
    return [m.id for m in landmarks]


def test_one_map_of_three_recordings_is_better_than_each(three):
    landmarks, recordings = three
    joint = survey_readings_together(recordings, 0.18)
    alone = [map_error_m(survey_readings(*one, 0.18)[0], landmarks) for one in recordings.values()]
    assert joint.left_out == ()
    assert set(joint.drives) == set(recordings)
    assert map_error_m(joint.landmarks, landmarks) < min(0.03, np.mean(alone))


def test_a_recording_of_another_place_is_left_out(three):
    _, recordings = three
    elsewhere = recording(9)[1]
    joint = survey_readings_together({"one": recordings["one"], "elsewhere": elsewhere}, 0.18)
    assert joint.left_out == ("elsewhere",)
    assert set(joint.drives) == {"one"}
