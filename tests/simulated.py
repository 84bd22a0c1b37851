"""One landmark on a gray wall, drawn by pypdfium2, taken with `simulate.photograph`."""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np

from lmkit.generation.page import bare_landmark_page
from lmkit.generation.png import page_to_image
from lmkit.geometry.camera import CameraModel
from lmkit.geometry.pose import Pose
from lmkit.model.landmark import LM8, LandmarkFamily
from lmkit.model.landmark_map import LandmarkMap
from lmkit.model.palette import SRGB_TO_LINEAR
from lmkit.simulation.inks import LASER, as_printed
from lmkit.simulation.photograph import ImagingChain, expose
from lmkit.simulation.render import render
from lmkit.simulation.scene import Panel, Scene

SIZE = (240, 180)
FACE_DPI = 480 * 25.4 / 180
CAMERA = CameraModel(SIZE, np.array([[300.0, 0, 119.5], [0, 300.0, 89.5], [0, 0, 1]]), np.zeros(5))


@lru_cache(maxsize=32)
def sheet(code: int, family: LandmarkFamily) -> np.ndarray:
    """Linear light of a face of 480 x 480 pixels (180 mm) with 40 pixels (15 mm) of paper around it."""
    face = np.asarray(page_to_image(bare_landmark_page(family, code, 180.0), FACE_DPI))
    paper = cv2.copyMakeBorder(face, 40, 40, 40, 40, cv2.BORDER_CONSTANT, value=(255, 255, 255))
    return as_printed(SRGB_TO_LINEAR[paper], LASER)


def shoot(
    code, side_px, turn_deg=0.0, tilt_deg=0.0, chain=None, seed=0, camera=CAMERA, family=LM8, at_m=(0.01, -0.02)
):
    """An image of one landmark on a gray wall, beside the camera's axis, and its true corners."""
    distance = camera.K[0, 0] * 0.18 / side_px
    roll = cv2.Rodrigues(np.array([0.0, 0.0, np.deg2rad(turn_deg)]))[0]
    tilt = cv2.Rodrigues(np.array([0.0, np.deg2rad(tilt_deg), 0.0]))[0]
    T = Pose("map", "sheet", tilt @ roll @ np.diag([1.0, -1.0, -1.0]), np.array([*at_m, distance]))
    panel = Panel(T, (0.21, 0.21), sheet(code, family))
    wall = np.full((camera.image_size[1], camera.image_size[0], 3), 0.35, dtype=np.float32)
    scene = Scene((panel,), LandmarkMap([]), (1, 1, 1))
    radiance = render(scene, camera, Pose.identity("map", "camera"), wall)
    image = expose(radiance, chain or ImagingChain(), np.random.default_rng(seed))
    return image, camera.project(T.apply(family.object_points(0.18)))
