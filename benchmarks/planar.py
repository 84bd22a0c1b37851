"""Scenes of one 18 cm marker before a real photograph, the same for every kind of marker.

Simulated: the marker is drawn by a PDF rasterizer (lm8) or by OpenCV (AprilTag 36h11, ArUco 4x4),
put on white paper, seen by a camera of f = 600 px and 640x480 pixels and taken by
`lmkit.simulation.photograph`; the background is a real photograph.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
import pypdfium2

from lmkit.generation.page import bare_landmark_page
from lmkit.generation.pdf import pages_to_pdf
from lmkit.geometry.camera import CameraModel
from lmkit.geometry.pose import Pose
from lmkit.model.landmark import LM8
from lmkit.model.landmark_map import LandmarkMap
from lmkit.model.palette import srgb_to_linear
from lmkit.simulation.inks import OFFSET, as_printed
from lmkit.simulation.photograph import ImagingChain, expose
from lmkit.simulation.render import render
from lmkit.simulation.scene import Panel, Scene

SIDE_M = 0.18
# White around the marker: what A4 leaves beside an lm8, one module for the others.
MARGIN_M = {"lm8": 0.015, "tag36h11": 0.0225, "aruco4x4": 0.030}
DICTIONARIES = {"tag36h11": cv2.aruco.DICT_APRILTAG_36h11, "aruco4x4": cv2.aruco.DICT_4X4_250}
FOCAL_PX = 600.0
SIZE = (640, 480)


@dataclass(frozen=True)
class View:
    """Place of the marker and the way its image is taken.

    Attributes:
        side_px: f * side / distance of its middle.
        tilt_deg: between its normal and the line of sight.
        chain: the imaging chain; a function of the marker's middle (px), for shadows across it.
    """

    side_px: float
    tilt_deg: float = 0.0
    chain: ImagingChain = field(default_factory=ImagingChain)


@dataclass(frozen=True)
class Shot:
    """An image and its truth: code, corners (4,2) px, T_camera_marker."""

    image: np.ndarray
    code: int
    corners: np.ndarray
    T_camera_marker: Pose


def camera(size: tuple[int, int] = SIZE) -> CameraModel:
    f = FOCAL_PX * size[0] / SIZE[0]
    return CameraModel(
        size, np.array([[f, 0, size[0] / 2 - 0.5], [0, f, size[1] / 2 - 0.5], [0, 0, 1.0]]), np.zeros(5)
    )


def place(view: View, rng: np.random.Generator) -> Pose:
    """T_camera_marker, all of the paper inside the image where it fits."""
    distance = FOCAL_PX * SIDE_M / view.side_px
    room = 0.5 * np.array(SIZE) - 0.75 * view.side_px - 8
    offset = rng.uniform(-1, 1, 2) * np.maximum(room, 0) * distance / FOCAL_PX
    sight = np.array([*offset, distance])
    z = sight / np.linalg.norm(sight)
    x = np.cross([0.0, 1.0, 0.0], z)
    x /= np.linalg.norm(x)
    facing = np.column_stack([x, -np.cross(z, x), -z])  # x right, y up, z back at the camera
    axis, roll = rng.uniform(0, 2 * np.pi), rng.uniform(-0.3, 0.3)
    tilt = cv2.Rodrigues(np.deg2rad(view.tilt_deg) * np.array([np.cos(axis), np.sin(axis), 0.0]))[0]
    turn = cv2.Rodrigues(np.array([0.0, 0.0, roll]))[0]
    return Pose("camera", "marker", facing @ tilt @ turn, sight)


def shoot(marker: str, view: View, background: np.ndarray, seed: int) -> Shot:
    rng = np.random.default_rng(seed)
    T = place(view, rng)
    code = int(rng.integers(250))
    paper = SIDE_M + 2 * MARGIN_M[marker]
    panel = Panel(Pose("map", "marker", T.R, T.t), (paper, paper), texture_of(marker, code))
    scene = Scene((panel,), LandmarkMap([]), (1.0, 1.0, 1.0))
    cam = camera()
    radiance = render(scene, cam, Pose.identity("map", "camera"), background)
    corners = cam.project(T.apply(LM8.object_points(SIDE_M)))
    return Shot(expose(radiance, view.chain, rng), code, corners, T)


@lru_cache(maxsize=1024)
def texture_of(marker: str, code: int) -> np.ndarray:
    """(h,w,3) linear RGB of the marker on its paper."""
    margin = MARGIN_M[marker] / SIDE_M
    if marker == "lm8":
        pdf = pypdfium2.PdfDocument(pages_to_pdf([bare_landmark_page(LM8, code, 180.0)], "lm8"))
        page = np.asarray(pdf[0].render(scale=120 / 72).to_pil().convert("RGB"))
        # The bare page has a margin of its own.
        own = round((page.shape[0] - 180 * 120 / 25.4) / 2)
        face = page[own : page.shape[0] - own, own : page.shape[1] - own] if own > 0 else page
    else:
        dictionary = cv2.aruco.getPredefinedDictionary(DICTIONARIES[marker])
        face = cv2.cvtColor(cv2.aruco.generateImageMarker(dictionary, code, 840), cv2.COLOR_GRAY2RGB)
    edge = round(margin * face.shape[0])
    sheet = cv2.copyMakeBorder(face, edge, edge, edge, edge, cv2.BORDER_CONSTANT, value=(255, 255, 255))
    return as_printed(srgb_to_linear(sheet / 255).astype(np.float32), OFFSET)


@lru_cache(maxsize=128)
def _background(path: Path) -> np.ndarray:
    image = cv2.imread(str(path))
    if image.shape[0] > image.shape[1]:
        image = cv2.rotate(image, cv2.ROTATE_90_CLOCKWISE)
    image = cv2.resize(image, SIZE, interpolation=cv2.INTER_AREA)
    return srgb_to_linear(image[:, :, ::-1] / 255).astype(np.float32)


def backgrounds(folder: Path) -> list[Path]:
    return sorted(folder.glob("*.jpg"))


def background(path: Path) -> np.ndarray:
    """(480,640,3) linear RGB of a photograph."""
    return _background(path)
