"""Known landmarks that were moved, in the survey of one recording; readings that are not landmarks."""

from dataclasses import replace

import numpy as np
import pytest

from lmkit.geometry.pose import Pose
from lmkit.geometry.pose_array import PoseArray
from lmkit.mapping import known_survey
from lmkit.mapping.bundle_adjustment import Anchor
from lmkit.mapping.joint_survey import joint_warnings
from lmkit.mapping.landmark_support import doubtful_landmarks
from lmkit.mapping.moved_known_landmarks import is_surveyed
from lmkit.mapping.reading_rate import LocatedFrames
from lmkit.mapping.several_recordings import NamedRecording, survey_recordings
from lmkit.mapping.survey import anchors_of, survey_frames
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import LandmarkMap, MappedLandmark
from lmkit.odometry.wheel_odometry import MotionModel
from lmkit.simulation.recording import make_drive

SIGMA = (0.005, 0.005)  # m, rad: of the known map
SEED, SECONDS = 11, 12
ROOM = make_drive(2, seconds=2).landmarks
SIZES = {m.id: m.size_m for m in ROOM}


def drive(landmarks=ROOM, seed=SEED):
    return make_drive(seed, seconds=SECONDS, hz=2.5, landmarks=landmarks)


def survey(made, known, frames=None, **options):
    motion = MotionModel(made.odometry, made.gyro)
    return survey_frames(frames or made.frames, made.rig, SIZES | options.pop("sizes", {}), known, motion, **options)


def most_seen(made):
    """Ids, most often seen first."""
    ids = [id_ for frame in made.frames for id_ in {o.id for o in frame.detections}]
    return sorted(set(ids), key=lambda id_: (-ids.count(id_), id_))


@pytest.fixture(scope="module")
def seen():
    return most_seen(drive())


def with_one_moved(chosen, meters):
    """The room with one landmark along its wall."""
    changed = []
    for m in ROOM:
        T = m.T_map_landmark
        t = T.t + meters * T.R[:, 0] if m.id == chosen else T.t
        changed.append(replace(m, T_map_landmark=Pose("map", "landmark", T.R, t)))
    return LandmarkMap(changed)


def test_an_exact_place_that_all_contradicts_gives_way_to_what_was_seen(seen):
    """Exact places state no accuracy: one that is wrong by 20 cm is found, and no other one."""
    made = drive()
    wrong = with_one_moved(seen[1], 0.2)
    known = {m.id: Anchor(m, None) for m in wrong if m.id in seen[:4]}
    result = survey(made, known)
    assert [m.before.id for m in result.moved] == [seen[1]]
    assert result.moved[0].meters == pytest.approx(0.2, abs=0.02)
    found, true = (one.find(seen[1]).T_map_landmark.t for one in (result.landmarks, ROOM))
    assert np.linalg.norm(found - true) < 0.02


@pytest.mark.parametrize("meters", [0.06, 1.5])
def test_a_single_recording_finds_a_landmark_that_was_moved_since_the_known_map(seen, meters):
    """A landmark moved by 6 cm distorts the map; all observations of one moved by 1.5 m are outliers."""
    later = with_one_moved(seen[1], meters)
    result = survey(drive(later), anchors_of(ROOM, SIGMA))
    [moved] = result.moved
    assert moved.before.id == seen[1]
    assert moved.meters == pytest.approx(meters, abs=0.02)
    assert (moved.seen_before, moved.seen_after) == (("the known map",), ("this recording",))
    errors = [np.linalg.norm(m.T_map_landmark.t - later.find(m.id).T_map_landmark.t) for m in result.landmarks]
    assert max(errors) < 0.02
    assert [m.id for m in result.landmarks.past] == [seen[1]]
    assert result.to_dict()["moved"][0]["id"] == str(seen[1])


@pytest.mark.parametrize(("seed", "rank"), [(18, 0), (30, 1)], ids=["pulls another one", "placed by nothing else"])
def test_a_landmark_that_was_moved_far_is_named_alone(seed, rank):
    """One is released together with another that it had displaced; the other one cannot be placed otherwise."""
    chosen = most_seen(drive(seed=seed))[rank]
    result = survey(drive(with_one_moved(chosen, 1.0), seed), anchors_of(ROOM, SIGMA))
    assert [one.before.id for one in result.moved] == [chosen]
    assert result.moved[0].meters == pytest.approx(1.0, abs=0.05)


