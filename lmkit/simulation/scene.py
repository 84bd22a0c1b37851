"""Simulated rooms: four walls, floor, ceiling, and printed sheets on the walls; a rig that moves through the room.

Everything is drawn from a seed.  The map's z points up; walls stand on its x and y axes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from lmkit.arrays import Float32Array, FloatArray
from lmkit.errors import InputError
from lmkit.generation.artwork import FilledPath
from lmkit.generation.board import compose_board_page
from lmkit.generation.page import Page, bare_landmark_page
from lmkit.generation.png import page_to_image
from lmkit.geometry.camera import CameraModel
from lmkit.geometry.pose import Pose
from lmkit.geometry.stereo_rig import StereoRig
from lmkit.model.board import BoardSpec
from lmkit.model.families import MarkerFamily, family_named
from lmkit.model.floor_plan import FloorPlan
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import LandmarkMap, MappedLandmark, wall_pose
from lmkit.model.palette import SRGB_TO_LINEAR

SHEET_DPI = 110.0
BOARD_M, TRIES = (0.45, 0.95), 2000  # distances of boards; tried poses for each kept pose
PAPER_M = 0.002
WALL_TINTS = ((0.62, 0.60, 0.55), (0.55, 0.60, 0.62), (0.66, 0.62, 0.52), (0.58, 0.56, 0.58))
FLOOR, CEILING = (0.22, 0.19, 0.16), (0.75, 0.75, 0.73)


@dataclass(frozen=True, eq=False)
class Panel:
    """A flat textured rectangle in the map.

    Attributes:
        T_map_panel: its pose; x right, y up on its face, z toward the viewer.
        size_m: (width, height).
        texture: (h,w,3) linear RGB, 0..1, upright as seen.
        curl_m: distance of the center in front of the left and right edge, for curled paper.
    """

    T_map_panel: Pose
    size_m: tuple[float, float]
    texture: Float32Array
    curl_m: float = 0.0


@dataclass(frozen=True, eq=False)
class Scene:
    """Scene for simulated images: panels in a room.

    Attributes:
        panels: walls and sheets.
        landmarks: the map.
        size_m: (x, y, z) extent of the room.
    """

    panels: tuple[Panel, ...]
    landmarks: LandmarkMap
    size_m: tuple[float, float, float]


def make_rig(
    image_size: tuple[int, int] = (640, 480), focal_px: float = 460.0, baseline_m: float = 0.12
) -> StereoRig:
    """A stereo camera with typical imperfections: lens distortion, cameras not exactly parallel."""
    width, height = image_size
    left = CameraModel(
        image_size,
        np.array([[focal_px, 0, width / 2 + 4.3], [0, focal_px * 0.998, height / 2 - 3.1], [0, 0, 1.0]]),
        np.array([-0.21, 0.055, 0.0007, -0.0004, 0.0]),
    )
    right = CameraModel(
        image_size,
        np.array([[focal_px * 1.004, 0, width / 2 - 5.2], [0, focal_px * 1.001, height / 2 + 2.4], [0, 0, 1.0]]),
        np.array([-0.205, 0.05, -0.0005, 0.0006, 0.0]),
    )
    T_right_left = Pose.from_rvec(
        "right", "left", np.array([0.004, -0.006, 0.003]), np.array([-baseline_m, 0.0009, -0.0004])
    )
    return StereoRig(left, right, T_right_left)


def make_room(
    seed: int,
    family: MarkerFamily,
    count: int = 10,
    size_m: tuple[float, float, float] = (6.0, 4.5, 2.6),
    codes: Sequence[int] | None = None,
) -> Scene:
    """A room with ``count`` landmarks of a family on its walls at camera height, their codes drawn from the seed."""
    rng = np.random.default_rng(seed)
    if codes is None:
        codes = [int(c) for c in rng.choice(family.code_count, size=count, replace=False)]
    return furnish_room(rng, LandmarkMap(mount_landmarks(rng, family, codes, size_m)), size_m)


def furnish_room(rng: np.random.Generator, landmarks: LandmarkMap, size_m: tuple[float, float, float]) -> Scene:
    """A rectangular room with plastered walls and the landmarks of a map on them."""
    return Scene((*_walls(rng, size_m), *map(landmark_sheet, landmarks)), landmarks, size_m)


def floor_scene(seed: int, floor: FloorPlan, landmarks: LandmarkMap, height_m: float = 2.6) -> Scene:
    """The walls of a floor plan, with the landmarks of a map."""
    rng = np.random.default_rng(seed)
    panels = []
    for wall in floor.walls:
        middle = [*(wall.left + wall.right) / 2, height_m / 2]
        tint = WALL_TINTS[int(rng.integers(len(WALL_TINTS)))]
        # Paper is slightly in front of its wall: landmarks keep their mapped poses, walls are moved back and extended
        # to leave no gaps.
        behind = _moved(wall_pose(middle, wall.facing_rad), -PAPER_M)
        panels.append(Panel(behind, (wall.length_m + 2 * PAPER_M, height_m), _plaster(rng, tint)))
    sx, sy = floor.size_m
    center = np.array([floor.origin[0] + sx / 2, floor.origin[1] + sy / 2, 0.0])
    panels.append(Panel(Pose("map", "floor", np.eye(3), center), (sx, sy), _plaster(rng, FLOOR)))
    above = center + np.array([0.0, 0.0, height_m])
    panels.append(Panel(Pose("map", "ceiling", np.diag([1.0, -1, -1]), above), (sx, sy), _plaster(rng, CEILING)))
    return Scene((*panels, *map(landmark_sheet, landmarks)), landmarks, (sx, sy, height_m))


def _moved(T: Pose, out_m: float) -> Pose:
    """A panel's pose moved along its normal, toward the viewer."""
    return Pose("map", T.from_frame, T.R, T.t + out_m * T.R[:, 2])


