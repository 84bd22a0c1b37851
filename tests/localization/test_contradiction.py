"""Observations that contradict the map: no pose is ok, and the cause is named."""

from __future__ import annotations

from dataclasses import replace

import pytest

from lmkit.api.recordings import survey, track
from lmkit.errors import InputError
from lmkit.geometry.pose import Pose
from lmkit.localization.contradiction import find_cause
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import LandmarkMap
from lmkit.model.pose_status import PoseStatus
from lmkit.model.recording import Recording, RigFrame
from lmkit.simulation.recording import make_drive


@pytest.fixture(scope="module")
def drive():
    return make_drive(1, seconds=8)


def reordered(frames, order):
    def turned(seen):
        return tuple(replace(o, corners=o.corners[list(order)], covariance=None) for o in seen)

    return [RigFrame(f.time_s, tuple(map(turned, f.seen))) for f in frames]


def swapped(frames):
    return [RigFrame(f.time_s, f.seen[::-1]) for f in frames]


def scaled(landmarks, positions=1.0, sizes=1.0):
    def one(m):
        T = m.T_map_landmark
        return replace(m, size_m=sizes * m.size_m, T_map_landmark=Pose("map", "landmark", T.R, positions * T.t))

    return LandmarkMap([one(m) for m in landmarks])


def shuffled(landmarks):
    mapped = list(landmarks)
    others = [m.T_map_landmark for m in (*mapped[5:], *mapped[:5])]
    return LandmarkMap([replace(m, T_map_landmark=T) for m, T in zip(mapped, others, strict=True)])


def test_what_agrees_has_no_cause(drive):
    assert find_cause(drive.frames, drive.rig, drive.landmarks) is None


@pytest.mark.parametrize("order", [(3, 2, 1, 0), (2, 3, 0, 1), (1, 2, 3, 0), (1, 0, 3, 2)])
def test_corners_in_another_order_are_named(drive, order):
    cause = find_cause(reordered(drive.frames, order), drive.rig, drive.landmarks)
    assert cause is not None and cause.code == "corner_order" and "another order" in cause.text


def test_swapped_cameras_are_named(drive):
    assert find_cause(swapped(drive.frames), drive.rig, drive.landmarks).code == "swapped_cameras"


@pytest.mark.parametrize(("positions", "unit"), [(1000.0, "millimeters"), (39.37, "inches"), (1.5, "units")])
def test_units_of_the_map_are_named(drive, positions, unit):
    cause = find_cause(drive.frames, drive.rig, scaled(drive.landmarks, positions))
    assert cause.code == "map_units" and unit in cause.text


def test_a_size_of_another_unit_is_named(drive):
    assert find_cause(drive.frames, drive.rig, scaled(drive.landmarks, sizes=1.4)).code == "map_sizes"


@pytest.mark.parametrize(("factor", "code"), [(10.0, "rig_units"), (-1.0, "rig_sign")])
def test_a_rig_that_contradicts_is_named(drive, factor, code):
    T = drive.rig.T_right_left
    rig = replace(drive.rig, T_right_left=Pose("right", "left", T.R, factor * T.t))
    assert find_cause(drive.frames, rig, drive.landmarks).code == code


def test_the_map_of_another_place_is_named(drive):
    assert find_cause(drive.frames, drive.rig, shuffled(drive.landmarks)).code == "another_map"


@pytest.mark.parametrize("odometry", [True, False])
@pytest.mark.parametrize("fault", ["order", "map", "swapped"])
def test_no_tracked_pose_is_ok_where_nearly_everything_contradicts(drive, fault, odometry):
    frames, landmarks = drive.frames, drive.landmarks
    if fault == "order":
        frames = reordered(frames, (1, 2, 3, 0))
    elif fault == "swapped":
        frames = swapped(frames)
    else:
        landmarks = shuffled(landmarks)
    recording = Recording(tuple(frames), odometry=drive.odometry if odometry else None)
    try:
        tracked = track(recording, drive.rig, landmarks)
    except InputError as error:
        assert error.code in ("nothing_located", "corner_order", "swapped_cameras", "another_map")
        return
    assert PoseStatus.OK not in tracked.statuses
    assert any(word in tracked.remarks[0] for word in ("another order", "swapped", "at other places"))


def test_apriltags_corner_order_is_refused_by_name(drive):
    recording = Recording(tuple(reordered(drive.frames, (3, 2, 1, 0))))
    for work in (lambda: track(recording, drive.rig, drive.landmarks), lambda: survey(recording, drive.rig)):
        with pytest.raises(InputError, match="corner") as raised:
            work()
        assert raised.value.code == "corner_order"


def test_a_map_of_which_nothing_is_seen_is_refused_by_name(drive):
    others = LandmarkMap([replace(m, id=LandmarkId("lm12", code)) for code, m in enumerate(drive.landmarks)])
    with pytest.raises(InputError, match="none of the") as raised:
        track(Recording(tuple(drive.frames)), drive.rig, others)
    assert raised.value.code == "no_landmarks"


def test_known_landmarks_that_contradict_are_named(drive):
    recording = Recording(tuple(drive.frames), odometry=drive.odometry)
    try:
        warnings = survey(recording, drive.rig, known=scaled(drive.landmarks, 1.5)).warnings
    except InputError as error:
        warnings = (str(error),)
    assert "units" in warnings[0]


def test_a_frame_whose_landmarks_contradict_is_inconsistent_alone(drive):
    k = max(range(5, 30), key=lambda k: len(drive.frames[k].seen[0]))
    frames = list(drive.frames)
    frames[k] = reordered(frames[k : k + 1], (1, 2, 3, 0))[0]
    tracked = track(Recording(tuple(frames), odometry=drive.odometry), drive.rig, drive.landmarks)
    assert [j for j, status in enumerate(tracked.statuses) if status != PoseStatus.OK] == [k]
    assert tracked.statuses[k] == PoseStatus.INCONSISTENT
