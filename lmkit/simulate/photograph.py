"""Pictures of a scene through a camera: rays with lens distortion, then light, blur, sensor, tone.

Pixels are oversampled; each ray meets every panel in closed form (a plane seen by a camera is a
homography), the nearest panel wins.  Light falls off towards the picture's corners as in a lens.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from lmkit.arrays import ByteArray, Float32Array, FloatArray
from lmkit.model.camera import CameraModel
from lmkit.model.palette import linear_to_srgb
from lmkit.model.pose import Pose
from lmkit.simulate.scene import Panel, Scene

OVERSAMPLE = 3


@dataclass(frozen=True)
class Exposure:
    """How a picture is taken.

    Attributes:
        blur_px: standard deviation of the lens's point spread.
        motion_px: (x, y) way of the picture during the exposure.
        light: (r, g, b) factor of the light; white of 1.0 reaches full scale.
        full_well: electrons at full scale; fewer make more noise.
        read_noise: electrons.
    """

    blur_px: float = 0.6
    motion_px: tuple[float, float] = (0.0, 0.0)
    light: tuple[float, float, float] = (0.9, 0.88, 0.85)
    full_well: float = 6000.0
    read_noise: float = 8.0


def photograph(
    scene: Scene, camera: CameraModel, T_map_camera: Pose, exposure: Exposure, rng: np.random.Generator
) -> ByteArray:
    """One picture: (H,W,3) BGR, 8 bit."""
    light = expose(render(scene, camera, T_map_camera), exposure)
    electrons = rng.poisson(np.clip(light, 0, None) * exposure.full_well).astype(np.float64)
    electrons += rng.normal(0, exposure.read_noise, light.shape)
    tone = linear_to_srgb(np.clip(electrons / exposure.full_well, 0, 1))
    return np.ascontiguousarray(np.round(tone * 255).astype(np.uint8)[:, :, ::-1])


def render(scene: Scene, camera: CameraModel, T_map_camera: Pose) -> Float32Array:
    """(H*S,W*S,3) linear RGB, S = OVERSAMPLE, before lens blur and sensor."""
    rays = _rays(camera.image_size, camera.K.tobytes(), camera.distortion.tobytes(), camera.model)
    height, width = rays.shape[:2]
    picture = np.zeros((height, width, 3), dtype=np.float32)
    depth = np.full((height, width), np.inf, dtype=np.float32)
    for panel in scene.panels:
        _paint(picture, depth, rays, panel, T_map_camera)
    falloff = 1 / (1 + (rays**2).sum(axis=2)) ** 1.0
    return np.asarray(picture * falloff[:, :, None].astype(np.float32))


def expose(picture: Float32Array, exposure: Exposure) -> FloatArray:
    """Oversampled linear light -> (H,W,3) what the pixels receive, before noise."""
    sigma = exposure.blur_px * OVERSAMPLE
    if sigma > 0.05:
        picture = np.asarray(cv2.GaussianBlur(picture, (0, 0), sigma), dtype=np.float32)
    way = np.array(exposure.motion_px) * OVERSAMPLE
    if np.hypot(*way) > 0.5:
        picture = np.asarray(cv2.filter2D(picture, -1, _motion_kernel(way)), dtype=np.float32)
    height, width = picture.shape[0] // OVERSAMPLE, picture.shape[1] // OVERSAMPLE
    pixels = picture.reshape(height, OVERSAMPLE, width, OVERSAMPLE, 3).mean(axis=(1, 3))
    return np.asarray(pixels.astype(np.float64) * np.array(exposure.light))


@lru_cache(maxsize=4)
def _rays(image_size: tuple[int, int], K: bytes, distortion: bytes, model: str) -> Float32Array:
    """(H*S,W*S,2) normalised coordinates of every sub-pixel's ray."""
    camera = CameraModel(image_size, np.frombuffer(K).reshape(3, 3), np.frombuffer(distortion), model)
    width, height = image_size
    steps = (np.arange(OVERSAMPLE) + 0.5) / OVERSAMPLE - 0.5
    x = (np.arange(width)[:, None] + steps).ravel()
    y = (np.arange(height)[:, None] + steps).ravel()
    pixels = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    rays = camera.unproject(pixels).reshape(len(y), len(x), 2)
    return rays.astype(np.float32)


