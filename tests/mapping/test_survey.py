"""The map from simulated recordings: exact corners, noisy ones, and what goes wrong in rooms."""

from collections import Counter
from dataclasses import replace
from itertools import combinations, pairwise

import numpy as np
import pytest
from ids import lm8
from scipy.spatial.transform import Rotation

from lmkit.errors import InputError
from lmkit.geometry.pose import Pose
from lmkit.geometry.rig import T_map_cameras, mounted_cameras
from lmkit.geometry.rotations import rotation_angle
from lmkit.mapping.bundle_adjustment import Anchor
from lmkit.mapping.initialization import find_start
from lmkit.mapping.survey import survey_frames
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.recording import RigFrame
from lmkit.odometry.wheel_odometry import MotionModel
from lmkit.simulation.observations import look
from lmkit.simulation.recording import WheelErrors, make_drive
from lmkit.simulation.robot_course import RobotCourse
from lmkit.tracking.online import track_images_live


def survey(drive, wheels=True, frames=None, anchors=1):
    frames = drive.frames if frames is None else frames
    sizes = {m.id: m.size_m for m in drive.landmarks}
    seen = [o.id for frame in frames for o in frame.seen[0]]
    known = {code: Anchor(drive.landmarks.find(code), None) for code in list(dict.fromkeys(seen))[:anchors]}
    motion = MotionModel(drive.odometry, drive.gyro) if wheels else None
    return survey_frames(frames, drive.rig, sizes, known, motion)


def map_errors(drive, result):
    """Meters and rad of every landmark."""
    errors = []
    for m in result.bundle.landmarks:
        true = drive.landmarks.find(m.id).T_map_landmark
        found = m.T_map_landmark
        errors.append((np.linalg.norm(found.t - true.t), rotation_angle(found.R.T @ true.R)))
    return np.array(errors)


@pytest.mark.parametrize("wheels", [False, True])
def test_exact_corners_give_the_exact_map(wheels):
    drive = make_drive(2, seconds=45, noise_px=1e-3)
    result = survey(drive, wheels)
    assert len(result.bundle.landmarks) == len(drive.landmarks)
    assert map_errors(drive, result).max() < 2e-3
    assert not result.contradicted
    assert not result.unplaced


@pytest.mark.slow
def test_noise_gives_errors_as_the_covariance_says():
    squared, far = [], []
    for seed in range(6):
        drive = make_drive(seed, seconds=45, noise_px=0.2, errors=WheelErrors(slips=seed % 2))
        result = survey(drive)
        far.append(map_errors(drive, result)[:, 0].max())
        for m in list(result.bundle.landmarks)[1:]:
            off = m.T_map_landmark.t - drive.landmarks.find(m.id).T_map_landmark.t
            squared.append(off @ np.linalg.solve(m.covariance[:3, :3], off) / 3)
    assert max(far) < 0.12
    assert 0.2 < np.median(squared) < 1.6


