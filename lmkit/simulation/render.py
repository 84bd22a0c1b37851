"""Rendering: the light a camera receives from a scene; rays with lens distortion to the nearest panel.

Pixels are oversampled; each ray meets every panel in closed form, curled ones in a few steps.  Light
falls off toward the image's corners as in a lens.
"""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np

from lmkit.arrays import Float32Array, FloatArray
from lmkit.geometry.camera import CameraModel
from lmkit.geometry.pose import Pose
from lmkit.kernels.ray_panels import NEAREST_M, meet_panel, paint_panel
from lmkit.simulation.scene import Panel, Scene

OVERSAMPLE = 3


def render(
    scene: Scene, camera: CameraModel, T_map_camera: Pose, background: Float32Array | None = None
) -> Float32Array:
    """(H*S,W*S,3) linear RGB, S = OVERSAMPLE, before lens blur and sensor.

    Args:
        background: (H,W,3) linear RGB where there is no panel; None: black.
    """
    rays, falloff = _rays(camera.image_size, camera.K.tobytes(), camera.distortion.tobytes(), camera.model)
    height, width = rays.shape[:2]
    image = np.zeros((height, width, 3), dtype=np.float32)
    if background is not None:
        image = np.asarray(cv2.resize(background, (width, height), interpolation=cv2.INTER_LINEAR), dtype=np.float32)
    depth = np.full((height, width), np.inf, dtype=np.float32)
    for panel in scene.panels:
        _paint(image, depth, rays, panel, T_map_camera)
    image *= falloff[:, :, None]
    return image


@lru_cache(maxsize=4)
def _rays(image_size: tuple[int, int], K: bytes, distortion: bytes, model: str) -> tuple[Float32Array, Float32Array]:
    """(H*S,W*S,2) normalized coordinates of every sub-pixel's ray, and (H*S,W*S) its share of light (vignetting)."""
    camera = CameraModel(image_size, np.frombuffer(K).reshape(3, 3), np.frombuffer(distortion), model)
    width, height = image_size
    steps = (np.arange(OVERSAMPLE) + 0.5) / OVERSAMPLE - 0.5
    x = (np.arange(width)[:, None] + steps).ravel()
    y = (np.arange(height)[:, None] + steps).ravel()
    rays = camera.unproject_grid(x, y).astype(np.float32)
    falloff = 1 / (1 + (rays**2).sum(axis=2)) ** 1.0
    return rays, falloff.astype(np.float32)


def _paint(image: Float32Array, depth: Float32Array, rays: Float32Array, panel: Panel, T_map_camera: Pose) -> None:
    """Paint one panel over more distant panels, in place."""
    T = T_map_camera.inverse() @ panel.T_map_panel
    if T.R[:, 2] @ T.t >= 0:  # seen from behind
        return
    window = _window(T, panel.size_m, rays)
    if window is None:
        return
    width, height = panel.size_m
    origin = -(T.R.T @ T.t)
    u, v, distance, hit = meet_panel(rays, depth, window, T.R, origin, panel.size_m, panel.curl_m)
    if not hit.any():
        return
    texture = _fitting_detail(panel, float(np.median(distance[hit][::16])), rays)
    th, tw = texture.shape[:2]
    # Texture pixel k covers the span [k, k + 1) of the texture's width.
    map_x = np.clip((u / width + 0.5) * tw - 0.5, -0.5, tw - 0.5).astype(np.float32)
    map_y = np.clip((0.5 - v / height) * th - 0.5, -0.5, th - 0.5).astype(np.float32)
    color = cv2.remap(texture, map_x, map_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    paint_panel(image, depth, window, hit, np.asarray(color, dtype=np.float32), distance)


def _fitting_detail(panel: Panel, distance: float, rays: Float32Array) -> Float32Array:
    """The texture reduced (area-averaged) until its pixels are about as large as a ray's footprint."""
    row, column = rays.shape[0] // 2, rays.shape[1] // 2
    ray_step = float(abs(rays[row, column + 1, 0] - rays[row, column, 0]))
    texel = panel.size_m[0] / panel.texture.shape[1]
    shrink = max(1, int(ray_step * distance / texel))
    if shrink == 1:
        return panel.texture
    height, width = panel.texture.shape[:2]
    size = (max(2, round(width / shrink)), max(2, round(height / shrink)))
    return np.asarray(cv2.resize(panel.texture, size, interpolation=cv2.INTER_AREA), dtype=np.float32)


def _window(T_camera_panel: Pose, size_m: tuple[float, float], rays: Float32Array) -> tuple[slice, slice] | None:
    """Rows and columns that can see a panel."""
    w, h = 0.55 * size_m[0], 0.55 * size_m[1]  # a curled panel extends a little beyond its plane's outline
    corners = T_camera_panel.apply(np.array([[-w, h, 0], [w, h, 0], [w, -h, 0], [-w, -h, 0]]))
    corners = _ahead(corners)
    if len(corners) == 0:
        return None
    flat = corners[:, :2] / corners[:, 2:]
    # Every eighth ray is enough to find the window, with a margin of one such step.
    coarse = rays[::8, ::8]
    slack = 2 * np.abs(coarse[1, 1] - coarse[0, 0]).max()
    low, high = flat.min(axis=0) - slack, flat.max(axis=0) + slack
    inside = ((coarse > low) & (coarse < high)).all(axis=2)
    rows, columns = np.flatnonzero(inside.any(axis=1)), np.flatnonzero(inside.any(axis=0))
    if len(rows) == 0:
        return None
    return slice(8 * int(rows[0]), 8 * int(rows[-1]) + 8), slice(8 * int(columns[0]), 8 * int(columns[-1]) + 8)


def _ahead(corners: FloatArray) -> FloatArray:
    """Corners of the part of a convex outline at least `NEAREST_M` in front of the camera."""
    beyond = corners[:, 2] - NEAREST_M
    kept = []
    for a, b, here, there in zip(corners, np.roll(corners, -1, axis=0), beyond, np.roll(beyond, -1), strict=True):
        if here >= 0:
            kept.append(a)
        if here * there < 0:
            kept.append(a + here / (here - there) * (b - a))
    return np.array(kept)