def mount_landmarks(
    rng: np.random.Generator, family: MarkerFamily, codes: Sequence[int], size_m: tuple[float, float, float]
) -> list[MappedLandmark]:
    """Landmarks on the four walls of a room at camera height, spread without overlap."""
    mounted = []
    for code, (wall, along, height) in zip(codes, _wall_places(rng, len(codes), size_m), strict=True):
        position, facing = _on_wall(wall, along, height, size_m[0], size_m[1])
        # Paper is slightly in front of its wall.
        position = [position[0] + PAPER_M * np.cos(facing), position[1] + PAPER_M * np.sin(facing), height]
        mounted.append(
            MappedLandmark(LandmarkId(family.name, code), family.side_mm / 1000, wall_pose(position, facing))
        )
    return mounted


def landmark_sheet(landmark: MappedLandmark) -> Panel:
    """The landmark on white paper, exactly centered: with the shape of A4, or larger if its margin requires it."""
    family = family_named(landmark.family)
    texture, face = _sheet_texture(family, landmark.code)
    height, width = (length / face * landmark.size_m for length in texture.shape[:2])
    return Panel(landmark.T_map_landmark, (width, height), texture)


def board_panel(board: BoardSpec, T_map_board: Pose) -> Panel:
    """A calibration board; ``T_map_board`` has its origin at the first inner corner, y down the rows.

    The panel is the whole printed page.
    """
    page = compose_board_page(board)
    width, height = page.size_mm
    texture, first_corner = _board_texture(board)
    # From the first inner corner to the middle of the page, x right and y down in the board's frame.
    middle = np.array([width / 2 - first_corner[0], height / 2 - first_corner[1], 0.0]) / 1000
    flip = np.diag([1.0, -1.0, -1.0])
    T = T_map_board @ Pose(T_map_board.from_frame, "panel", flip, middle)
    return Panel(T, (width / 1000, height / 1000), texture)


def drive(seed: int, scene: Scene, steps: int, height_m: float = 1.15) -> list[Pose]:
    """T_map_camera of the left camera along an ellipse through the room, looking ahead and to the side."""
    rng = np.random.default_rng(seed + 1)
    sx, sy, _ = scene.size_m
    phase = rng.uniform(0, 2 * np.pi)
    poses = []
    for k in range(steps):
        a = phase + 2 * np.pi * k / steps
        position = np.array([sx / 2 + 0.22 * sx * np.cos(a), sy / 2 + 0.2 * sy * np.sin(a), height_m])
        heading = a + np.pi / 2 - 0.6 + rng.uniform(-0.2, 0.2)
        poses.append(looking(position, heading, pitch=rng.uniform(-0.04, 0.04)))
    return poses


def looking(position: FloatArray, heading_rad: float, pitch: float = 0.0) -> Pose:
    """T_map_camera of a level camera that looks along a heading (from x toward y), ``pitch`` up."""
    forward = np.array([np.cos(heading_rad) * np.cos(pitch), np.sin(heading_rad) * np.cos(pitch), np.sin(pitch)])
    right = np.array([np.sin(heading_rad), -np.cos(heading_rad), 0.0])
    down = np.cross(forward, right)
    return Pose("map", "camera", np.column_stack([right, down, forward]), position)


def board_poses(seed: int, rig: StereoRig, board: BoardSpec, count: int) -> list[Pose]:
    """T_camera_board in the left camera, spread over the image, tilted, with the whole board in both cameras.

    Raises:
        InputError: the board is too large.
    """
    rng = np.random.default_rng(seed)
    middle = board.object_points.mean(axis=0)
    poses: list[Pose] = []
    for _ in range(TRIES * count):
        turn = np.array([*rng.uniform(-0.6, 0.6, 2), rng.uniform(-0.3, 0.3)])
        depth = rng.uniform(*BOARD_M)
        offset = np.array([rng.uniform(-0.5, 0.5) * depth, rng.uniform(-0.4, 0.4) * depth, depth])
        rotation = Pose.from_rvec("camera", "board", turn, np.zeros(3)).R
        pose = Pose("camera", "board", rotation, offset - rotation @ middle)
        inside = pose.apply(board.object_points)
        right = inside @ rig.T_right_left.R.T + rig.T_right_left.t
        both = [
            rig.left.contains(rig.left.project(inside), 12),
            rig.right.contains(rig.right.project(right), 12),
        ]
        if all(seen.all() for seen in both):
            poses.append(pose)
        if len(poses) == count:
            return poses
    message = (
        f"board {board} is too large: both cameras hardly ever see all of it from {BOARD_M[0]} to {BOARD_M[1]} m"
    )
    raise InputError("large_board", message, "take smaller squares or tags, or fewer of them")