@pytest.mark.slow
def test_a_landmark_that_is_moved_during_the_recording_is_named():
    drive = make_drive(2, seconds=60)
    count: dict[int, int] = {}
    for frame in drive.frames:
        for o in frame.seen[0]:
            count[o.id] = count.get(o.id, 0) + 1
    anchor = next(o.id for frame in drive.frames for o in frame.seen[0])
    a, b = [code for code in sorted(count, key=lambda code: -count[code]) if code != anchor][:2]
    late = drive.frames[len(drive.frames) // 2 :]
    swapped = [*drive.frames[: len(drive.frames) // 2], *(swapped_codes(frame, a, b) for frame in late)]
    result = survey(drive, frames=swapped)
    named = {outlier.id for outlier in result.contradicted} | set(result.unplaced)
    assert named & {a, b}
    errors = dict(zip([m.id for m in result.bundle.landmarks], map_errors(drive, result)[:, 0], strict=True))
    assert max(error for code, error in errors.items() if code not in named) < 0.15


def test_a_code_that_is_mounted_twice_is_named_and_does_not_distort_the_map():
    drive = make_drive(2, seconds=60)
    first = drive.frames[: len(drive.frames) // 2]
    early = {o.id for frame in first for o in frame.seen[0]}
    anchor = next(o.id for frame in drive.frames for o in frame.seen[0])
    count = {code: sum(o.id == code for m in first for o in m.seen[0]) for code in early - {anchor}}
    a = max(count, key=lambda code: count[code])
    true = drive.landmarks.find(a).T_map_landmark
    # The landmark farthest from it has the same code.
    b = max(
        (m for m in drive.landmarks if m.id != anchor),
        key=lambda m: np.linalg.norm(m.T_map_landmark.t - true.t),
    ).id
    frames = [relabel(frame, b, a) for frame in drive.frames]
    result = survey(drive, frames=frames)
    (named,) = [outlier for outlier in result.contradicted if outlier.id == a]
    # The place that is not in the map is the other one of the two.
    has, other = (drive.landmarks.find(code).T_map_landmark.t for code in (a, b))
    if np.linalg.norm(result.landmarks.find(a).T_map_landmark.t - has) > 0.5:
        has, other = other, has
    assert named.place is not None and np.linalg.norm(named.place - other) < 0.15
    assert "and show it at x {:.2f} y {:.2f}".format(*named.place) in str(named)
    errors = dict(zip([m.id for m in result.bundle.landmarks], map_errors(drive, result)[:, 0], strict=True))
    assert max(error for code, error in errors.items() if code != a) < 0.15


def relabel(frame, old, new):
    cameras = [tuple(replace(o, id=new) if o.id == old else o for o in seen) for seen in frame.seen]
    return RigFrame(frame.time_s, tuple(cameras), frame.name)


@pytest.mark.slow
def test_an_anchor_that_was_moved_shows_as_a_jump_of_the_robot():
    drive = make_drive(2, seconds=60)
    anchor = next(o.id for frame in drive.frames for o in frame.seen[0])
    other = next(o.id for frame in drive.frames[150:] for o in frame.seen[0] if o.id != anchor)
    half = len(drive.frames) // 2
    frames = [*drive.frames[:half], *(swapped_codes(frame, anchor, other) for frame in drive.frames[half:])]
    result = survey(drive, frames=frames)
    assert result.contradicted or result.bundle.jumps


def swapped_codes(frame, a, b):
    swap = {a: b, b: a}
    cameras = [tuple(replace(o, id=swap.get(o.id, o.id)) for o in seen) for seen in frame.seen]
    return RigFrame(frame.time_s, tuple(cameras), frame.name)


def test_without_landmarks_for_a_while_the_wheels_carry_on():
    drive = make_drive(4, seconds=45)
    blind = [replace(frame, seen=((), ())) if 15 < frame.time_s < 20 else frame for frame in drive.frames]
    result = survey(drive, frames=blind)
    assert len(result.rows) == len(blind)
    for k, R, p in zip(result.rows, result.bundle.poses.R, result.bundle.poses.t, strict=True):
        true = drive.pose(k) @ drive.rig.T_base_left
        assert np.linalg.norm(p - true.t) < 0.15
        assert rotation_angle(R.T @ true.R) < 0.05


def test_with_nothing_known_the_map_is_right_up_to_its_frame():
    drive = make_drive(3, seconds=45)
    result = survey(drive, anchors=0)
    found = {m.id: m.T_map_landmark.t for m in result.bundle.landmarks}
    codes = sorted(found)
    for a, b in pairwise(codes):
        true = [drive.landmarks.find(code).T_map_landmark.t for code in (a, b)]
        assert np.linalg.norm(found[a] - found[b]) == pytest.approx(np.linalg.norm(true[0] - true[1]), abs=0.15)


@pytest.mark.slow
def test_with_nothing_known_and_wheels_the_floor_is_level_at_zero():
    drive = make_drive(3, seconds=30)
    # All landmarks lean forward by 5 deg, also the one that is taken as upright.
    leaning = Rotation.from_rotvec([np.deg2rad(5.0), 0.0, 0.0]).as_matrix()
    mapped = type(drive.landmarks)(
        [
            replace(m, T_map_landmark=Pose("map", "landmark", m.T_map_landmark.R @ leaning, m.T_map_landmark.t))
            for m in drive.landmarks
        ]
    )
    rng = np.random.default_rng(0)
    frames = [
        RigFrame(m.time_s, look(mapped, drive.rig, drive.pose(k), 0.1, rng)) for k, m in enumerate(drive.frames)
    ]
    drive = replace(drive, landmarks=mapped, frames=frames)
    result = survey(drive, anchors=0)
    T_left_base = drive.rig.T_base_left.inverse()
    bases = [pose @ T_left_base for pose in result.bundle.left_poses()]
    assert max(abs(base.t[2]) for base in bases) < 0.03
    assert max(np.arccos(min(1.0, base.R[2, 2])) for base in bases) < np.deg2rad(1.0)
    # Live tracking works with that map.
    tracked = track_images_live(drive.frames, drive.rig, result.landmarks, drive.odometry, drive.gyro)
    assert not tracked.remarks
    assert np.mean([status == "ok" for status in tracked.statuses]) > 0.95


def test_a_map_whose_floor_is_elsewhere_is_named_when_tracking_live():
    drive = make_drive(3, seconds=20)
    raised = [
        replace(
            m, T_map_landmark=Pose("map", "landmark", m.T_map_landmark.R, m.T_map_landmark.t + np.array([0, 0, 0.4]))
        )
        for m in drive.landmarks
    ]
    mapped = type(drive.landmarks)(raised)
    tracked = track_images_live(drive.frames, drive.rig, mapped, drive.odometry, drive.gyro)
    assert "z = 0.40 m" in tracked.remarks[0]
    assert not track_images_live(drive.frames, drive.rig, drive.landmarks, drive.odometry, drive.gyro).remarks


def test_an_anchor_that_is_not_in_the_recording_is_refused():
    drive = make_drive(3, seconds=20)
    code = next(lm8(code) for code in range(256) if lm8(code) not in drive.landmarks)
    some = next(iter(drive.landmarks))
    known = {code: Anchor(replace(some, id=code), None)}
    with pytest.raises(InputError, match="none of the known landmarks"):
        survey_frames(drive.frames, drive.rig, {some.id: 0.18}, known)


def test_wheels_need_to_know_where_the_camera_sits():
    drive = make_drive(3, seconds=20)
    with pytest.raises(InputError, match="T_base_left"):
        survey_frames(
            drive.frames,
            replace(drive.rig, T_base_left=None),
            {m.id: 0.18 for m in drive.landmarks},
            {},
            MotionModel(drive.odometry),
        )


@pytest.mark.slow
def test_without_wheels_a_second_pose_that_distorts_the_map_shows_as_a_jump():
    """Only one landmark connects two parts of the room, and its second pose rotates them by 13 deg."""
    drive = make_drive(7, seconds=120, errors=WheelErrors(slips=1))
    result = survey(drive, wheels=False, anchors=0)
    found = {m.id: m.T_map_landmark.t for m in result.bundle.landmarks}
    true = {code: drive.landmarks.find(code).T_map_landmark.t for code in found}
    off = [
        abs(np.linalg.norm(found[a] - found[b]) - np.linalg.norm(true[a] - true[b]))
        for a, b in combinations(found, 2)
    ]
    assert max(off) < 0.2 or result.bundle.jumps


def test_a_known_map_of_zero_covariance_is_exact():
    drive = make_drive(3, seconds=20)
    seen = {o.id for frame in drive.frames for o in frame.seen[0]}
    known = {code: Anchor(drive.landmarks.find(code), np.zeros((6, 6))) for code in seen}
    result = survey_frames(drive.frames, drive.rig, dict.fromkeys(seen, 0.18), known)
    assert map_errors(drive, result).max() < 1e-4


def test_landmarks_of_two_families_may_share_a_code():
    drive = make_drive(3, seconds=40)
    seen = list(dict.fromkeys(o.id for frame in drive.frames for o in frame.seen[0]))
    a, b = seen[:2]

    def renamed(observations):
        return tuple(replace(o, id=LandmarkId("lm12", a.code)) if o.id == b else o for o in observations)

    frames = [RigFrame(m.time_s, tuple(map(renamed, m.seen))) for m in drive.frames]
    mapped = {
        a: drive.landmarks.find(a),
        LandmarkId("lm12", a.code): replace(drive.landmarks.find(b), id=LandmarkId("lm12", a.code)),
    }
    known = {key: Anchor(landmark, None) for key, landmark in mapped.items()}
    sizes = {o.id: 0.18 for m in frames for o in m.seen[0]}
    result = survey_frames(frames, drive.rig, sizes, known)
    for key, landmark in mapped.items():
        found = result.landmarks.find(key)
        assert np.linalg.norm(found.T_map_landmark.t - landmark.T_map_landmark.t) < 1e-4


def test_what_the_first_pass_leaves_out_is_taken_up_and_the_map_stays_uncertain(monkeypatch):
    """The second pass uses the map of the first one as a start, but no more prior knowledge than the first one."""
    drive = make_drive(2, seconds=20)
    passes = []

    def forgetful(*arguments):
        start = find_start(*arguments)
        passes.append(start)
        late = 80 if len(passes) == 1 else len(start.poses)
        return replace(start, poses=[pose if k < late else None for k, pose in enumerate(start.poses)])

    monkeypatch.setattr("lmkit.mapping.survey.find_start", forgetful)
    result = survey(drive)
    assert len(passes) == 2
    assert len(result.rows) == len(drive.frames) > 80
    exact = [m.id for m in result.bundle.landmarks if m.covariance.max() < 1e-9]
    assert exact == list(passes[0].anchors)


def test_without_odometry_the_assumed_motion_does_not_draw_the_map_together():
    course = RobotCourse(3601, 33.0, 8)
    assert course.rig.T_base_left is not None
    frames = []
    for time_s in np.arange(1.0, 33.0, 0.5).tolist():
        T = course.T_map_base(time_s)
        cameras = zip(mounted_cameras(course.rig), T_map_cameras(course.rig, T @ course.rig.T_base_left), strict=True)
        exact = [(camera.model, at.inverse()) for camera, at in cameras]
        seen = tuple(
            tuple(replace(o, corners=model.project(at.apply(course.landmarks.find(o.id).corners_map))) for o in some)
            for some, (model, at) in zip(course.corners(T), exact, strict=True)
        )
        frames.append(RigFrame(time_s, seen, ""))
    known = Counter(o.id for frame in frames for o in frame.detections).most_common(1)[0][0]
    sizes = {m.id: m.size_m for m in course.landmarks}
    found = survey_frames(frames, course.rig, sizes, {known: Anchor(course.landmarks.find(known), None)})
    places = np.array([(m.T_map_landmark.t, course.landmarks.find(m.id).T_map_landmark.t) for m in found.landmarks])
    mine, true = (places - places.mean(axis=0)).transpose(1, 0, 2)
    assert (mine * true).sum() / (true**2).sum() == pytest.approx(1, abs=5e-4)
