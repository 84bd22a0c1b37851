"""A drive through a known map: what `lmkit track` gives, whatever saw the landmarks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from lmkit.arrays import BoolArray, FloatArray, IntArray
from lmkit.locate.rig import locate_rig
from lmkit.model.drive import Gyro, Odometry, StereoMoment
from lmkit.model.landmark_map import LandmarkMap, MappedLandmark, wall_pose
from lmkit.model.observation import RangeBearing
from lmkit.model.pose import Pose, planar_pose, skew
from lmkit.model.stereo_rig import StereoRig
from lmkit.model.trajectory import Trajectory
from lmkit.motion import PARAMETERS, Motion, MotionModel, describe_odometry
from lmkit.pose_motion import PoseMotion
from lmkit.room_plan import ahead_of
from lmkit.survey.bundle import Anchor
from lmkit.survey.start import find_start
from lmkit.survey.survey import OUTLIER_SIGMA, odd_landmarks, settle_all
from lmkit.track.planar_filter import PlanarFilter, TrackedPose
from lmkit.track.planar_smoother import smooth_planar
from lmkit.track.pose_filter import PoseFilter, SpacePose
from lmkit.track.rig_filter import RigFilter
from lmkit.track.wheels import Wheels

LOST_M = 1.0  # a position less sure than that is worth no word
OUTLIER_WEIGHT = 0.1
FLOOR_LOOKS, OFF_FLOOR_M = 5, 0.1
UNSEEN_M, UNSEEN_RAD = 1.0, 1.0  # heights and directions that ranges and bearings do not show


@dataclass(frozen=True, eq=False)
class TrackedDrive:
    """The robot at every moment.

    Attributes:
        times_s: (N,).
        poses: of the base where there is one, else of the left camera.
        covariances: (N,6,6) x y z (m), rotation about x y z (rad), in the map.
        statuses: ``ok``, ``ambiguous`` or ``lost``.
        outliers: codes that were not believed.
        parameters: what is wrong with the odometry, by name.
        of_base: the poses look along x, not along z.
        remarks: what a user should look after.
        innovations: (N,2) of what was believed at every moment: the sum of its squared errors, in standard
            deviations, and how many numbers that is of.  Live they are those of the prediction, else what is left
            once the drive is solved.
    """

    times_s: FloatArray
    poses: Sequence[Pose]
    covariances: FloatArray
    statuses: Sequence[str]
    outliers: Sequence[tuple[int, ...]]
    parameters: dict[str, float] = field(default_factory=dict)
    of_base: bool = True
    remarks: tuple[str, ...] = ()
    innovations: FloatArray = field(default_factory=lambda: np.zeros((0, 2)))

    def looking(self, k: int) -> Pose:
        """As a camera's pose that looks where the robot does, to draw it."""
        return ahead_of(self.poses[k]) if self.of_base else self.poses[k]


Moments = Sequence[tuple[float, Sequence[RangeBearing]]]


def track_readings(moments: Moments, odometry: Odometry, gyro: Gyro | None, landmarks: LandmarkMap) -> TrackedDrive:
    """All of the drive at once, from ranges and bearings (`planar_smoother.py`)."""
    times, motion = np.array([time_s for time_s, _ in moments]), MotionModel(odometry, gyro)
    motion.require_overlap(times)
    track = smooth_planar(times, [seen for _, seen in moments], motion, landmarks)
    outliers: list[tuple[int, ...]] = [() for _ in moments]
    for row in np.flatnonzero(track.weights < OUTLIER_WEIGHT):
        outliers[track.moments[row]] += (track.codes[track.landmarks[row]],)
    C = track.covariances
    lost = np.sqrt(np.linalg.eigvalsh(C[:, :2, :2])[:, -1]) > LOST_M
    return TrackedDrive(
        times,
        [planar_pose(state) for state in track.states],
        _six(C),
        ["lost" if far else "ok" for far in lost],
        outliers,
        dict(zip(PARAMETERS, track.parameters.tolist(), strict=True)),
        remarks=_doubts(motion, track.parameters),
        innovations=_summed(len(times), track.moments, track.squared, track.told, track.weights > OUTLIER_WEIGHT),
    )


def track_live(moments: Moments, odometry: Odometry, gyro: Gyro | None, landmarks: LandmarkMap) -> TrackedDrive:
    """Moment by moment, as while driving (`planar_filter.py`); moments before the first fix are left out."""
    filter_ = PlanarFilter(landmarks)
    times = [time_s for time_s, _ in moments]
    answers = _live(times, lambda k: filter_.observe(*moments[k]), filter_.wheels, odometry, gyro)
    return _tracked(answers, filter_.parameters)


