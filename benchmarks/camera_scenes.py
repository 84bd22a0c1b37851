"""Scenes to train and to judge acceptance on: several landmarks and look-alikes before a photograph, by many cameras.

Simulated.  Every image shows up to six sheets before a real photograph: landmarks, some of them partly hidden or on
curled paper, and look-alikes (framed signs of other drawings).  The camera and its disturbances are drawn from kinds
of cameras (`lmkit.simulation.cameras`), so that a fit to some kinds can be judged on others.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import cv2
import numpy as np
from planar import FOCAL_PX, SIDE_M, SIZE, camera

from lmkit.generation.page import bare_landmark_page
from lmkit.generation.png import page_to_image
from lmkit.geometry.pose import Pose
from lmkit.model.families import MarkerFamily, family_named
from lmkit.model.landmark import LandmarkFamily
from lmkit.model.landmark_map import LandmarkMap
from lmkit.model.palette import BLUE, RED, srgb_to_linear
from lmkit.simulation.cameras import CameraKind, draw_chain
from lmkit.simulation.inks import ALL_INKS, as_printed
from lmkit.simulation.photograph import ImagingChain, expose
from lmkit.simulation.render import render
from lmkit.simulation.scene import Panel, Scene

COLUMNS, ROWS = 3, 2
MARGIN_M, A4_MARGIN_M = 0.015, 0.0585  # white beside the face, at least; above and below it on a whole sheet of A4
WHOLE_SHEET_SHARE = 0.7
FACE_PX = 360
BLACK = (20.0, 20.0, 20.0)
LOOK_ALIKES, HIDDEN_SHARE, BOWED_SHARE, EMPTY_SHARE = 0.2, 0.2, 0.1, 0.15
Obstacle = Callable[[Pose, np.random.Generator], Panel]
# Linear RGB of what is taken for a part of a landmark: paper, and the ground in print.
PAPER, GROUND = (0.80, 0.80, 0.78), (0.03, 0.08, 0.30)


@dataclass(frozen=True)
class Shown:
    """A landmark in an image.

    Attributes:
        code: its code.
        corners: (4,2) px.
        tilt_deg: between its normal and the line of sight.
        is_hidden: an obstacle lies over a part of it: its own, or one that reaches over from its neighbor's place.
        T_camera_marker: its pose.
    """

    code: int
    corners: np.ndarray
    tilt_deg: float
    is_hidden: bool
    T_camera_marker: Pose

    @property
    def side_px(self) -> float:
        return float(np.linalg.norm(np.roll(self.corners, -1, axis=0) - self.corners, axis=1).mean())


def light_wall(photograph: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """(H,W,3) linear RGB of a painted wall, half to a quarter more as bright as paper, unevenly lit.

    The photograph remains as a faint texture.  Of the landmarks in the rooms, 67 % are mounted before what is at
    least 0.8 times as bright as their margin, before photographs 6 %.
    """
    paint = rng.uniform(0.4, 1.0) * rng.uniform(0.9, 1.0, 3)
    faint = (photograph.mean(axis=2, keepdims=True) + 0.02) ** 0.1
    y, x = np.mgrid[-0.5 : 0.5 : photograph.shape[0] * 1j, -0.5 : 0.5 : photograph.shape[1] * 1j]
    across, down = rng.uniform(-0.3, 0.3, 2)
    light = (1 + across * x + down * y)[:, :, None]
    return np.asarray(paint * light * faint / faint.mean(), dtype=np.float32)


def bar_or_patch(T: Pose, rng: np.random.Generator) -> Panel:
    """A bar or a patch that hides some of a sheet, a little in front of it."""
    along = rng.uniform(-0.11, 0.11, 2)
    wide = float(rng.uniform(0.01, 0.06))
    size = (wide, 0.5) if rng.random() < 0.5 else (wide, float(rng.uniform(0.03, 0.1)))
    color = np.full((2, 2, 3), rng.uniform(0.02, 0.8, 3), dtype=np.float32)
    turn = cv2.Rodrigues(np.array([0.0, 0.0, rng.uniform(-np.pi, np.pi)]))[0]
    offset = T.R @ np.array([*along, 0.004])
    return Panel(Pose("map", "obstacle", T.R @ turn, T.t + offset), size, color)


def wide_obstacle(T: Pose, rng: np.random.Generator) -> Panel:
    """A pole across a sheet, a bar that reaches in from outside, or a patch; often in colors of the landmark.

    Half of them are as bright as paper or as dark as the ground, which is what a gap or a ring is taken for.
    """
    turn = float(rng.uniform(-np.pi, np.pi))
    way, wide = np.array([np.cos(turn), np.sin(turn)]), float(rng.uniform(0.008, 0.06))
    across, aside = np.array([-way[1], way[0]]), float(rng.uniform(-0.09, 0.09))
    how = rng.random()
    if how < 0.4:
        long, middle = 0.5, aside * across
    elif how < 0.75:
        long = 0.3
        middle = (float(rng.uniform(-0.06, 0.08)) + long / 2) * way + aside * across
    else:
        long, middle = float(rng.uniform(0.03, 0.1)), rng.uniform(-0.1, 0.1, 2)
    color = np.array((PAPER, GROUND)[int(rng.integers(2))]) * rng.uniform(0.6, 1.25)
    if rng.random() < 0.5:
        color = rng.uniform(0.02, 0.8) * rng.uniform(0.4, 1.0, 3)
    turned = cv2.Rodrigues(np.array([0.0, 0.0, turn]))[0]
    offset = T.R @ np.array([*middle, 0.004])
    texture = np.tile(color.astype(np.float32), (2, 2, 1))
    return Panel(Pose("map", "obstacle", T.R @ turned, T.t + offset), (long, wide), texture)


def draw_photograph(
    seed: Sequence[int],
    background: np.ndarray,
    kinds: Sequence[CameraKind],
    sides_px: tuple[float, float] = (9.0, 60.0),
    family: str = "lm8",
    trouble: float = 0.3,
    look_alikes: float = LOOK_ALIKES,
    cells: tuple[int, int] = (COLUMNS, ROWS),
    is_dim: bool = False,
    hidden: float = HIDDEN_SHARE,
    obstacle: Obstacle = bar_or_patch,
    motion_px: tuple[float, float] | None = None,
    bowed: float = BOWED_SHARE,
    change: Callable[[ImagingChain], ImagingChain] = lambda chain: chain,
) -> tuple[np.ndarray, list[Shown], ImagingChain]:
    """One image, (480,640,3) BGR, 8 bit, the landmarks in it and how it was taken.

    Places, light and camera depend on the seed alone, whatever the family.

    Args:
        background: (480,640,3) linear RGB.
        sides_px: least and largest f * side / distance, drawn by the logarithm.
        trouble: see :func:`lmkit.simulation.cameras.draw_chain`.
        look_alikes: share of the sheets that show a look-alike.
        cells: columns and rows of sheets; more of them for smaller landmarks, since the time goes by pixels.
        is_dim: so little light that noise is plain to see, see :func:`dimmed`.
        hidden: share of the landmarks before which an obstacle stands.
        obstacle: which of the two kinds of obstacles.
        motion_px: least and largest way of the image during the exposure, drawn by the logarithm, in any direction;
            without it, motion is one of the troubles, and short.
        bowed: share of the sheets that are curled.
        change: made to the camera that is drawn.
    """
    rng = np.random.default_rng(seed)
    panels, shown, obstacles, marker = [], [], [], family_named(family)
    for cell in range(cells[0] * cells[1]):
        if rng.random() < EMPTY_SHARE:
            continue
        side = float(np.exp(rng.uniform(*np.log(sides_px))))
        T, tilt = _place(cell, cells, side, rng)
        inks = ALL_INKS[str(rng.choice(list(ALL_INKS)))]
        is_landmark = rng.random() >= look_alikes
        if is_landmark:
            code = int(rng.integers(marker.code_count))
            face = _face(family, code)
        else:
            face = look_alike(rng, *_inks_of(marker))
        beside = max(MARGIN_M, marker.margin_mm / marker.side_mm * SIDE_M)
        above = A4_MARGIN_M if rng.random() < WHOLE_SHEET_SHARE else beside
        texture, paper = _on_paper(face, above, beside), (SIDE_M + 2 * beside, SIDE_M + 2 * above)
        bow = float(rng.uniform(-0.01, 0.01)) if rng.random() < bowed else 0.0
        panels.append(Panel(T, paper, as_printed(texture, inks), bow))
        if not is_landmark:
            continue
        if rng.random() < hidden:
            obstacles.append(obstacle(T, rng))
            panels.append(obstacles[-1])
        corners = camera().project(T.apply(marker.object_points(SIDE_M)))
        shown.append(Shown(code, corners, tilt, False, Pose("camera", "marker", T.R, T.t)))
    shown = [replace(one, is_hidden=any(_hides(panel, one) for panel in obstacles)) for one in shown]
    scene = Scene(tuple(panels), LandmarkMap([]), (1.0, 1.0, 1.0))
    radiance = render(scene, camera(), Pose.identity("map", "camera"), background)
    chain = draw_chain(rng, kinds, trouble, SIZE)
    if motion_px is not None:
        long, towards = float(np.exp(rng.uniform(*np.log(motion_px)))), float(rng.uniform(0, 2 * np.pi))
        way = (long * float(np.cos(towards)), long * float(np.sin(towards)))
        chain = replace(chain, lens=replace(chain.lens, motion_px=way))
    if is_dim:
        chain = dimmed(chain, rng)
    chain = change(chain)
    return expose(radiance, chain, rng), shown, chain


def _hides(obstacle: Panel, shown: Shown) -> bool:
    """Does an obstacle lie over a part of a landmark's face, nearer than the face there?"""
    half = np.array(obstacle.size_m) / 2
    edge = obstacle.T_map_panel.apply(np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)]) * [*half, 0.0])
    if (edge[:, 2] <= 0).any():
        return False
    quads = [np.asarray(quad, dtype=np.float32) for quad in (camera().project(edge), shown.corners)]
    area, overlap = cv2.intersectConvexConvex(*quads)
    if area <= 0:
        return False
    rays = camera().unproject(overlap.reshape(-1, 2).astype(np.float64))
    return bool((_distance(obstacle.T_map_panel, rays) < _distance(shown.T_camera_marker, rays)).any())


