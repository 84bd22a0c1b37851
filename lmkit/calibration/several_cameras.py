"""`calibrate_rig`: three or more cameras; neighboring cameras see the board at the same time.

Every camera is calibrated alone; the pairs of cameras with most common views form a tree, which gives a first rig;
one joint adjustment of all cameras and frames (`joint_cameras.py`) gives the result.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.calibration.board_equations import POSE, WARP, CameraCorners
from lmkit.calibration.bundle_adjustment import FitOptions, StereoProblem
from lmkit.calibration.initialization import board_poses, find_consensus, start_solution
from lmkit.calibration.intrinsics import intrinsics_vector, sigma_and_correlation
from lmkit.calibration.joint_cameras import RigProblem, RigSolution
from lmkit.calibration.mono import CameraCalibration
from lmkit.errors import InputError
from lmkit.geometry.camera import CameraModel
from lmkit.geometry.pose import Pose
from lmkit.geometry.rig import MountedCamera, Rig
from lmkit.geometry.rotations import orthonormal
from lmkit.model.board import BoardSpec
from lmkit.model.observation import BoardObservation, PairView

LEAST_COMMON = 3  # least common views of two connected cameras
RELATION_ONLY = FitOptions(intrinsics=False, warp=False)
Seen = Mapping[str, BoardObservation]  # of one camera, by frame
Pairs = Mapping[tuple[int, int], Sequence[PairView]]


@dataclass(frozen=True, eq=False)
class RigCalibration:
    """A calibrated rig of several cameras and the evidence for it.

    Attributes:
        rig: the cameras, with the covariances of their poses and intrinsics.
        cameras: the calibration of every camera on its own.
        ties: (camera, camera, views used, views that disagree) of the pairs that start the joint adjustment.
        rms_px: reprojection error of every camera in the joint adjustment.
        solution: of the joint adjustment, with its covariance.
        frames: names, in the order of the solution's board poses.
        corners: of every camera, their frames and pixels.
        residuals: of every camera, (N,2) observed minus projected pixels.
    """

    rig: Rig
    cameras: tuple[CameraCalibration, ...]
    ties: tuple[tuple[str, str, int, tuple[str, ...]], ...]
    rms_px: tuple[float, ...]
    solution: RigSolution
    frames: tuple[str, ...]
    corners: tuple[CameraCorners, ...]
    residuals: tuple[FloatArray, ...]

    def to_dict(self) -> dict[str, Any]:
        """The result as JSON values; docs/formats.md lists the keys."""
        return {
            "cameras": [
                {"name": mounted.name, **camera.to_dict(), "joint_rms_px": rms_px}
                for mounted, camera, rms_px in zip(self.rig.cameras, self.cameras, self.rms_px, strict=True)
            ],
            "ties": [
                {"cameras": [a, b], "views": count, "views_rejected": list(bad)} for a, b, count, bad in self.ties
            ],
        }


def calibrate_rig(
    names: Sequence[str], cameras: Sequence[CameraCalibration], seen: Sequence[Seen], board: BoardSpec
) -> RigCalibration:
    """Calibrate cameras jointly, of which each shares views with another one.

    Args:
        names: of the cameras.
        cameras: every camera calibrated on its own.
        seen: corners of every camera by frame; of a chessboard in the same order in all cameras.

    Raises:
        InputError: a camera shares fewer than three views with the others, or its views agree on no pose.
    """
    pairs = _pairs(seen)
    known = {0: Pose.identity("camera", "left")}
    ties = []
    while len(known) < len(cameras):
        a, b = _widest_tie(pairs, set(known), len(cameras), names)
        parent, child = (a, b) if a in known else (b, a)
        T, used, bad = _relation(cameras, pairs, a, b, board)
        known[child] = (T if parent == a else T.inverse()) @ known[parent]
        ties.append((names[parent], names[child], used, bad))
    start, corners, frames = _start(
        [c.rig.left for c in cameras], [known[k] for k in range(len(cameras))], seen, board
    )
    problem = RigProblem(corners, len(frames))
    solution = problem.solve(start)
    off = tuple(problem.residuals(solution))
    rms_px = tuple(float(np.sqrt((values**2).sum(axis=1).mean())) for values in off)
    rig = Rig(_mounted(names, solution))
    return RigCalibration(rig, tuple(cameras), tuple(ties), rms_px, solution, frames, tuple(corners), off)


def _pairs(seen: Sequence[Seen]) -> Pairs:
    return {
        (a, b): [
            PairView(
                frame,
                seen[a][frame].ids,
                seen[a][frame].image_points,
                seen[b][frame].ids,
                seen[b][frame].image_points,
            )
            for frame in sorted(seen[a].keys() & seen[b].keys())
        ]
        for a, b in combinations(range(len(seen)), 2)
    }


def _start(
    models: Sequence[CameraModel], poses: Sequence[Pose], seen: Sequence[Seen], board: BoardSpec
) -> tuple[RigSolution, list[CameraCorners], tuple[str, ...]]:
    """Initial values of the joint adjustment, from single cameras and pairs; corners, and names of frames."""
    frames: dict[str, tuple[FloatArray, FloatArray]] = {}
    for frame in sorted(set().union(*seen)):
        # The camera that sees most of the board gives its pose.
        k = max(range(len(seen)), key=lambda k: len(seen[k][frame].ids) if frame in seen[k] else 0)
        found = board_poses(models[k], board.object_points[seen[k][frame].ids], seen[k][frame].image_points)
        if found:
            R, t, _ = found[0]
            frames[frame] = poses[k].R.T @ R, poses[k].R.T @ (t - poses[k].t)
    nothing = np.zeros(0, dtype=np.int64), np.zeros((0, 2))
    corners = [
        CameraCorners(
            [(here[f].ids, here[f].image_points) if f in here else nothing for f in frames],
            board.object_points,
            np.ones(len(frames)),
        )
        for here in seen
    ]
    start = RigSolution(
        tuple(models),
        np.array([pose.R for pose in poses]),
        np.array([pose.t for pose in poses]),
        np.zeros(WARP),
        np.array([R for R, _ in frames.values()]),
        np.array([t for _, t in frames.values()]),
    )
    return start, corners, tuple(frames)


def _mounted(names: Sequence[str], s: RigSolution) -> tuple[MountedCamera, ...]:
    assert s.covariance is not None
    at = 0
    first = sum(len(intrinsics_vector(model)) for model in s.models) - POSE
    mounted = []
    for k, (name, model) in enumerate(zip(names, s.models, strict=True)):
        count = len(intrinsics_vector(model))
        order = first + POSE * k + np.array([3, 4, 5, 0, 1, 2])  # shift, then rotation
        T = Pose("camera", "left", orthonormal(s.R[k]) if k else np.eye(3), s.t[k])
        covariance = s.covariance[np.ix_(order, order)] if k else None
        known = sigma_and_correlation(s.covariance[at : at + count, at : at + count])
        mounted.append(MountedCamera(name, model, T, covariance, *known))
        at += count
    return tuple(mounted)


def _widest_tie(pairs: Pairs, known: set[int], count: int, names: Sequence[str]) -> tuple[int, int]:
    """The pair of a known and an unknown camera that share most views."""
    across = {pair: len(views) for pair, views in pairs.items() if (pair[0] in known) != (pair[1] in known)}
    best = max(across, key=lambda pair: across[pair], default=None)
    if best is None or across[best] < LEAST_COMMON:
        lost = ", ".join(names[k] for k in range(count) if k not in known)
        raise InputError(
            "no_common_views",
            f"cameras {lost} share fewer than {LEAST_COMMON} views of the board with the others",
            "show the board to two neighboring cameras at a time, ten times for every pair of neighbors",
        )
    return best


def _relation(
    cameras: Sequence[CameraCalibration], pairs: Pairs, a: int, b: int, board: BoardSpec
) -> tuple[Pose, int, tuple[str, ...]]:
    """The pose from camera a into b, views used, and names of the others."""
    views, models = pairs[a, b], (cameras[a].rig.left, cameras[b].rig.left)
    consensus = find_consensus(board.object_points, views, *models)
    rows = np.flatnonzero(consensus.agrees)
    problem = StereoProblem(board.object_points, [views[int(k)] for k in rows])
    s = problem.solve(start_solution(consensus, rows, *models), RELATION_ONLY)
    bad = tuple(views[int(k)].name for k in np.flatnonzero(~consensus.agrees))
    return Pose("camera", "camera", s.R, s.t), len(rows), bad


def rig_lines(result: RigCalibration) -> list[str]:
    """The result as lines of text."""
    lines = []
    for mounted, camera, rms_px in zip(result.rig.cameras, result.cameras, result.rms_px, strict=True):
        held = "unknown" if camera.held_out_px is None else f"{camera.held_out_px:.3f} px"
        lines.append(
            f"{mounted.name}: {mounted.model.model}, {len(camera.used)} images, held-out error {held}, "
            f"reprojection error of all together {rms_px:.3f} px"
        )
        lines += [f"{mounted.name}: rejected {name}: {reason}" for name, reason in camera.rejected]
        lines += [f"{mounted.name}: warning: {warning.message}" for warning in camera.warnings]
        if mounted.covariance is not None:
            sigma = np.sqrt(np.diag(mounted.covariance))
            away = np.linalg.norm(mounted.T_camera_left.t)
            mm, deg = 1000 * np.linalg.norm(sigma[:3]), np.rad2deg(np.linalg.norm(sigma[3:]))
            lines.append(f"{mounted.name}: {1000 * away:.1f} mm from the first camera (± {mm:.2f} mm, {deg:.3f} deg)")
    for a, b, count, bad in result.ties:
        others = f", rejected {', '.join(bad)}" if bad else ""
        lines.append(f"{a} - {b}: {count} common views{others}")
    return lines
