"""A simulated recording: a wheeled robot in a room, with detections, wheel odometry and gyro.

Corners are simulated, not images.  Wheels have errors of real ones (MRCLAM: distance and turn too large, a quarter
of a second early; occasional slips), and the gyro drifts.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.geometry.planar import planar_pose, wrap_heading
from lmkit.geometry.pose import Pose
from lmkit.geometry.rig import AnyRig, mounted_cameras
from lmkit.model.families import MarkerFamily
from lmkit.model.landmark import LM8
from lmkit.model.landmark_map import LandmarkMap
from lmkit.model.observation import RangeBearing
from lmkit.model.recording import Gyro, Odometry, RigFrame
from lmkit.model.trajectory import Trajectory
from lmkit.simulation.observations import Seen, look
from lmkit.simulation.scene import make_rig, mount_landmarks

STEP_S = 0.02
SPIN_RADPS = 0.7  # yaw rate of a robot that turns on the spot
HEIGHT_M = 2.6
# Pose of the left camera on the robot: forward, left, up, and looking ahead.
T_BASE_LEFT = Pose(
    "base", "left", np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]), np.array([0.1, 0.06, 0.85])
)


@dataclass(frozen=True)
class WheelErrors:
    """Errors of wheels and gyro.

    Attributes:
        forward_scale, turn_scale: true over reported.
        delay_s: delay of the robot's motion behind the wheel odometry.
        noise_per_root_m, turn_noise_per_root_m: random walk, meters and rad per square root of a meter.
        track_m: distance between the wheels; in a turn, each wheel travels half of it per radian.
        slips: times of slips, by up to 0.1 m and 0.1 rad, that the wheels do not measure.
        gyro_bias, gyro_noise: rad/s.
    """

    forward_scale: float = 0.92
    turn_scale: float = 0.9
    delay_s: float = 0.25
    noise_per_root_m: float = 0.01
    turn_noise_per_root_m: float = 0.01
    track_m: float = 0.0
    slips: int = 0
    gyro_bias: float = 0.005
    gyro_noise: float = 0.01


@dataclass(frozen=True, eq=False)
class Drive:
    """A recording and its truth.

    Attributes:
        landmarks: true landmarks.
        rig: with its T_base_left.
        times_s: (N,) of the frames.
        truth: (N,3) x, y (m), heading (rad) of the base.
        frames: detections of both cameras.
        odometry, gyro: measurements of the robot's own sensors.
    """

    landmarks: LandmarkMap
    rig: AnyRig
    times_s: FloatArray
    truth: FloatArray
    frames: tuple[RigFrame, ...]
    odometry: Odometry
    gyro: Gyro

    def pose(self, k: int) -> Pose:
        """T_map_base of a frame."""
        return planar_pose(self.truth[k])

    def visual_odometry(
        self, seed: int, place_per_root_m: float = 0.01, turn_per_root_m: float = 0.004
    ) -> Trajectory:
        """Poses of the base in an arbitrary frame, with a random-walk drift in all six directions."""
        rng = np.random.default_rng([seed, 4])
        true = [self.pose(k) for k in range(len(self.times_s))]
        T = Pose.from_rvec("odometry", "base", rng.normal(size=3), rng.normal(size=3))
        poses = [T]
        for before, after in pairwise(true):
            step = before.inverse() @ after
            root = np.sqrt(np.linalg.norm(step.t))
            drift = Pose.from_rvec(
                "base",
                "base",
                turn_per_root_m * root * rng.normal(size=3),
                place_per_root_m * root * rng.normal(size=3),
            )
            T = T @ Pose("base", "base", step.R, step.t) @ drift
            poses.append(T)
        return Trajectory(self.times_s, np.array([T.t for T in poses]), np.array([T.quaternion_xyzw for T in poses]))

    def readings(
        self, seed: int, range_share: float = 0.03, bearing_rad: float = 0.01
    ) -> list[tuple[float, list[RangeBearing]]]:
        """Ranges and bearings to visible landmarks, from a planar sensor at the base's origin."""
        rng = np.random.default_rng([seed, 3])
        answers = []
        for state, frame in zip(self.truth, self.frames, strict=True):
            seen = []
            for id_ in sorted({o.id for o in frame.seen[0]}):
                landmark = self.landmarks.find(id_)
                assert landmark is not None
                off = landmark.T_map_landmark.t[:2] - state[:2]
                distance = float(np.hypot(*off)) * (1 + range_share * rng.normal())
                bearing = float(np.arctan2(off[1], off[0]) - state[2] + bearing_rad * rng.normal())
                seen.append(RangeBearing(id_, distance, wrap_heading(bearing)))
            answers.append((frame.time_s, seen))
        return answers