def _distance(T: Pose, rays: np.ndarray) -> np.ndarray:
    """(N,) along which (N,2) rays, z = 1, meet the plane of a pose."""
    normal = T.R[:, 2]
    return np.asarray(normal @ T.t / (np.column_stack([rays, np.ones(len(rays))]) @ normal))


def dimmed(chain: ImagingChain, rng: np.random.Generator) -> ImagingChain:
    """A camera in a dim room: it raises its gain, so that few electrons make full scale and noise shows."""
    full_well, brightness = np.exp(rng.uniform(*np.log([(80.0, 0.1), (800.0, 0.5)])))
    return replace(
        chain,
        light=replace(chain.light, brightness=float(brightness)),
        sensor=replace(chain.sensor, full_well=float(full_well), read_noise=float(rng.uniform(1, 4))),
    )


def _place(cell: int, cells: tuple[int, int], side_px: float, rng: np.random.Generator) -> tuple[Pose, float]:
    """Pose of a sheet in a cell of the image, and its tilt in degrees."""
    width, height = SIZE[0] / cells[0], SIZE[1] / cells[1]
    middle = np.array([(cell % cells[0] + 0.5) * width, (cell // cells[0] + 0.5) * height])
    room = np.maximum(np.array([width, height]) / 2 - 0.85 * side_px, 0)
    at = middle + rng.uniform(-1, 1, 2) * room
    distance = FOCAL_PX * SIDE_M / side_px
    sight = np.array([*((at - (np.array(SIZE) - 1) / 2) / FOCAL_PX), 1.0]) * distance
    z = sight / np.linalg.norm(sight)
    x = np.cross([0.0, 1.0, 0.0], z)
    x /= np.linalg.norm(x)
    facing = np.column_stack([x, -np.cross(z, x), -z])
    tilt = float(rng.uniform(0, 75)) if rng.random() < 0.7 else float(rng.uniform(0, 20))
    axis = rng.uniform(0, 2 * np.pi)
    roll = rng.uniform(-np.pi, np.pi) if rng.random() < 0.25 else rng.normal(0, 0.12)
    lean = cv2.Rodrigues(np.deg2rad(tilt) * np.array([np.cos(axis), np.sin(axis), 0.0]))[0]
    turn = cv2.Rodrigues(np.array([0.0, 0.0, roll]))[0]
    return Pose("map", "sheet", facing @ lean @ turn, sight), tilt


@lru_cache(maxsize=1024)
def _face(family: str, code: int) -> np.ndarray:
    """(h,h,3) sRGB of a landmark's face."""
    page = bare_landmark_page(family_named(family), code, 180.0)
    return np.asarray(page_to_image(page, FACE_PX / 180 * 25.4), dtype=np.uint8)


def _on_paper(face: np.ndarray, above_m: float, beside_m: float) -> np.ndarray:
    """(h,w,3) linear RGB of a face on white paper."""
    beside, above = (round(margin / SIDE_M * face.shape[0]) for margin in (beside_m, above_m))
    white = (255, 255, 255)
    sheet = cv2.copyMakeBorder(face, above, above, beside, beside, cv2.BORDER_CONSTANT, value=white)
    return srgb_to_linear(sheet / 255).astype(np.float32)


def _inks_of(family: MarkerFamily) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """sRGB of the border and of what lies inside it."""
    return (RED, BLUE) if isinstance(family, LandmarkFamily) else (BLACK, BLACK)


def look_alike(
    rng: np.random.Generator, frame: tuple[float, ...] = RED, ground: tuple[float, ...] = BLUE
) -> np.ndarray:
    """(h,h,3) sRGB of a framed sign that is no landmark: frame, ground, and shapes on it."""
    n = FACE_PX
    red, blue = np.array(frame, dtype=np.float64), np.array(ground, dtype=np.float64)

    def some_color() -> tuple[float, ...]:
        return tuple(rng.uniform(0, 255, 3).tolist())

    def like(ink: np.ndarray) -> np.ndarray:
        return np.clip(ink + rng.normal(0, 20, 3), 0, 255) if rng.random() < 0.8 else np.array(some_color())

    face = np.empty((n, n, 3), dtype=np.uint8)
    face[:] = like(red)
    border = int(n * rng.uniform(0.03, 0.1))
    face[border : n - border, border : n - border] = like(blue)
    for _ in range(int(rng.choice([1, 1, 1, 2]))):
        ink = (255.0, 255.0, 255.0) if rng.random() < 0.8 else some_color()
        _SHAPES[int(rng.integers(len(_SHAPES)))](face, ink, rng)
    return face


def _rings(face: np.ndarray, ink: tuple[float, ...], rng: np.random.Generator) -> None:
    n = len(face)
    for radius in rng.uniform(0.08, 0.42, int(rng.integers(1, 4))):
        cv2.circle(face, (n // 2, n // 2), int(radius * n), ink, int(rng.choice([-1, n // 20, n // 12])))


def _arcs(face: np.ndarray, ink: tuple[float, ...], rng: np.random.Generator) -> None:
    n = len(face)
    for radius in rng.uniform(0.1, 0.4, int(rng.integers(1, 4))):
        start, length = rng.uniform(0, 360), rng.uniform(40, 300)
        size = (int(radius * n), int(radius * n))
        cv2.ellipse(face, (n // 2, n // 2), size, 0, start, start + length, ink, n // 18)


def _blocks(face: np.ndarray, ink: tuple[float, ...], rng: np.random.Generator) -> None:
    n, cells = len(face), int(rng.integers(3, 7))
    step, low = 0.7 * n / cells, 0.15 * n
    for row, column in np.argwhere(rng.integers(0, 2, (cells, cells))):
        x, y = int(low + column * step), int(low + row * step)
        cv2.rectangle(face, (x, y), (int(x + step), int(y + step)), ink, -1)


def _letters(face: np.ndarray, ink: tuple[float, ...], rng: np.random.Generator) -> None:
    n = len(face)
    text = "".join(rng.choice(list("ABEHPRSXO03568i"), int(rng.integers(1, 3))))
    scale = n / (30 * len(text)) * rng.uniform(0.6, 1.1)
    (width, height), _ = cv2.getTextSize(text, 0, scale, 1)
    at = (int((n - width) / 2), int((n + height) / 2))
    cv2.putText(face, text, at, 0, scale, ink, int(rng.integers(n // 30, n // 9)))


def _polygon(face: np.ndarray, ink: tuple[float, ...], rng: np.random.Generator) -> None:
    n = len(face)
    points = n / 2 + n * rng.uniform(-0.38, 0.38, (int(rng.integers(3, 6)), 2))
    cv2.fillPoly(face, [points.astype(np.int32)], ink)


def _bars(face: np.ndarray, ink: tuple[float, ...], rng: np.random.Generator) -> None:
    n = len(face)
    wide, long = int(rng.uniform(0.04, 0.12) * n), int(rng.uniform(0.15, 0.38) * n)
    cv2.rectangle(face, (n // 2 - long, n // 2 - wide), (n // 2 + long, n // 2 + wide), ink, -1)
    if rng.random() < 0.5:
        cv2.rectangle(face, (n // 2 - wide, n // 2 - long), (n // 2 + wide, n // 2 + long), ink, -1)


_SHAPES = (_rings, _arcs, _blocks, _letters, _polygon, _bars)
