"""Several recordings in one map: sums compared with one large problem, and changes between days."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lmkit.errors import InputError
from lmkit.geometry.pose import Pose
from lmkit.geometry.rotations import rotation_angle
from lmkit.mapping import joint_adjustment
from lmkit.mapping.bundle_adjustment import Anchor
from lmkit.mapping.joint_adjustment import JointProblem, recording_information
from lmkit.mapping.joint_solver import JointSolver
from lmkit.mapping.observation_arrays import StoredObservations
from lmkit.mapping.recording_group import SingleSurvey
from lmkit.mapping.several_recordings import NamedRecording, join_surveys, survey_recordings
from lmkit.mapping.survey import anchors_of, solve_recording
from lmkit.model.landmark_map import LandmarkMap
from lmkit.model.recording import Odometry
from lmkit.odometry.wheel_odometry import MotionModel
from lmkit.optim.information_sum import InformationSum
from lmkit.simulation.recording import make_drive

ROOM = make_drive(2, seconds=2).landmarks
SIZES = {m.id: m.size_m for m in ROOM}
DAY_S = 86400.0


def drive(seed, landmarks=ROOM, seconds=30):
    return make_drive(seed, seconds=seconds, landmarks=landmarks)


def recording(made, name, offset_s=0.0):
    frames = tuple(replace(frame, time_s=frame.time_s + offset_s) for frame in made.frames)
    odometry = Odometry(made.odometry.times_s + offset_s, made.odometry.forward_m, made.odometry.turn_rad)
    return NamedRecording(name, frames, made.rig, MotionModel(odometry, None))


def moved_by(landmarks, chosen, meters, degrees=0.0):
    """The room with one landmark mounted elsewhere along its wall."""
    changed = []
    for m in landmarks:
        T = m.T_map_landmark
        if m.id == chosen:
            turn = Rotation.from_rotvec(np.deg2rad(degrees) * np.array([0, 0, 1.0])).as_matrix()
            T = Pose("map", "landmark", turn @ T.R, T.t + meters * T.R[:, 0])
        changed.append(replace(m, T_map_landmark=T))
    return LandmarkMap(changed)


def known(landmarks=ROOM, number=0):
    m = list(landmarks)[number]
    return {m.id: Anchor(m, None)}


def largest_error_m(landmarks, truth):
    return max(float(np.linalg.norm(m.T_map_landmark.t - truth.find(m.id).T_map_landmark.t)) for m in landmarks)


def often_seen(made, rank=0):
    """The landmark of this rank by the number of frames that see it."""
    count = {}
    for frame in made.frames:
        for id_ in {o.id for o in frame.detections}:
            count[id_] = count.get(id_, 0) + 1
    return sorted(count, key=lambda id_: -count[id_])[rank]


@pytest.fixture(scope="module")
def solved():
    recordings = [recording(drive(seed, seconds=20), f"day{seed}") for seed in (11, 12)]
    return [solve_recording(r.frames, r.rig, SIZES, {}, r.motion) for r in recordings]


@pytest.fixture
def joint(solved):
    problems = [one.problem for one in solved]
    ids = sorted({id_ for problem in problems for id_ in problem.landmark_ids})
    rows = [np.array([ids.index(id_) for id_ in problem.landmark_ids]) for problem in problems]
    problems[0].anchors = {next(iter(ROOM)).id: Anchor(next(iter(ROOM)), 1e-4 * np.eye(6))}
    poses = [ROOM.find(id_).T_map_landmark for id_ in ids]
    R, p = np.array([T.R for T in poses]), np.array([T.t for T in poses])
    for problem in problems:
        # Each recording has its own frame; near the room's frame the sums have realistic sizes.
        mine = [ROOM.find(id_).T_map_landmark for id_ in problem.landmark_ids]
        turn, _ = Rotation.align_vectors(*(x - x.mean(axis=0) for x in (np.array([T.t for T in mine]), problem.lm_p)))
        turn = turn.as_matrix()
        anchors, problem.anchors = problem.anchors, {}
        problem.transform(turn, np.mean([T.t for T in mine], axis=0) - turn @ problem.lm_p.mean(axis=0))
        problem.anchors = anchors
    return JointProblem(problems, rows, R, p)


def one_big_system(joint, damping):
    """Dense normal equations of all poses, odometry and landmarks of all recordings; landmarks are the last."""
    parts = [problem.equations()[0] for problem in joint.problems]
    own = [e.gradient.size + problem.own for e, problem in zip(parts, joint.problems, strict=True)]
    total = sum(own) + 6 * len(joint.p)
    H, g, at = np.zeros((total, total)), np.zeros(total), 0
    for e, problem, rows, mine in zip(parts, joint.problems, joint.rows, own, strict=True):
        count, border = len(e.gradient), e.dense_border()
        landmarks = sum(own) + (6 * rows[:, None] + np.arange(6)).ravel()
        shared = np.concatenate([at + e.gradient.size + np.arange(problem.own), landmarks])
        for k in range(count):
            s = at + 6 * k + np.arange(6)
            H[np.ix_(s, s)] += e.diagonal[k]
            if k + 1 < count:
                H[np.ix_(s, s + 6)] += e.following[k]
                H[np.ix_(s + 6, s)] += e.following[k].T
            H[np.ix_(s, shared)] += border[k]
            H[np.ix_(shared, s)] += border[k].T
            g[s] += e.gradient[k]
        H[np.ix_(shared, shared)] += e.corner
        g[shared] += e.shared_gradient
        at += mine
    H[np.diag_indices(total)] *= 1 + damping
    return H, g, sum(own)


@pytest.mark.parametrize("damping", [0.0, 1e-3])
def test_the_step_by_sums_is_the_step_of_the_one_big_problem(joint, damping):
    H, g, first = one_big_system(joint, damping)
    direct = np.linalg.solve(H, g)
    for _ in range(3):  # refined with exact residuals, since the large system is ill-conditioned
        direct += np.linalg.solve(H, (g - H.astype(np.longdouble) @ direct).astype(float))
    equations, _ = joint.linearize(joint.state())
    landmarks, own = joint.solve(equations, damping)
    states = np.concatenate(
        [np.concatenate([x.ravel(), y[: problem.own]]) for (x, y), problem in zip(own, joint.problems, strict=True)]
    )
    assert np.abs(landmarks - direct[first:]).max() < 1e-9 * np.abs(direct).max()
    # The large system is worse conditioned in the poses than in the landmarks: the equations hold to 1e-9.
    whole = np.concatenate([states, landmarks])
    assert np.abs(H @ whole - g).max() < 1e-9 * np.abs(g).max()


def test_steps_are_the_same_where_neither_equations_nor_observations_are_kept(joint, tmp_path, monkeypatch):
    start = joint.state()
    kept = joint.solve(joint.linearize(start)[0], 1e-3)
    monkeypatch.setattr(joint_adjustment, "MOST_KEPT", 0)
    for number, problem in enumerate(joint.problems):
        stored = StoredObservations.write(problem.seen, tmp_path / f"{number}.npz")
        monkeypatch.setattr(problem, "seen", stored)
    equations, _ = joint.linearize(start)
    assert equations.kept == ()
    joint.restore(joint.retract(start, kept))  # a step that was tried, and refused
    landmarks, own = joint.solve(equations, 1e-3)
    assert np.array_equal(landmarks, kept[0])
    for parts in zip(own, kept[1], strict=True):
        assert all(np.array_equal(a, b) for a, b in zip(*parts, strict=True))


def test_the_joint_covariance_is_that_of_the_one_big_problem(joint):
    H, _, first = one_big_system(joint, 0.0)
    C = np.linalg.inv(H)[first:, first:]
    root = np.sqrt(np.diag(C))
    assert np.abs((joint.covariance() - C) / root / root[:, None]).max() < 1e-6


def test_information_moves_to_another_linearization(joint):
    information = recording_information(joint.problems[0])
    shift = np.random.default_rng(1).normal(0, 1e-3, information.p.shape)
    moved = information.about(information.R, information.p + shift)
    step = np.column_stack([shift, np.zeros_like(shift)]).ravel()
    assert moved.cost == pytest.approx(information.cost - 2 * information.b @ step + step @ information.H @ step)
    back = moved.about(information.R, information.p)
    assert np.abs(back.b - information.b).max() < 1e-9 * np.abs(information.b).max()


def test_many_landmarks_are_summed_sparsely_to_the_same_answer():
    rng = np.random.default_rng(0)
    sums = [InformationSum(40, 2), InformationSum(40, 2)]
    sums[1]._dense = None
    for _ in range(60):
        rows = rng.choice(40, 5, replace=False)
        A = rng.normal(size=(12, 10))
        for one in sums:
            one.add(rows, A.T @ A, A.T @ np.ones(12))
    assert np.abs(sums[0].solve() - sums[1].solve()).max() < 1e-9
    assert np.abs(sums[0].covariance() - sums[1].covariance()).max() < 1e-9


def test_known_landmarks_that_no_recording_saw_are_refused():
    survey = SingleSurvey("monday", None, None, None, anchored=False)
    anchor = next(iter(ROOM)).id
    with pytest.raises(InputError, match=f"no recording .* saw a known landmark .*{anchor.code}"):
        join_surveys({"monday": survey}, known())


@pytest.mark.slow
def test_recordings_together_know_the_room_better_than_one_alone():
    made = [drive(seed) for seed in (11, 12, 13)]
    recordings = [recording(one, f"day{k}") for k, one in enumerate(made)]
    result = survey_recordings(recordings, SIZES, known())
    assert result.names == ("day0", "day1", "day2")
    assert not result.left_out
    assert not result.moved
    assert largest_error_m(result.landmarks, ROOM) < 0.03
    for one, survey in zip(made, result.surveys, strict=True):
        off = [pose @ one.rig.T_base_left.inverse() for pose in survey.bundle.left_poses()]
        assert np.median([np.linalg.norm(T.t[:2] - true[:2]) for T, true in zip(off, one.truth, strict=True)]) < 0.01


@pytest.mark.slow
@pytest.mark.parametrize(("meters", "degrees"), [(0.05, 0.0), (0.5, 0.0), (0.0, 20.0)])
def test_a_moved_landmark_becomes_two_with_dates(meters, degrees):
    chosen = often_seen(drive(12), 1)
    later = moved_by(ROOM, chosen, meters, degrees)
    recordings = [
        recording(drive(11), "monday"),
        recording(drive(12), "tuesday", DAY_S),
        recording(drive(13, later), "thursday", 3 * DAY_S),
        recording(drive(14, later), "friday", 4 * DAY_S),
    ]
    anchor = next(k for k, m in enumerate(ROOM) if m.id != chosen)
    result = survey_recordings(recordings, SIZES, known(number=anchor))
    assert [m.before.id for m in result.moved] == [chosen]
    moved = result.moved[0]
    assert moved.meters == pytest.approx(meters, abs=0.02)
    assert np.rad2deg(moved.radians) == pytest.approx(degrees, abs=2.0)
    assert (moved.seen_before, moved.seen_after) == (("monday", "tuesday"), ("thursday", "friday"))
    assert DAY_S < moved.before.valid_to_s < DAY_S + 30 < 3 * DAY_S < moved.after.valid_from_s < 3 * DAY_S + 30
    assert largest_error_m(result.landmarks, later) < 0.03
    assert largest_error_m(result.landmarks.at(DAY_S), ROOM) < 0.03


@pytest.mark.slow
def test_a_landmark_that_was_moved_since_the_known_map_is_named():
    rank = [often_seen(drive(11, seconds=20), k) for k in range(3)]
    chosen = next(
        id_ for id_ in rank[1:] if id_ in {o.id for f in drive(12, seconds=20).frames for o in f.detections}
    )
    first = survey_recordings(
        [recording(drive(11, seconds=20), "monday")], SIZES, {rank[0]: Anchor(ROOM.find(rank[0]), None)}
    )
    later = moved_by(ROOM, chosen, 0.4)
    again = [recording(drive(12, later, seconds=20), "tuesday", DAY_S)]
    result = survey_recordings(again, SIZES, anchors_of(first.landmarks))
    [moved] = result.moved
    assert moved.before.id == chosen and moved.meters == pytest.approx(0.4, abs=0.03)
    assert moved.seen_before == ("the known map",)
    assert largest_error_m(result.landmarks, later) < 0.04
    assert largest_error_m(result.landmarks.at(DAY_S - 100), ROOM) < 0.04


@pytest.mark.slow
def test_without_dates_the_recording_given_last_tells_where_a_landmark_is():
    chosen = often_seen(drive(12), 1)
    later = moved_by(ROOM, chosen, 0.3)
    recordings = [recording(drive(11), "first"), recording(drive(12, later), "second")]
    anchor = next(k for k, m in enumerate(ROOM) if m.id != chosen)
    result = survey_recordings(recordings, SIZES, known(number=anchor))
    assert [m.before.id for m in result.moved] == [chosen]
    assert not result.landmarks.past
    assert "overlap" in str(result.moved[0])
    assert largest_error_m(result.landmarks, later) < 0.03


@pytest.mark.slow
def test_a_recording_of_another_room_is_named_and_left_out():
    """The other place has the same codes, but on other walls."""
    codes = [m.id for m in ROOM]
    other = LandmarkMap([replace(m, id=codes[k - 5]) for k, m in enumerate(ROOM)])
    recordings = [
        recording(drive(12, other), "another"),
        recording(drive(11), "first"),
        recording(drive(13), "second"),
    ]
    result = survey_recordings(recordings, SIZES, {})
    assert list(result.left_out) == ["another"]
    assert result.names == ("first", "second")


@pytest.mark.slow
@pytest.mark.parametrize("gone", ["first", "third"])
def test_what_is_left_after_a_contradicted_recording_has_a_frame(monkeypatch, gone):
    """The map has the frame of a recording, also if another recording is left out after the adjustment."""
    recordings = [recording(drive(11 + k, seconds=15), name) for k, name in enumerate(("first", "second", "third"))]
    answers = iter([{gone: "stands elsewhere"}, {}])
    monkeypatch.setattr(JointSolver, "contradicted_recordings", lambda joint: next(answers))
    result = survey_recordings(recordings, SIZES, {})
    assert gone not in result.names and len(result.names) == 2
    deviations_m = [np.sqrt(np.linalg.eigvalsh(m.covariance)[-1]) for m in result.landmarks]
    assert max(deviations_m) < 1.0


def test_a_recording_that_shares_nothing_is_named():
    half = list(ROOM)
    parts = [LandmarkMap(half[:7]), LandmarkMap(half[7:])]
    recordings = [recording(drive(11 + k, part), f"part{k}") for k, part in enumerate(parts)]
    result = survey_recordings(recordings, SIZES, {})
    assert len(result.names) == 1
    assert "shares no landmark" in next(iter(result.left_out.values()))


def test_nothing_to_survey_is_an_error_that_names_a_recording():
    empty = replace(recording(drive(11), "dark"), frames=tuple(replace(f, seen=((), ())) for f in drive(11).frames))
    with pytest.raises(InputError, match="dark"):
        survey_recordings([empty], SIZES, {})


@pytest.mark.slow
def test_recordings_in_frames_of_their_own_are_laid_over_each_other():
    recordings = [recording(drive(seed, seconds=20), f"day{seed}") for seed in (11, 12)]
    result = survey_recordings(recordings, SIZES, {})
    ids = [m.id for m in result.landmarks]
    found = np.array([result.landmarks.find(id_).T_map_landmark.t for id_ in ids])
    true = np.array([ROOM.find(id_).T_map_landmark.t for id_ in ids])
    turn, _ = Rotation.align_vectors(true - true.mean(axis=0), found - found.mean(axis=0))
    off = (found - found.mean(axis=0)) @ turn.as_matrix().T - (true - true.mean(axis=0))
    assert np.linalg.norm(off, axis=1).max() < 0.02
    turns = [turn.as_matrix() @ result.landmarks.find(id_).T_map_landmark.R for id_ in ids]
    apart = [rotation_angle(ROOM.find(id_).T_map_landmark.R.T @ R) for id_, R in zip(ids, turns, strict=True)]
    assert max(apart) < np.deg2rad(3)


@pytest.mark.slow
def test_joint_errors_are_as_the_covariance_says():
    squared = []
    for seed in range(100, 104):
        room = make_drive(seed, seconds=2).landmarks
        recordings = [recording(drive(seed + 1000 * k, room, 20), str(k)) for k in range(1, 4)]
        result = survey_recordings(recordings, {m.id: m.size_m for m in room}, known(room))
        for m in list(result.landmarks):
            off = m.T_map_landmark.t - room.find(m.id).T_map_landmark.t
            if m.id != next(iter(room)).id:
                squared.append(off @ np.linalg.solve(m.covariance[:3, :3], off) / 3)
    assert 0.2 < np.median(squared) < 1.6
