"""`calibrate_rig`: three or more cameras, of which neighbours see the board together in turn.

Every camera is calibrated on its own; the pairs of cameras that share most views, joined to a tree, give the rig.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.calibration.bundle_adjustment import POSE, WARP, FitOptions, StereoProblem
from lmkit.calibration.initialization import find_consensus, start_solution
from lmkit.calibration.mono import CameraCalibration
from lmkit.errors import InputError
from lmkit.geometry.pose import Pose
from lmkit.geometry.rig import MountedCamera, Rig
from lmkit.geometry.rotations import skew
from lmkit.model.board import BoardSpec
from lmkit.model.observation import PairView

LEAST_COMMON = 3  # views that tie two cameras
RELATION_ONLY = FitOptions(intrinsics=False, warp=False)
Pairs = Mapping[tuple[int, int], Sequence[PairView]]


@dataclass(frozen=True, eq=False)
class RigCalibration:
    """A calibrated rig of several cameras and the evidence for it.

    Attributes:
        rig: the cameras, with the covariances of their poses and intrinsics.
        cameras: the calibration of every camera on its own.
        ties: (camera, camera, views used, views that disagree, rms px) of the pairs that give the rig.
    """

    rig: Rig
    cameras: tuple[CameraCalibration, ...]
    ties: tuple[tuple[str, str, int, tuple[str, ...], float], ...]

    def to_dict(self) -> dict[str, Any]:
        """The result as JSON values; docs/formats.md lists the keys."""
        return {
            "cameras": [
                {"name": mounted.name, **camera.to_dict()}
                for mounted, camera in zip(self.rig.cameras, self.cameras, strict=True)
            ],
            "ties": [
                {"cameras": [a, b], "views": count, "views_rejected": list(bad), "rms_px": rms}
                for a, b, count, bad, rms in self.ties
            ],
        }


def calibrate_rig(
    names: Sequence[str], cameras: Sequence[CameraCalibration], pairs: Pairs, board: BoardSpec
) -> RigCalibration:
    """Join calibrated cameras by the views that they share, two by two.

    Args:
        names: of the cameras.
        pairs: for each (i, j), i < j, the views of the board that both cameras have.

    Raises:
        InputError: a camera shares fewer than three views with the others, or its views agree on no pose.
    """
    known: dict[int, tuple[Pose, FloatArray]] = {0: (Pose.identity("camera", "left"), np.zeros((6, 6)))}
    ties = []
    while len(known) < len(cameras):
        a, b = _widest_tie(pairs, set(known), len(cameras), names)
        parent, child = (a, b) if a in known else (b, a)
        R, t, covariance, used, bad, rms = _relation(cameras, pairs, a, b, board)
        if parent == b:  # the relation leads from a to b: turn it round
            turn = np.block([[-R.T, R.T @ skew(t)], [np.zeros((3, 3)), -R.T]])
            R, t, covariance = R.T, -R.T @ t, turn @ covariance @ turn.T
        known[child] = _chained(R, t, covariance, *known[parent])
        ties.append((names[parent], names[child], used, bad, rms))
    mounted = tuple(
        MountedCamera(
            names[k], c.rig.left, known[k][0], known[k][1] if k else None, c.rig.cameras[0].intrinsics_sigma
        )
        for k, c in enumerate(cameras)
    )
    return RigCalibration(Rig(mounted), tuple(cameras), tuple(ties))


def _widest_tie(pairs: Pairs, known: set[int], count: int, names: Sequence[str]) -> tuple[int, int]:
    """The pair of a known and an unknown camera that share most views."""
    across = {pair: len(views) for pair, views in pairs.items() if (pair[0] in known) != (pair[1] in known)}
    best = max(across, key=lambda pair: across[pair], default=None)
    if best is None or across[best] < LEAST_COMMON:
        lost = ", ".join(names[k] for k in range(count) if k not in known)
        raise InputError(
            "no_common_views",
            f"cameras {lost} share fewer than {LEAST_COMMON} views of the board with the others",
            "show the board to two neighbouring cameras at a time, ten times for every pair of neighbours",
        )
    return best


def _relation(
    cameras: Sequence[CameraCalibration], pairs: Pairs, a: int, b: int, board: BoardSpec
) -> tuple[FloatArray, FloatArray, FloatArray, int, tuple[str, ...], float]:
    """R, t from camera a into b with their (6,6) covariance, views used, names of the others, rms in pixels."""
    views, models = pairs[a, b], (cameras[a].rig.left, cameras[b].rig.left)
    consensus = find_consensus(board.object_points, views, *models)
    rows = np.flatnonzero(consensus.agrees)
    problem = StereoProblem(board.object_points, [views[int(k)] for k in rows])
    s = problem.solve(start_solution(consensus, rows, *models), RELATION_ONLY)
    # The intrinsics are those of all images of a camera; what they leave open, only a fit of everything tells.
    covariance = problem.solve(s, FitOptions()).covariance
    assert covariance is not None
    end = len(covariance) - WARP
    order = end - POSE + np.array([3, 4, 5, 0, 1, 2])  # shift, then rotation
    bad = tuple(views[int(k)].name for k in np.flatnonzero(~consensus.agrees))
    off = np.concatenate([part for pair in problem.residuals(s) for part in pair])
    return s.R, s.t, covariance[np.ix_(order, order)], len(rows), bad, float(np.sqrt((off**2).sum(axis=1).mean()))


def _chained(
    R: FloatArray, t: FloatArray, covariance: FloatArray, T_parent_left: Pose, parent_covariance: FloatArray
) -> tuple[Pose, FloatArray]:
    """T_child_left with its covariance (shift, then rotation applied on the left)."""
    T = Pose("camera", "camera", R, t) @ T_parent_left
    own, before = np.eye(6), np.kron(np.eye(2), R)
    own[:3, 3:] = -skew(R @ T_parent_left.t)
    return T, own @ covariance @ own.T + before @ parent_covariance @ before.T


def rig_lines(result: RigCalibration) -> list[str]:
    """The result as lines of text."""
    lines = []
    for mounted, camera in zip(result.rig.cameras, result.cameras, strict=True):
        held = "unknown" if camera.held_out_px is None else f"{camera.held_out_px:.3f} px"
        lines.append(f"{mounted.name}: {mounted.model.model}, {len(camera.used)} images, held-out error {held}")
        lines += [f"{mounted.name}: rejected {name}: {reason}" for name, reason in camera.rejected]
        lines += [f"{mounted.name}: warning: {warning.message}" for warning in camera.warnings]
        if mounted.covariance is not None:
            sigma = np.sqrt(np.diag(mounted.covariance))
            away = np.linalg.norm(mounted.T_camera_left.t)
            mm, deg = 1000 * np.linalg.norm(sigma[:3]), np.rad2deg(np.linalg.norm(sigma[3:]))
            lines.append(f"{mounted.name}: {1000 * away:.1f} mm from the first camera (± {mm:.2f} mm, {deg:.3f} deg)")
    for a, b, count, bad, rms in result.ties:
        others = f", rejected {', '.join(bad)}" if bad else ""
        lines.append(f"{a} - {b}: {count} common views, {rms:.3f} px{others}")
    return lines