def make_drive(
    seed: int,
    seconds: float = 60.0,
    hz: float = 5.0,
    count: int = 14,
    size_m: tuple[float, float] = (8.0, 5.0),
    errors: WheelErrors | None = None,
    noise_px: float = 0.15,
    rig: AnyRig | None = None,
    landmarks: LandmarkMap | None = None,
    family: MarkerFamily = LM8,
    eights: bool = False,
    spins: int = 0,
) -> Drive:
    """A recording in rounds through a room with ``count`` landmarks on its walls.

    Args:
        landmarks: landmarks of another recording, to use the same room again; None: new landmarks.
        rig: rig with T_base_left; None: a stereo pair that looks ahead.
        family: of the landmarks.
        eights: figures of eight instead of rounds, with curves to both sides.
        spins: rotations on the spot to each side, after ``seconds`` of driving.

    Cameras of the rig with a ``time_offset_s`` are exposed later than their frame by this offset.
    """
    rng = np.random.default_rng([seed, 0])
    codes = [int(code) for code in rng.permutation(family.code_count)[:count]]
    landmarks = landmarks or LandmarkMap(mount_landmarks(rng, family, codes, (*size_m, HEIGHT_M)))
    fine, truth = _with_spins(*(_figure_eight if eights else _round_trip)(rng, seconds, size_m), spins)
    errors = errors or WheelErrors()
    truth = _slip(rng, fine, truth, errors.slips)
    rig = rig or replace(make_rig(), T_base_left=T_BASE_LEFT)
    rows = np.arange(0, len(fine) - 1, round(1 / hz / STEP_S))
    # The first frames are before the wheels' delay.
    rows = rows[fine[rows] > errors.delay_s]
    late_s = np.array([camera.time_offset_s for camera in mounted_cameras(rig)])
    frames = []
    for k in rows:
        seen = _look(landmarks, rig, fine, truth, fine[k] + late_s, noise_px, rng)
        frames.append(RigFrame(float(fine[k]), seen, f"{fine[k]:.2f}"))
    odometry, gyro = _wheels(rng, fine, truth, errors)
    return Drive(landmarks, rig, fine[rows], truth[rows], tuple(frames), odometry, gyro)


def _look(
    landmarks: LandmarkMap,
    rig: AnyRig,
    times_s: FloatArray,
    truth: FloatArray,
    then_s: FloatArray,
    noise_px: float,
    rng: np.random.Generator,
) -> tuple[Seen, ...]:
    """Detections of every camera, each at its own time (C,)."""
    states = np.column_stack([np.interp(then_s, times_s, column) for column in truth.T])
    if (then_s == then_s[0]).all():
        return look(landmarks, rig, planar_pose(states[0]), noise_px, rng)
    return tuple(look(landmarks, rig, planar_pose(state), noise_px, rng)[k] for k, state in enumerate(states))