def track_pictures_live(
    moments: Sequence[StereoMoment], rig: StereoRig, landmarks: LandmarkMap, odometry: Odometry, gyro: Gyro | None
) -> TrackedDrive:
    """Moment by moment, from the corners that both eyes saw (`rig_filter.py`), on a level floor.

    Raises:
        InputError: the rig has no T_base_left, or odometry of another time.
    """
    filter_ = RigFilter(landmarks, rig)
    times = [moment.time_s for moment in moments]

    def observe(k: int) -> TrackedPose:
        return filter_.observe(times[k], moments[k].left, moments[k].right)

    tracked = _tracked(_live(times, observe, filter_.wheels, odometry, gyro), filter_.parameters)
    return replace(tracked, remarks=(*_floor_doubt(moments, rig, landmarks), *tracked.remarks))


def track_poses_live(
    moments: Sequence[StereoMoment], rig: StereoRig, landmarks: LandmarkMap, odometry: Trajectory
) -> TrackedDrive:
    """Moment by moment through space, by corners and odometry's poses (`pose_filter.py`).

    Moments before the first fix are left out.

    Raises:
        InputError: odometry of another time.
    """
    PoseMotion(odometry).require_overlap(np.array([moment.time_s for moment in moments]))
    filter_, given, answers = PoseFilter(landmarks, rig), 0, []
    for moment in moments:
        while given < len(odometry) and odometry.times_s[given] <= moment.time_s:
            filter_.add_odometry(float(odometry.times_s[given]), odometry.pose(given, "odometry", "base"))
            given += 1
        answer = filter_.observe(moment.time_s, moment.left, moment.right)
        if answer.T_map_left is not None:
            answers.append(answer)
    poses, covariances = _at_base(
        [answer.T_map_left for answer in answers if answer.T_map_left is not None],
        np.array([answer.covariance for answer in answers]).reshape(-1, 6, 6),
        rig,
    )
    return TrackedDrive(
        np.array([answer.time_s for answer in answers]),
        poses,
        covariances,
        [answer.status for answer in answers],
        [answer.outliers for answer in answers],
        of_base=rig.T_base_left is not None,
        remarks=_carried_off(answers, "odometry says"),
        innovations=_innovations(answers),
    )


def _live(
    times_s: Sequence[float],
    observe: Callable[[int], TrackedPose],
    wheels: Wheels,
    odometry: Odometry,
    gyro: Gyro | None,
) -> list[TrackedPose]:
    """Rows and moments in the order of time; moments before the first fix are left out."""
    MotionModel(odometry, gyro).require_overlap(np.array(times_s))
    rows = [
        (float(t), 0, float(f), float(w))
        for t, f, w in zip(odometry.times_s, odometry.forward_m, odometry.turn_rad, strict=True)
    ]
    if gyro is not None:
        rows += [(float(t), 1, float(rate), 0.0) for t, rate in zip(gyro.times_s, gyro.rate_radps, strict=True)]
    rows.sort()
    given, answers = 0, []
    for k, time_s in enumerate(times_s):
        while given < len(rows) and rows[given][0] <= time_s:
            time, kind, a, b = rows[given]
            if kind == 0:
                wheels.add_odometry(time, a, b)
            else:
                wheels.add_gyro(time, a)
            given += 1
        answer = observe(k)
        if answer.state is not None and answer.covariance is not None:
            answers.append(answer)
    return answers


def _tracked(answers: Sequence[TrackedPose], parameters: FloatArray) -> TrackedDrive:
    return TrackedDrive(
        np.array([answer.time_s for answer in answers]),
        [planar_pose(answer.state) for answer in answers if answer.state is not None],
        _six(np.array([answer.covariance for answer in answers]).reshape(-1, 3, 3)),
        [answer.status for answer in answers],
        [answer.outliers for answer in answers],
        dict(zip(PARAMETERS, parameters.tolist(), strict=True)),
        remarks=_carried_off(answers, "its wheels say"),
        innovations=_innovations(answers),
    )


def _innovations(answers: Sequence[TrackedPose] | Sequence[SpacePose]) -> FloatArray:
    return np.array([(answer.innovation, answer.told) for answer in answers]).reshape(-1, 2)


def _summed(count: int, moments: IntArray, squared: FloatArray, told: FloatArray, believed: BoolArray) -> FloatArray:
    """(N,2) sums by moment of (R,) squared errors and of how many numbers they are of."""
    rows = moments[believed]
    return np.column_stack([np.bincount(rows, values[believed], count) for values in (squared, told)])


def _carried_off(answers: Sequence[TrackedPose] | Sequence[SpacePose], but: str) -> tuple[str, ...]:
    return tuple(
        f"at {answer.time_s:.2f} s the robot was somewhere else than {but}: carried off?"
        for answer in answers[1:]
        if answer.restarted
    )


def _at_base(poses: Sequence[Pose], covariances: FloatArray, rig: StereoRig) -> tuple[list[Pose], FloatArray]:
    """Poses of the left camera, with their covariances, as those of the robot's base where the rig names one."""
    T = rig.T_base_left
    if T is None:
        return list(poses), covariances
    T_left_base = T.inverse()
    moved = np.tile(np.eye(6), (len(poses), 1, 1))
    for J, pose in zip(moved, poses, strict=True):
        J[:3, 3:] = -skew(pose.R @ T_left_base.t)
    return [pose @ T_left_base for pose in poses], moved @ covariances @ moved.transpose(0, 2, 1)