def studio(panels: Sequence[Panel]) -> Scene:
    """Panels in front of a plain background, in the left camera's frame (named ``map``); for boards."""
    texture = np.full((4, 4, 3), 0.18, dtype=np.float32)
    backdrop = Panel(Pose("map", "wall", np.diag([1.0, -1.0, -1.0]), np.array([0, 0, 4.0])), (20.0, 20.0), texture)
    return Scene((backdrop, *panels), LandmarkMap([]), (20.0, 20.0, 4.0))


def _wall_places(
    rng: np.random.Generator, count: int, size_m: tuple[float, float, float]
) -> list[tuple[int, float, float]]:
    """(wall, place along it, height), spread over the four walls without overlap."""
    lengths = [size_m[0], size_m[1], size_m[0], size_m[1]]
    places = []
    for wall in range(4):
        here = count // 4 + (1 if wall < count % 4 else 0)
        for k in range(here):
            slot = lengths[wall] / (here + 0.4)
            along = (k + 0.7) * slot + rng.uniform(-0.15, 0.15) * slot
            places.append((wall, float(along), float(rng.uniform(1.0, 1.6))))
    return places


def _on_wall(wall: int, along: float, height: float, sx: float, sy: float) -> tuple[list[float], float]:
    """Position and normal of a place on wall 0 (y = 0) to 3 (x = 0)."""
    return (
        ([along, 0.0, height], np.pi / 2),
        ([sx, along, height], np.pi),
        ([sx - along, sy, height], -np.pi / 2),
        ([0.0, sy - along, height], 0.0),
    )[wall]


def _walls(rng: np.random.Generator, size_m: tuple[float, float, float]) -> list[Panel]:
    sx, sy, sz = size_m
    panels = []
    for wall in range(4):
        length = (sx, sy)[wall % 2]
        position, facing = _on_wall(wall, length / 2, sz / 2, sx, sy)
        texture = _plaster(rng, WALL_TINTS[int(rng.integers(len(WALL_TINTS)))])
        panels.append(Panel(wall_pose(position, facing), (length, sz), texture))
    level = np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, 1]])
    panels.append(Panel(Pose("map", "floor", level, np.array([sx / 2, sy / 2, 0])), (sx, sy), _plaster(rng, FLOOR)))
    upside = np.diag([1.0, -1.0, -1.0])
    panels.append(
        Panel(Pose("map", "ceiling", upside, np.array([sx / 2, sy / 2, sz])), (sx, sy), _plaster(rng, CEILING))
    )
    return panels


def _plaster(rng: np.random.Generator, tint: tuple[float, float, float]) -> Float32Array:
    """Uneven paint under uneven light."""
    import cv2

    fine = rng.normal(0, 0.03, (96, 96, 1))
    coarse = cv2.resize(rng.normal(0, 0.12, (4, 4)), (96, 96), interpolation=cv2.INTER_CUBIC)[:, :, None]
    return np.clip(np.array(tint) * (1 + fine + coarse), 0.02, 0.95).astype(np.float32)


@lru_cache(maxsize=64)  # 14 MB each
def _sheet_texture(family: MarkerFamily, code: int) -> tuple[Float32Array, int]:
    """The face on a white sheet, centered, as printed, and the side of the face in texels."""
    face = _linear(bare_landmark_page(family, code, family.side_mm), SHEET_DPI)
    side = len(face)
    # Equal numbers of texels on both sides; else the face is half a texel (0.1 mm) off the landmark's position.
    least_mm = family.side_mm + 2 * family.margin_mm
    beside, above = (round((max(length, least_mm) / family.side_mm - 1) * side / 2) for length in (210, 297))
    sheet = np.full((side + 2 * above, side + 2 * beside, 3), 0.9, dtype=np.float32)
    np.multiply(face, np.float32(0.9), out=sheet[above : above + side, beside : beside + side])
    return sheet, side


@lru_cache(maxsize=8)
def _board_texture(board: BoardSpec) -> tuple[Float32Array, tuple[float, float]]:
    """Texture of the page, and position of the board's first object point on it (mm from the top left)."""
    page = compose_board_page(board)
    texture = _linear(page, SHEET_DPI) * np.float32(0.9)
    marks = [item for item in page.items if isinstance(item, FilledPath)]
    points = [point for mark in marks for command in mark.commands for point in command[1:]]
    left, top = (min(point[axis] for point in points) for axis in (0, 1))
    inward = 0.0 if board.kind == "landmarks" else board.gap_mm if board.kind == "aprilgrid" else board.square_mm
    return texture, (left + inward, top + inward)


def _linear(page: Page, dpi: float) -> Float32Array:
    return np.asarray(SRGB_TO_LINEAR[np.asarray(page_to_image(page, dpi))])
