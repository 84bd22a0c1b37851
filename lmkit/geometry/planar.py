"""Poses and motions in the plane: x, y, heading."""

from __future__ import annotations

import math

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.geometry.pose import Pose


def planar_pose(state: FloatArray) -> Pose:
    """T_map_base of a robot on a level floor, of its x, y (m) and heading (rad, from x toward y)."""
    return Pose.from_rvec("map", "base", np.array([0.0, 0.0, state[2]]), np.array([state[0], state[1], 0.0]))


def planar_state(T_map_base: Pose) -> FloatArray:
    """(3,) x, y (m) and heading (rad) of a robot's pose."""
    R, t = T_map_base.R, T_map_base.t
    return np.array([t[0], t[1], math.atan2(R[1, 0], R[0, 0])])


def follow(state: FloatArray, motions: FloatArray) -> FloatArray:
    """(K+1,3) x, y, heading: the state, and the states after each of (K,3) motions."""
    path = np.zeros((1 + len(motions), 3))
    path[0] = state
    path[1:, 2] = state[2] + np.cumsum(motions[:, 2])
    c, s = np.cos(path[:-1, 2]), np.sin(path[:-1, 2])
    path[1:, 0] = state[0] + np.cumsum(c * motions[:, 0] - s * motions[:, 1])
    path[1:, 1] = state[1] + np.cumsum(s * motions[:, 0] + c * motions[:, 1])
    return path


def between(states: FloatArray) -> FloatArray:
    """(N-1,3) forward, left, turn from each of (N,3) states to the next."""
    d = np.diff(states, axis=0)
    c, s = np.cos(states[:-1, 2]), np.sin(states[:-1, 2])
    return np.column_stack([c * d[:, 0] + s * d[:, 1], -s * d[:, 0] + c * d[:, 1], d[:, 2]])


def wrap_angle(angle: FloatArray) -> FloatArray:
    """Angles (any shape), rad, as the same directions in -pi to pi."""
    return np.asarray(np.arctan2(np.sin(angle), np.cos(angle)))


def wrap_heading(heading_rad: float) -> float:
    """One heading, rad, as the same direction in -pi to pi."""
    return math.atan2(math.sin(heading_rad), math.cos(heading_rad))
