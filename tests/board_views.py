"""Corners of a board in a known rig, as both cameras would see them."""

from __future__ import annotations

import numpy as np

from lmkit.geometry.stereo_rig import StereoRig
from lmkit.model.board import BoardSpec
from lmkit.model.observation import PairView
from lmkit.simulation.scene import board_poses, make_rig

BOARD = BoardSpec("chessboard", 9, 6, 25.0)


def views(count: int, noise: float, seed: int = 1, rig: StereoRig | None = None) -> list[PairView]:
    rig = rig or make_rig()
    rng = np.random.default_rng(seed)
    ids = np.arange(len(BOARD.object_points))
    result = []
    for k, pose in enumerate(board_poses(seed, rig, BOARD, count)):
        left = pose.apply(BOARD.object_points)
        right = left @ rig.T_right_left.R.T + rig.T_right_left.t
        pixels = [camera.project(p) for camera, p in ((rig.left, left), (rig.right, right))]
        pixels = [p + rng.normal(0, noise, p.shape) for p in pixels]
        result.append(PairView(f"{k:02d}", ids, pixels[0], ids, pixels[1]))
    return result
