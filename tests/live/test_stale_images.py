"""Repeated old images are named and withheld; a robot that stands still causes no alarm."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lmkit.live.dead_reckoning import DeadReckoning
from lmkit.live.motion import GYRO, WHEELS, MotionRow
from lmkit.live.stale_images import STILL_PX, StaleImages
from lmkit.simulation.recording import WheelErrors
from lmkit.simulation.robot_course import RobotCourse

HZ = 15
SECONDS = 10.0
LAG_S = WheelErrors().delay_s


@cache
def course(seed: int) -> RobotCourse:
    return RobotCourse(seed, SECONDS)


def seen_at(seed: int, time_s: float):
    return course(seed).corners(course(seed).T_map_base(time_s))


def noisy(seen, rng: np.random.Generator, px: float = 0.15):
    return tuple([replace(d, corners=d.corners + rng.normal(0, px, (4, 2))) for d in found] for found in seen)


def rows(seed: int, after: float, until: float) -> list[MotionRow]:
    wheels, gyro = course(seed).motion(after, until)
    made = [MotionRow(WHEELS, t, (f, w)) for t, f, w in wheels.tolist()]
    return sorted(made + [MotionRow(GYRO, t, (w,)) for t, w in gyro.tolist()], key=lambda row: row.time_s)


def accused(seed, shown, until=math.inf, frames=range(15, 105), motion="wheels") -> dict[str, int]:
    """First frame at which each camera is named.

    Args:
        shown: the views of a frame.
        until: time until which the wheels move; the robot moves `LAG_S` later.
    """
    stale = StaleImages(course(seed).rig, course(seed).landmarks, motion != "none")
    named: dict[str, int] = {}
    last = 0.0
    for k in frames:
        for row in rows(seed, last, k / HZ):
            stale.add(row if row.time_s <= until else replace(row, values=(0.0,) * len(row.values)))
        last = k / HZ
        for event in stale.withheld(last, shown(k), LAG_S)[1]:
            if event.code == "camera_stale":
                named.setdefault(event.message.split()[1], k)
    return named


@pytest.mark.slow
@settings(max_examples=5)
@given(st.integers(1, 8), st.sampled_from(["left", "right", "both"]), st.integers(30, 80))
def test_a_view_that_stands_still_while_the_wheels_move_is_named(seed, which, at):
    rng = np.random.default_rng(seed)
    frozen = seen_at(seed, at / HZ)
    cameras = {"left": [0], "right": [1], "both": [0, 1]}[which]

    def shown(k: int):
        now = seen_at(seed, k / HZ)
        old = noisy(frozen, rng)
        return tuple(old[c] if k >= at and c in cameras else now[c] for c in range(2))

    named = accused(seed, shown)
    assert set(named) == {("left", "right")[c] for c in cameras if frozen[c]}
    assert all(k - at <= 1.5 * HZ for k in named.values())


@settings(max_examples=5)
@given(st.integers(1, 8), st.booleans())
def test_neither_a_robot_that_drives_nor_one_that_stands_is_accused(seed, drives):
    rng = np.random.default_rng(seed)
    stop = 120 if drives else 50
    assert not accused(seed, lambda k: noisy(seen_at(seed, min(k, stop) / HZ), rng), stop / HZ - LAG_S)


def test_without_odometry_the_other_camera_tells():
    rng = np.random.default_rng(1)
    old = seen_at(1, 4.0)
    assert all(old)
    named = accused(1, lambda k: (noisy(old, rng)[0], seen_at(1, k / HZ)[1]) if k >= 60 else seen_at(1, k / HZ),
                    motion="none")  # fmt: skip
    assert set(named) == {"left"}


def test_neither_a_gyro_s_bias_nor_one_wheel_turns_a_robot_that_stands():
    odometry = DeadReckoning()
    for k in range(500):
        odometry.add(MotionRow(GYRO, k / 50, (0.02,)))
        odometry.add(MotionRow(WHEELS, k / 50, (0.0, 0.0 if k < 250 else -0.02)))
    assert np.allclose(odometry.at(10.0).R, np.eye(3))


@pytest.mark.slow
@pytest.mark.parametrize("quality", [95, 60])
def test_an_image_that_is_encoded_anew_stands_still_within_the_threshold(quality):
    from lmkit.detection.config import DetectOptions
    from lmkit.detection.detector import detect_landmarks
    from lmkit.model.landmark import LM8

    image = course(1).images(course(1).T_map_base(4.0))[0]
    found = [
        {d.id: d.corners for d in detect_landmarks(cv2.imdecode(cv2.imencode(".jpg", image, [1, q])[1], 1),
                                                   DetectOptions((LM8,)))}
        for q in (quality, quality - 5)
    ]  # fmt: skip
    both = found[0].keys() & found[1].keys()
    assert both
    assert all(np.abs(found[0][id_] - found[1][id_]).max() < STILL_PX for id_ in both)
