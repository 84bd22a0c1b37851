"""Images of a room at the rate of a camera: sheets through the lens model, walls in plain colors.

`photograph.py` is the model for measurements of detection; this model takes milliseconds instead of a second, for
live runs.  Only windows around sheets are computed at full resolution.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import cv2
import numpy as np

from lmkit.arrays import ByteArray, Float32Array, FloatArray
from lmkit.geometry.camera import CameraModel
from lmkit.geometry.pose import Pose
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.palette import linear_to_srgb
from lmkit.simulation.scene import CEILING, FLOOR, WALL_TINTS, Panel, Scene, landmark_sheet

OVERSAMPLE = 2
COARSE = 4  # pixels of one background sample
BLUR_PX = 0.55
NOISE, NOISES = 2.0, 8  # gray levels; different noise images
LEVELS = 4096
BRIGHTNESS = 0.75
BORDER_PX = 4
# Number of a face, by its axis and whether the ray that meets it goes in the axis's positive direction.
_FACES = np.array([[3, 1], [0, 2], [4, 5]])


class QuickCamera:
    """Photographs a rectangular room with landmarks on its walls.

    Args:
        scene: from `scene.furnish_room`; sheets have their textures, walls and floor their mean color.
        pale: fading by landmark: 0 full ink, 1 white paper.
    """

    def __init__(
        self, scene: Scene, camera: CameraModel, seed: int, pale: Mapping[LandmarkId, float] | None = None
    ) -> None:
        self._camera, self._size_m = camera, np.array(scene.size_m)
        shares = [(pale or {}).get(landmark.id, 0.0) for landmark in scene.landmarks]
        sheets = [landmark_sheet(landmark) for landmark in scene.landmarks]
        self._sheets = [_paled(sheet, share) if share else sheet for sheet, share in zip(sheets, shares, strict=True)]
        self._details = [_details(sheet.texture) for sheet in self._sheets]
        width, height = camera.image_size
        steps = (np.arange(OVERSAMPLE) + 0.5) / OVERSAMPLE - 0.5
        x, y = ((np.arange(n)[:, None] + steps).ravel() for n in (width, height))
        self._rays = camera.unproject_grid(x, y).astype(np.float32)
        coarse = camera.unproject_grid(
            np.arange(0, width + COARSE, COARSE, dtype=float), np.arange(0, height + COARSE, COARSE, dtype=float)
        )
        self._coarse = np.concatenate([coarse, np.ones((*coarse.shape[:2], 1))], axis=2).astype(np.float32)
        self._faces = np.array([*WALL_TINTS, FLOOR, CEILING], dtype=np.float32)
        rng = np.random.default_rng([seed, 11])
        noise = rng.normal(0, NOISE, (NOISES, height, width, 3))
        self._noise = np.round(noise).astype(np.int16)
        self._rng = rng
        codes = linear_to_srgb(np.arange(LEVELS) / (LEVELS - 1))
        self._tone = np.round(255 * codes).astype(np.uint8)
        self._linear = (np.searchsorted(codes, np.arange(256) / 255) / (BRIGHTNESS * (LEVELS - 1))).astype(np.float32)

    def __call__(self, T_map_camera: Pose, light: float = 1.0) -> ByteArray:
        """(H,W,3) BGR, 8 bit.

        Args:
            light: share of the usual light; 0 is darkness.
        """
        width, height = self._camera.image_size
        walls = self._coded(self._walls(T_map_camera) * light)
        image = np.ascontiguousarray(
            cv2.resize(walls, None, fx=COARSE, fy=COARSE, interpolation=cv2.INTER_LINEAR)[:height, :width],
            dtype=np.uint8,
        )
        for sheet, details in zip(self._sheets, self._details, strict=True):
            self._paint(image, sheet, details, T_map_camera, light)
        noise = self._noise[int(self._rng.integers(NOISES))]
        return np.asarray(cv2.add(image, noise, dtype=cv2.CV_8U), dtype=np.uint8)

    def _coded(self, linear: Float32Array) -> ByteArray:
        """BGR code values of red, green and blue light."""
        places = np.clip(linear * (BRIGHTNESS * (LEVELS - 1)), 0, LEVELS - 1).astype(np.uint16)
        return np.asarray(self._tone[places[:, :, ::-1]], dtype=np.uint8)

    def _walls(self, T: Pose) -> Float32Array:
        """(h,w,3) linear light of walls, floor and ceiling at low resolution: the nearest face of the room's box."""
        R, t, size = T.R.astype(np.float32), T.t.astype(np.float32), self._size_m.astype(np.float32)
        rays = self._coarse @ R.T
        ahead = rays > 0
        with np.errstate(divide="ignore", invalid="ignore"):
            lengths = np.where(rays == 0, np.float32(np.inf), (np.where(ahead, size, np.float32(0)) - t) / rays)
        axis = np.argmin(lengths, axis=2)
        at = t + np.take_along_axis(lengths, axis[:, :, None], axis=2) * rays
        face = _FACES[axis, np.take_along_axis(ahead, axis[:, :, None], axis=2)[:, :, 0].astype(np.intp)]
        uneven = 1 + 0.15 * np.sin(2.1 * at.sum(axis=2)) + 0.05 * np.sin(9.0 * at[:, :, 0] + 7.0 * at[:, :, 1])
        return np.asarray(self._faces[face] * uneven[:, :, None], dtype=np.float32)

    def _paint(
        self, image: ByteArray, sheet: Panel, details: list[Float32Array], T_map_camera: Pose, lit: float
    ) -> None:
        """Paint one sheet over the walls, in place; sheets never cover each other."""
        T = T_map_camera.inverse() @ sheet.T_map_panel
        if T.R[:, 2] @ T.t >= 0:  # seen from behind
            return
        w, h = sheet.size_m[0] / 2, sheet.size_m[1] / 2
        corners = T.apply(np.array([[-w, h, 0], [w, h, 0], [w, -h, 0], [-w, -h, 0]]))
        if corners[:, 2].min() < 0.1:
            return
        limit = np.array(self._camera.image_size) / self._camera.K[[0, 1], [0, 1]]
        if (np.abs(corners[:, :2] / corners[:, 2:]) > limit).any():
            return
        window = self._window(corners)
        if window is None:
            return
        rows, columns = window
        S = OVERSAMPLE
        rays = self._rays[S * rows.start : S * rows.stop, S * columns.start : S * columns.stop]
        u, v = _meet(rays, T)
        across = float(np.linalg.norm(self._camera.project(corners[:2])[1] - self._camera.project(corners[:2])[0]))
        texture = next((d for d in reversed(details) if d.shape[1] >= S * across), details[0])
        th, tw = texture.shape[:2]
        map_x, map_y = (u / (2 * w) + 0.5) * tw - 0.5, (0.5 - v / (2 * h)) * th - 0.5
        color = cv2.remap(texture, map_x, map_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        on = ((np.abs(u) < w) & (np.abs(v) < h)).astype(np.float32)[:, :, None]
        size = (columns.stop - columns.start, rows.stop - rows.start)
        share = cv2.resize(on, size, interpolation=cv2.INTER_AREA)[:, :, None]
        light = cv2.resize(color * on, size, interpolation=cv2.INTER_AREA)
        whole = self._linear[image[rows, columns][:, :, ::-1]] * (1 - share) + lit * light
        image[rows, columns] = self._coded(np.asarray(cv2.GaussianBlur(whole, (0, 0), BLUR_PX), dtype=np.float32))

    def _window(self, corners: FloatArray) -> tuple[slice, slice] | None:
        pixels = self._camera.project(corners)
        width, height = self._camera.image_size
        low = np.maximum(np.floor(pixels.min(axis=0)) - BORDER_PX, 0).astype(int)
        high = np.minimum(np.ceil(pixels.max(axis=0)) + BORDER_PX, [width, height]).astype(int)
        if (high - low < 2).any():
            return None
        return slice(int(low[1]), int(high[1])), slice(int(low[0]), int(high[0]))


def _paled(sheet: Panel, share: float) -> Panel:
    """A sheet with its ink faded toward the paper by a share."""
    paper = sheet.texture.max()
    return replace(sheet, texture=sheet.texture + np.float32(share) * (paper - sheet.texture))


def _meet(rays: Float32Array, T_camera_panel: Pose) -> tuple[Float32Array, Float32Array]:
    """Intersection of each ray with the panel's plane, m in the panel's frame."""
    R, t = T_camera_panel.R.astype(np.float32), T_camera_panel.t.astype(np.float32)
    x, y = rays[:, :, 0], rays[:, :, 1]
    n = R[:, 2]
    depth = float(n @ t) / (n[0] * x + n[1] * y + n[2])
    off = (depth * x - t[0], depth * y - t[1], depth - t[2])
    u = R[0, 0] * off[0] + R[1, 0] * off[1] + R[2, 0] * off[2]
    v = R[0, 1] * off[0] + R[1, 1] * off[1] + R[2, 1] * off[2]
    return u.astype(np.float32), v.astype(np.float32)


def _details(texture: Float32Array) -> list[Float32Array]:
    """The texture and its reductions (area-averaged), for sampling at several scales."""
    found = [texture]
    while min(found[-1].shape[:2]) > 24:
        smaller = (found[-1].shape[1] * 2 // 3, found[-1].shape[0] * 2 // 3)
        found.append(np.asarray(cv2.resize(texture, smaller, interpolation=cv2.INTER_AREA), dtype=np.float32))
    return found
