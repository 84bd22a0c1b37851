"""Several recordings of ranges and bearings, surveyed as one map."""

import numpy as np
import pytest

from lmkit.io.recording_tables import odometry_to_csv
from lmkit.mapping.range_bearing_survey import survey_readings
from lmkit.mapping.several_readings import survey_readings_together
from lmkit.model.recording import Recording
from lmkit.simulation.recording import WheelErrors, make_drive


def recording(seed, landmarks=None):
    made = make_drive(seed, 60, hz=2, count=10, landmarks=landmarks, errors=WheelErrors(slips=0))
    readings = tuple((time_s, tuple(seen)) for time_s, seen in made.readings(seed))
    return made.landmarks, Recording((), readings, made.odometry, made.gyro)


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
    alone = [
        map_error_m(survey_readings(one.readings, one.odometry, one.gyro, 0.18)[0], landmarks)
        for one in recordings.values()
    ]
    assert joint.left_out == ()
    assert set(joint.drives) == set(recordings)
    assert map_error_m(joint.landmarks, landmarks) < min(0.03, np.mean(alone))


def test_a_recording_of_another_place_is_left_out(three):
    _, recordings = three
    elsewhere = recording(9)[1]
    joint = survey_readings_together({"one": recordings["one"], "elsewhere": elsewhere}, 0.18)
    assert joint.left_out == ("elsewhere",)
    assert set(joint.drives) == {"one"}


def test_folders_of_readings_are_surveyed_by_the_command(three, tmp_path, lmkit):
    _, recordings = three
    for name, recording in recordings.items():
        folder = tmp_path / name
        folder.mkdir()
        (folder / "odometry.csv").write_text(odometry_to_csv(recording.odometry))
        rows = (
            f"{time_s},{r.id.code},{r.range_m},{r.bearing_rad}\n" for time_s, seen in recording.readings for r in seen
        )
        (folder / "readings.csv").write_text("time_s,code,range_m,bearing_rad\n" + "".join(rows))
    names = [str(tmp_path / name) for name in recordings]
    answer = lmkit("survey", *names, "-o", str(tmp_path / "map.yaml"))
    assert answer.code == 0
    assert "10 landmarks in the plane" in answer.out
    refused = lmkit("survey", names[0], str(tmp_path), "-o", str(tmp_path / "other.yaml"))
    assert refused.code == 2 and "readings.csv" in refused.err