def test_nothing_is_named_where_nobody_moved_anything():
    rng = np.random.default_rng(3)
    off = [replace(m, T_map_landmark=replace_t(m.T_map_landmark, rng.normal(0, SIGMA[0], 3))) for m in ROOM]
    result = survey(drive(), anchors_of(LandmarkMap(off), SIGMA))
    assert not result.moved
    assert not result.disputed


def replace_t(T, shift):
    return Pose("map", "landmark", T.R, T.t + shift)


def test_of_two_known_landmarks_nobody_knows_which_was_moved(seen):
    """Both landmarks are in the same frames, and both are named."""
    later = with_one_moved(seen[1], 0.5)
    known = {id_: anchor for id_, anchor in anchors_of(ROOM, SIGMA).items() if id_ in seen[:2]}
    result = survey(drive(later), known)
    assert not result.moved
    assert result.disputed == tuple(sorted(seen[:2]))


def test_known_landmarks_that_contradict_each_other_in_all_recordings_are_named(seen):
    later = with_one_moved(seen[1], 0.5)
    known = {id_: anchor for id_, anchor in anchors_of(ROOM, SIGMA).items() if id_ in seen[:2]}
    made = drive(later)
    recordings = [
        NamedRecording(name, tuple(made.frames), made.rig, MotionModel(made.odometry, made.gyro)) for name in "ab"
    ]
    result = survey_recordings(recordings, SIZES, known)
    assert not result.moved
    assert result.disputed == tuple(sorted(seen[:2]))
    assert result.to_dict()["disputed"] == [str(id_) for id_ in result.disputed]
    assert any("contradict the observations" in text for text in joint_warnings(result))


def test_where_many_known_landmarks_stand_elsewhere_the_map_is_doubted(monkeypatch, seen):
    """No landmark is called moved: the map may be of another place."""
    monkeypatch.setattr(known_survey, "MOST_RELEASED", 2)
    rng = np.random.default_rng(5)
    off = {id_: rng.uniform(0.3, 0.6, 3) * rng.choice([-1, 1], 3) for id_ in seen[:4]}
    wrong = [replace(m, T_map_landmark=replace_t(m.T_map_landmark, off.get(m.id, np.zeros(3)))) for m in ROOM]
    result = survey(drive(), anchors_of(LandmarkMap(wrong), SIGMA))
    assert not result.moved
    assert len(result.disputed) == 3
    assert set(result.disputed) <= set(off)


def test_places_that_nobody_qualified_are_not_tested():
    m = next(iter(ROOM))
    assert is_surveyed(Anchor(m, np.eye(6) * 1e-4))
    assert not any(is_surveyed(Anchor(m, C)) for C in (None, np.zeros((6, 6)), np.eye(6) * 0.01))


def mapped(code, x_m, size_m=0.18):
    return MappedLandmark(LandmarkId("lm8", code), size_m, Pose("map", "landmark", np.eye(3), np.array([x_m, 0, 0])))


def frames(count, from_s=0.0, to_s=30.0):
    return np.linspace(from_s, to_s, count)


