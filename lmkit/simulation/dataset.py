"""A simulated room as files: images of a recording and of a board, rig, map, and the truth in JSON."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from lmkit.arrays import ByteArray, FloatArray
from lmkit.geometry.camera import CameraModel
from lmkit.geometry.pose import Pose
from lmkit.geometry.stereo_rig import StereoRig
from lmkit.io.landmark_map import map_to_yaml
from lmkit.io.rig import rig_to_yaml
from lmkit.model.board import BoardSpec
from lmkit.model.families import MarkerFamily
from lmkit.parallel import map_in_threads
from lmkit.simulation.photograph import ImagingChain, photograph
from lmkit.simulation.scene import Scene, board_panel, board_poses, drive, make_rig, make_room, studio

BOARD = BoardSpec("chessboard", 9, 6, 25.0)


@dataclass(frozen=True, eq=False)
class Dataset:
    """A simulated room with poses, before any image is taken.

    Attributes:
        poses: T_map_camera of the left camera, one per stereo pair.
        boards: T_camera_board, one per calibration pair.
        board: the calibration board.
    """

    seed: int
    scene: Scene
    rig: StereoRig
    poses: tuple[Pose, ...]
    boards: tuple[Pose, ...]
    chain: ImagingChain
    board: BoardSpec


def make_dataset(
    seed: int, pairs: int, boards: int, landmarks: int, family: MarkerFamily, board: BoardSpec = BOARD
) -> Dataset:
    """A room with a recording and pairs of images of a board; everything is drawn from the seed.

    Raises:
        InputError: both cameras never see the whole board.
    """
    rig = make_rig()
    scene = make_room(seed, family, landmarks)
    placed = board_poses(seed, rig, board, boards) if boards else []
    return Dataset(seed, scene, rig, tuple(drive(seed, scene, pairs)), tuple(placed), ImagingChain(), board)


def render_images(data: Dataset) -> Iterator[tuple[str, ByteArray]]:
    """(relative file name, BGR image) of all pairs, on as many threads as there are cores."""
    jobs = [("drive", k, side) for k in range(len(data.poses)) for side in ("left", "right")]
    jobs += [("boards", k, side) for k in range(len(data.boards)) for side in ("left", "right")]
    yield from map_in_threads(partial(_take, data), jobs)


def _take(data: Dataset, job: tuple[str, int, str]) -> tuple[str, ByteArray]:
    what, index, side = job
    camera, T_camera_left = _camera_of(data.rig, side)
    rng = np.random.default_rng([data.seed, index, int(side == "right"), int(what == "boards")])
    if what == "drive":
        scene, T_map_left = data.scene, data.poses[index]
    else:
        pose = data.boards[index]
        scene = studio([board_panel(data.board, Pose("map", "board", pose.R, pose.t))])
        T_map_left = Pose.identity("map", "camera")
    T_map_camera = T_map_left @ Pose("camera", "camera", T_camera_left.R, T_camera_left.t).inverse()
    return f"{what}/{side}/{index:04d}.png", photograph(scene, camera, T_map_camera, data.chain, rng)


def _camera_of(rig: StereoRig, side: str) -> tuple[CameraModel, Pose]:
    if side == "left":
        return rig.left, Pose.identity("camera", "left")
    return rig.right, rig.T_right_left


def description_files(data: Dataset) -> dict[str, str]:
    """Relative name -> text of the rig, the map and the truth."""
    return {
        "rig.yaml": rig_to_yaml(data.rig),
        "map.yaml": map_to_yaml(data.scene.landmarks),
        "truth.json": json.dumps(truth(data), indent=1),
    }


def truth(data: Dataset) -> dict[str, Any]:
    """Every pose, and for every image all landmarks with all four corners inside it."""
    pairs = []
    for index, pose in enumerate(data.poses):
        images = {side: _visible(data, pose, side) for side in ("left", "right")}
        pairs.append(
            {
                "pair": f"{index:04d}",
                "position": pose.t.tolist(),
                "quaternion": pose.quaternion_xyzw.tolist(),
                "landmarks": images,
            }
        )
    boards = [{"pair": f"{k:04d}", "rvec": b.rvec.tolist(), "t": b.t.tolist()} for k, b in enumerate(data.boards)]
    return {
        "format": "lmkit-truth/1",
        "seed": data.seed,
        "pose": "T_map_camera of the left camera",
        "board": str(data.board),
        "pairs": pairs,
        "boards": boards,
    }


def _visible(data: Dataset, T_map_left: Pose, side: str) -> list[dict[str, Any]]:
    camera, T_camera_left = _camera_of(data.rig, side)
    seen = []
    for landmark in data.scene.landmarks:
        in_left = T_map_left.inverse().apply(landmark.corners_map)
        corners = in_left @ T_camera_left.R.T + T_camera_left.t
        center = corners.mean(axis=0)
        normal = T_camera_left.R @ T_map_left.R.T @ landmark.T_map_landmark.R[:, 2]
        if corners[:, 2].min() < 0.1 or normal @ center > 0 or not _in_front(camera, corners):
            continue
        pixels = camera.project(corners)
        if not camera.contains(pixels).all():
            continue
        sides = np.linalg.norm(np.roll(pixels, -1, axis=0) - pixels, axis=1)
        tilt = np.rad2deg(np.arccos(-normal @ center / np.linalg.norm(center)))
        seen.append(
            {
                "id": str(landmark.id),
                "family": landmark.family,
                "code": landmark.code,
                "corners": pixels.tolist(),
                "side_px": float(sides.mean()),
                "tilt_deg": float(tilt),
            }
        )
    return seen


def _in_front(camera: CameraModel, points: FloatArray) -> bool:
    """Whether points are inside a wide cone: far outside, the distortion polynomial folds back into the image."""
    rays = points[:, :2] / points[:, 2:]
    limit = np.array(camera.image_size) / camera.K[[0, 1], [0, 1]]
    return bool((np.abs(rays) < 0.75 * limit).all())