def _round_trip(
    rng: np.random.Generator, seconds: float, size_m: tuple[float, float]
) -> tuple[FloatArray, FloatArray]:
    """Times, and x, y, heading along a wavy round trip at about 0.35 m/s."""
    times = np.arange(0, seconds, STEP_S)
    rx, ry = 0.28 * size_m[0], 0.25 * size_m[1]
    speed = 0.35 / max(rx, ry)
    phase, wave = rng.uniform(0, 2 * np.pi, 2)
    a = phase + speed * times
    swing = 1 + 0.12 * np.sin(3 * a + wave)
    x, y = size_m[0] / 2 + rx * swing * np.cos(a), size_m[1] / 2 + ry * swing * np.sin(a)
    heading = np.unwrap(np.arctan2(np.gradient(y), np.gradient(x)))
    return times, np.column_stack([x, y, heading])


def _figure_eight(
    rng: np.random.Generator, seconds: float, size_m: tuple[float, float]
) -> tuple[FloatArray, FloatArray]:
    """Times, and x, y, heading along figures of eight (Gerono's lemniscate) at about 0.35 m/s."""
    times = np.arange(0, seconds, STEP_S)
    rx, ry = 0.3 * size_m[0], 0.28 * size_m[1]
    a = rng.uniform(0, 2 * np.pi) + 0.35 / max(rx, ry) * times
    x, y = size_m[0] / 2 + rx * np.sin(a), size_m[1] / 2 + ry * np.sin(2 * a)
    heading = np.unwrap(np.arctan2(np.gradient(y), np.gradient(x)))
    return times, np.column_stack([x, y, heading])


def _with_spins(times: FloatArray, truth: FloatArray, spins: int) -> tuple[FloatArray, FloatArray]:
    """Times and path, with rotations on the spot to each side at the end."""
    there = np.arange(SPIN_RADPS * STEP_S, 2 * np.pi * spins, SPIN_RADPS * STEP_S)
    turned = truth[-1] + np.concatenate([there, there[::-1]])[:, None] * np.array([0.0, 0.0, 1.0])
    path = np.concatenate([truth, turned])
    return STEP_S * np.arange(len(path)), path


def _slip(rng: np.random.Generator, times: FloatArray, truth: FloatArray, slips: int) -> FloatArray:
    """Path with slips: each slip moves the rest of the recording."""
    moved = truth.copy()
    for k in rng.integers(len(times) // 5, len(times), slips):
        turn, shift = rng.uniform(-0.1, 0.1), rng.uniform(-0.1, 0.1, 2)
        c, s = np.cos(turn), np.sin(turn)
        off = moved[k:, :2] - moved[k, :2]
        moved[k:, 0] = moved[k, 0] + c * off[:, 0] - s * off[:, 1] + shift[0]
        moved[k:, 1] = moved[k, 1] + s * off[:, 0] + c * off[:, 1] + shift[1]
        moved[k:, 2] += turn
    return moved


def _wheels(
    rng: np.random.Generator, times: FloatArray, truth: FloatArray, errors: WheelErrors
) -> tuple[Odometry, Gyro]:
    step = np.diff(truth, axis=0)
    middle = truth[:-1, 2] + step[:, 2] / 2
    forward = np.cos(middle) * step[:, 0] + np.sin(middle) * step[:, 1]
    # Wheels do not measure slips.
    slid = (np.abs(forward) > 0.02) | (np.abs(step[:, 2]) > 0.05)
    forward, turn = np.where(slid, 0.0, forward), np.where(slid, 0.0, step[:, 2])
    root = np.sqrt(np.abs(forward) + errors.track_m / 2 * np.abs(turn))
    reported = forward / errors.forward_scale + errors.noise_per_root_m * root * rng.normal(size=len(root))
    turned = turn / errors.turn_scale + errors.turn_noise_per_root_m * root * rng.normal(size=len(root))
    own = times[1:] - errors.delay_s
    rate = step[:, 2] / STEP_S + errors.gyro_bias + errors.gyro_noise * rng.normal(size=len(root))
    # The mean rate of a step is the rate at its midpoint.
    return Odometry(own, reported, turned), Gyro(own - STEP_S / 2, rate)