@pytest.mark.parametrize(
    ("times", "known", "out"),
    [
        ({1: frames(30), 2: frames(1)}, (), [2]),
        ({1: frames(30), 2: frames(2)}, (), []),
        ({1: frames(30), 2: frames(1)}, (2,), []),
        ({1: frames(30), 3: frames(3, 40, 50)}, (), [3]),
        ({1: frames(30), 3: frames(4, 40, 50)}, (), []),
        ({1: frames(30), 3: frames(15, 10, 20)}, (), [3]),
        ({1: frames(30), 3: frames(16, 10, 20)}, (), []),
        ({1: frames(30), 3: frames(15, 25, 50)}, (), []),
        ({1: frames(30), 3: frames(3)}, (3,), []),
    ],
    ids=[
        *("one frame", "two frames", "known", "rare in a place", "not so rare, after it"),
        *("between", "between, but often", "half after it", "rare and known"),
    ],
)
def test_too_few_frames_are_no_landmark(times, known, out):
    places = {1: 0.0, 2: 1.0, 3: 0.03}  # the third has the place of the first
    ids = {code: LandmarkId("lm8", code) for code in places}
    every = np.unique(np.concatenate(list(times.values())))
    nowhere = PoseArray("map", "left", np.tile(np.eye(3), (len(every), 1, 1)), np.zeros((len(every), 3)))
    read = {ids[code]: np.searchsorted(every, at) for code, at in times.items()}
    recording = LocatedFrames(every, nowhere, drive().rig, np.zeros((len(every), 2), dtype=bool), read)
    found = doubtful_landmarks(
        [mapped(code, places[code]) for code in times], [recording], {ids[code] for code in known}
    )
    assert [one.id.code for one in found] == out
    assert all("--keep-doubtful" in str(one) for one in found)


def test_only_what_may_be_read_too_rarely_is_looked_for_in_images(monkeypatch):
    """Projecting every landmark into its neighboring frames took longer than all other checks of a survey."""
    asked = []
    monkeypatch.setattr(
        LocatedFrames, "readable", lambda self, m, frames: asked.append(m.id.code) or np.ones(len(frames), dtype=bool)
    )
    times, rarely = np.arange(30.0), np.arange(0, 30, 5)
    nowhere = PoseArray("map", "left", np.tile(np.eye(3), (30, 1, 1)), np.zeros((30, 3)))
    steady, doubted = mapped(1, 0.0), mapped(2, 5.0)
    read = {steady.id: np.arange(10, 20), doubted.id: rarely}
    recording = LocatedFrames(times, nowhere, drive().rig, np.ones((30, 2), dtype=bool), read)
    assert [one.id for one in doubtful_landmarks([steady, doubted], [recording], ())] == [doubted.id]
    assert asked == [doubted.id.code]


@pytest.mark.parametrize("keep", [False, True])
def test_one_misreading_of_one_frame_is_kept_out_of_the_map_and_named(seen, keep):
    made, wrong = drive(), LandmarkId("lm8", next(c for c in range(256) if LandmarkId("lm8", c) not in SIZES))
    row = max(range(len(made.frames)), key=lambda k: sum(o.id == seen[0] for o in made.frames[k].detections))
    misread = tuple(
        tuple(replace(o, id=wrong) if o.id == seen[0] else o for o in camera) for camera in made.frames[row].seen
    )
    frames = [replace(f, seen=misread) if k == row else f for k, f in enumerate(made.frames)]
    anchor = {seen[1]: Anchor(ROOM.find(seen[1]), None)}
    result = survey(made, anchor, frames, sizes={wrong: 0.18}, keep_doubtful=keep)
    assert (result.landmarks.find(wrong) is not None) == keep
    assert [one.id for one in result.kept_out] == ([] if keep else [wrong])
    assert wrong not in {m.id for m in result.bundle.landmarks} or keep


@pytest.mark.parametrize(
    ("hidden", "out"), [("all but every fifth frame", True), ("half of its frames in a row", False)]
)
def test_a_print_that_is_read_now_and_then_in_full_view_is_kept_out(hidden, out):
    made = make_drive(SEED, seconds=25, hz=2.5, landmarks=ROOM)
    known, doubted = most_seen(made)[:2]
    rows = [k for k, frame in enumerate(made.frames) if any(o.id == doubted for o in frame.detections)]
    kept = set(rows[1::5] if out else rows[: len(rows) // 2])
    assert len(rows) > 12
    frames_ = [
        frame
        if k in kept
        else replace(frame, seen=tuple(tuple(o for o in camera if o.id != doubted) for camera in frame.seen))
        for k, frame in enumerate(made.frames)
    ]
    result = survey(made, {known: Anchor(ROOM.find(known), None)}, frames_)
    assert [one.id for one in result.kept_out] == ([doubted] if out else [])
    assert (result.landmarks.find(doubted) is None) == out