def _paint(picture: Float32Array, depth: Float32Array, rays: Float32Array, panel: Panel, T_map_camera: Pose) -> None:
    """Paint one panel over what is further away, in place."""
    T = T_map_camera.inverse() @ panel.T_map_panel
    if T.R[:, 2] @ T.t >= 0:  # seen from behind
        return
    # A ray r = (x, y, 1) meets the plane where r * d = R [u v 0]' + t.
    A = np.column_stack([T.R[:, 0], T.R[:, 1], T.t])
    inverse = np.linalg.inv(A).astype(np.float32)
    window = _window(T, panel.size_m, rays)
    if window is None:
        return
    rows, columns = window
    x, y = rays[rows, columns, 0], rays[rows, columns, 1]
    h = [inverse[k, 0] * x + inverse[k, 1] * y + inverse[k, 2] for k in range(3)]
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = 1 / h[2]
        u, v = h[0] * distance, h[1] * distance
    width, height = panel.size_m
    nearest = (distance > 0.05) & (distance < depth[rows, columns])
    hit = nearest & (np.abs(u) < width / 2) & (np.abs(v) < height / 2)
    if not hit.any():
        return
    texture = _fitting_detail(panel, float(np.median(distance[hit][::16])), rays)
    th, tw = texture.shape[:2]
    # Texture pixel k covers the span [k, k + 1) of the texture's width.
    map_x = np.clip((u / width + 0.5) * tw - 0.5, -0.5, tw - 0.5).astype(np.float32)
    map_y = np.clip((0.5 - v / height) * th - 0.5, -0.5, th - 0.5).astype(np.float32)
    colour = cv2.remap(texture, map_x, map_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    picture[rows, columns][hit] = colour[hit]
    depth[rows, columns][hit] = distance[hit]


def _fitting_detail(panel: Panel, distance: float, rays: Float32Array) -> Float32Array:
    """The texture shrunk (by area) until its pixels are about as large as a ray's footprint there."""
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
    """Rows and columns that can see a small panel; everything for one that reaches behind the camera."""
    w, h = size_m[0] / 2, size_m[1] / 2
    corners = T_camera_panel.apply(np.array([[-w, h, 0], [w, h, 0], [w, -h, 0], [-w, -h, 0]]))
    everything = (slice(0, rays.shape[0]), slice(0, rays.shape[1]))
    if corners[:, 2].max() <= 0.05:
        return None
    if corners[:, 2].min() <= 0.05:
        return everything
    flat = corners[:, :2] / corners[:, 2:]
    # Every eighth ray is enough to find the window, with the slack of one such step around it.
    coarse = rays[::8, ::8]
    slack = 2 * np.abs(coarse[1, 1] - coarse[0, 0]).max()
    low, high = flat.min(axis=0) - slack, flat.max(axis=0) + slack
    inside = ((coarse > low) & (coarse < high)).all(axis=2)
    rows, columns = np.flatnonzero(inside.any(axis=1)), np.flatnonzero(inside.any(axis=0))
    if len(rows) == 0:
        return None
    return slice(8 * int(rows[0]), 8 * int(rows[-1]) + 8), slice(8 * int(columns[0]), 8 * int(columns[-1]) + 8)


def _motion_kernel(way: FloatArray) -> Float32Array:
    """A line of light of the given way, anti-aliased."""
    reach = int(np.ceil(np.abs(way).max() / 2)) + 1
    kernel = np.zeros((2 * reach + 1, 2 * reach + 1), dtype=np.float32)
    for s in np.linspace(-0.5, 0.5, 8 * reach + 1):
        x, y = reach + s * way[0], reach + s * way[1]
        x0, y0 = int(x), int(y)
        fx, fy = x - x0, y - y0
        for dx, dy, weight in (
            (0, 0, (1 - fx) * (1 - fy)),
            (1, 0, fx * (1 - fy)),
            (0, 1, (1 - fx) * fy),
            (1, 1, fx * fy),
        ):
            if y0 + dy < len(kernel) and x0 + dx < len(kernel):
                kernel[y0 + dy, x0 + dx] += weight
    return np.asarray(kernel / kernel.sum())