def survey_readings(
    moments: Moments, odometry: Odometry, gyro: Gyro | None, size_m: float
) -> tuple[LandmarkMap, TrackedDrive]:
    """Where the landmarks stand, from ranges and bearings alone; the map's origin is the robot's first pose.

    Heights and the way that landmarks face are not seen: they hang at height 0 and face the drive's middle, with
    covariances that say so.
    """
    times, motion = np.array([time_s for time_s, _ in moments]), MotionModel(odometry, gyro)
    motion.require_overlap(times)
    track = smooth_planar(times, [seen for _, seen in moments], motion, None)
    middle = track.states[:, :2].mean(axis=0)
    hung = []
    for code, place, C in zip(track.codes, track.places, track.place_covariances, strict=True):
        if not np.isfinite(place).all():
            continue
        towards = middle - place
        covariance = np.diag([0.0, 0.0, UNSEEN_M**2, *[UNSEEN_RAD**2] * 3])
        covariance[:2, :2] = C
        T = wall_pose([*place, 0.0], float(np.arctan2(towards[1], towards[0])))
        hung.append(MappedLandmark(code, "lm8", size_m, T, covariance))
    drive = TrackedDrive(
        times,
        [planar_pose(state) for state in track.states],
        _six(track.covariances),
        ["ok"] * len(times),
        [()] * len(times),
    )
    return LandmarkMap(hung), drive


def track_pictures(
    moments: Sequence[StereoMoment],
    rig: StereoRig,
    landmarks: LandmarkMap,
    motion: Motion | None,
) -> TrackedDrive:
    """All of the drive at once, from what both eyes saw: bundle adjustment with the map held.

    Landmarks that the map knows exactly do not move; those that it knows with a covariance may, as far as that
    allows, so that what the map leaves open enters the poses' covariance.

    Raises:
        InputError: no landmark of the map is in view, or odometry without T_base_left or of another time.
    """
    known = {(m.family, m.code): Anchor(m, m.covariance) for m in landmarks}
    start = find_start(moments, rig, {}, known, motion)
    # Exactly known, they are held and need no unknowns of their own.
    exact = all(m.covariance is None for m in landmarks)
    problem = start.problem(moments, rig, motion, frozen=exact)
    settle_all(problem)
    bundle = problem.answer(OUTLIER_SIGMA)
    found, covariances = _at_base(bundle.left_poses(), np.array(bundle.covariances), rig)
    outliers: list[tuple[int, ...]] = [() for _ in start.rows]
    for row in np.flatnonzero(bundle.misfits > OUTLIER_SIGMA):
        outliers[bundle.moments[row]] += (int(bundle.codes[row]),)
    wide = np.sqrt(np.linalg.eigvalsh(covariances[:, :2, :2])[:, -1]) > LOST_M
    return TrackedDrive(
        bundle.times_s,
        found,
        covariances,
        ["lost" if far else "ok" for far in wide],
        outliers,
        {} if motion is None else dict(zip(motion.names, bundle.parameters.tolist(), strict=True)),
        rig.T_base_left is not None,
        (*map(str, odd_landmarks(bundle)), *_doubts(motion, bundle.parameters)),
        _summed(
            len(start.rows),
            bundle.moments,
            8 * bundle.misfits**2,
            np.full(len(bundle.misfits), 8.0),
            bundle.misfits < OUTLIER_SIGMA,
        ),
    )


def _floor_doubt(moments: Sequence[StereoMoment], rig: StereoRig, landmarks: LandmarkMap) -> tuple[str, ...]:
    """A sentence where the robot does not stand on the map's floor, as the moments that see most have it."""
    assert rig.T_base_left is not None
    base = rig.T_base_left.inverse().t  # in the left camera
    heights = []
    for moment in sorted(moments, key=lambda moment: -len(moment.left) - len(moment.right))[:FLOOR_LOOKS]:
        found = locate_rig(moment.left, moment.right, rig, landmarks)
        if found.status == "ok" and found.T_map_camera is not None:
            heights.append(float((found.T_map_camera.t + found.T_map_camera.R @ base)[2]))
    if not heights or abs(np.median(heights)) < OFF_FLOOR_M:
        return ()
    return (
        f"the robot stands at z = {np.median(heights):.2f} m of the map, and tracking live by wheels takes the floor "
        "to be z = 0; shift the map's heights, or track without --live",
    )


def _doubts(motion: Motion | None, parameters: FloatArray) -> tuple[str, ...]:
    doubt = None if motion is None else describe_odometry(motion, parameters)
    return () if doubt is None else (doubt,)


def _six(C: FloatArray) -> FloatArray:
    """(N,6,6) of (N,3,3) of x, y, heading; nothing is said of the rest."""
    six = np.zeros((len(C), 6, 6))
    places = np.array([0, 1, 5])
    six[:, places[:, None], places[None]] = C
    return six
