"""Jumps of a rig between neighbors in time: motions that its odometry or its own speed contradicts."""

from __future__ import annotations

import numpy as np

from lmkit.arrays import FloatArray, IntArray
from lmkit.mapping.motion_rows import SLIP_SIGMA, StandardMotions

LEAST_JUMP_M = 0.1
# Without odometry: largest plausible motion between frames.
LEAST_MPS, FASTER, JUMP_SIGMA = 1.0, 4.0, 4.0


def jumps_by_speed(times: FloatArray, p: FloatArray, covariances: FloatArray) -> tuple[IntArray, FloatArray]:
    """Motions faster than the rig can move: their numbers, and (N-1,) excess in meters.

    Args:
        times, p, covariances: (N,) s, (N,3) m, (N,6,6) of the poses.
    """
    seconds = np.diff(times)
    moved = np.linalg.norm(np.diff(p, axis=0), axis=1)
    fastest = max(LEAST_MPS, FASTER * float(np.median(moved / seconds)))
    off = moved - fastest * seconds
    # A poorly determined pose jumps for that reason alone.
    variance = np.einsum("nii->n", covariances[:, :3, :3])
    sure = off > JUMP_SIGMA * np.sqrt(np.abs(variance[1:] + variance[:-1]))
    return np.flatnonzero((off > LEAST_JUMP_M) & sure), off


def jumps_by_odometry(motions: StandardMotions) -> tuple[IntArray, FloatArray]:
    """Motions that the odometry contradicts: their numbers, and (N-1,) difference in meters."""
    r = motions.residuals
    off = np.linalg.norm((r * motions.sigmas)[:, :3], axis=1)
    return np.flatnonzero((np.sqrt((r**2).mean(axis=1)) > SLIP_SIGMA) & (off > LEAST_JUMP_M)), off
