"""A room from above: landmarks, true poses, found poses with their 95 % ellipses."""

from __future__ import annotations

import io
from collections.abc import Sequence

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from lmkit.arrays import FloatArray
from lmkit.model.estimate import PoseEstimate
from lmkit.model.landmark_map import LandmarkMap
from lmkit.model.pose import Pose

PIXELS_PER_M = 150
MARGIN_PX = 90
OVERSAMPLE = 2
ELLIPSE_GAIN = 10.0
CHI2_2D_95 = 5.991

PAPER, WALL, INK = (252, 252, 250), (70, 74, 80), (40, 42, 46)
RED, BLUE, GREEN, ORANGE = (237, 28, 36), (0, 84, 166), (34, 139, 72), (226, 120, 20)


def draw_plan(
    landmarks: LandmarkMap,
    size_m: tuple[float, float],
    truth: Sequence[Pose],
    estimates: Sequence[PoseEstimate],
    title: str,
) -> bytes:
    """The bytes of a PNG file.

    Args:
        size_m: (x, y) extent of the room, whose corner is the map's origin.
        truth, estimates: true and found poses of the camera, one each per pair.
    """
    plan = _Plan(size_m)
    plan.room()
    for landmark in landmarks:
        plan.landmark(landmark.T_map_landmark, landmark.size_m, str(landmark.code))
    for index, (true, found) in enumerate(zip(truth, estimates, strict=True)):
        plan.camera(true, GREEN, 3, None)
        if found.T_map_camera is not None:
            plan.camera(found.T_map_camera, ORANGE, 2, str(index))
            if found.covariance is not None:
                plan.ellipse(found.T_map_camera.t, found.covariance[:2, :2])
    plan.words(title)
    return plan.png()


class _Plan:
    """Metres on paper: x to the right, y up."""

    def __init__(self, size_m: tuple[float, float]) -> None:
        self.size_m = size_m
        self.scale = PIXELS_PER_M * OVERSAMPLE
        self.margin = MARGIN_PX * OVERSAMPLE
        width = round(size_m[0] * self.scale + 2 * self.margin)
        height = round(size_m[1] * self.scale + 2 * self.margin)
        self.image = Image.new("RGB", (width, height), PAPER)
        self.draw = ImageDraw.Draw(self.image)

    def at(self, xy: FloatArray) -> tuple[float, float]:
        return (
            self.margin + float(xy[0]) * self.scale,
            self.image.height - self.margin - float(xy[1]) * self.scale,
        )

    def font(self, size: float) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
        return ImageFont.load_default(size * OVERSAMPLE)

    def room(self) -> None:
        a, b = self.at(np.zeros(2)), self.at(np.array(self.size_m))
        self.draw.rectangle((a[0], b[1], b[0], a[1]), fill=(255, 255, 255), outline=WALL, width=5 * OVERSAMPLE)
        for metre in range(1, int(max(self.size_m)) + 1):
            for start, end in (((metre, 0), (metre, self.size_m[1])), ((0, metre), (self.size_m[0], metre))):
                if start[0] < self.size_m[0] and start[1] < self.size_m[1]:
                    self.draw.line(
                        (*self.at(np.array(start)), *self.at(np.array(end))),
                        fill=(232, 234, 236),
                        width=OVERSAMPLE,
                    )

    def landmark(self, pose: Pose, size_m: float, label: str) -> None:
        along, out = pose.R[:2, 0], pose.R[:2, 2]
        a, b = pose.t[:2] - along * size_m / 2, pose.t[:2] + along * size_m / 2
        self.draw.line((*self.at(a), *self.at(b)), fill=RED, width=12 * OVERSAMPLE)
        self.draw.line((*self.at(a + 0.02 * (b - a)), *self.at(b - 0.02 * (b - a))), fill=BLUE, width=6 * OVERSAMPLE)
        self.draw.text(self.at(pose.t[:2] - 0.17 * out), label, INK, self.font(15), anchor="mm")

    def camera(self, pose: Pose, color: tuple[int, int, int], width: int, label: str | None) -> None:
        forward, right = pose.R[:2, 2], pose.R[:2, 0]
        tips = [pose.t[:2] + 0.24 * forward + side * 0.13 * right for side in (-1, 1)]
        outline = [self.at(pose.t[:2]), self.at(tips[0]), self.at(tips[1]), self.at(pose.t[:2])]
        self.draw.line(outline, fill=color, width=width * OVERSAMPLE, joint="curve")
        if label is not None:
            self.draw.text(self.at(pose.t[:2] - 0.12 * forward), label, INK, self.font(14), anchor="mm")

    def ellipse(self, centre: FloatArray, covariance: FloatArray) -> None:
        values, vectors = np.linalg.eigh(covariance)
        turns = np.linspace(0, 2 * np.pi, 48)
        radii = np.sqrt(np.clip(values, 0, None) * CHI2_2D_95) * ELLIPSE_GAIN
        points = centre[:2] + (np.column_stack([np.cos(turns), np.sin(turns)]) * radii) @ vectors.T
        self.draw.line([self.at(p) for p in points], fill=ORANGE, width=OVERSAMPLE)

    def words(self, title: str) -> None:
        self.draw.text((self.margin, self.margin * 0.28), title, INK, self.font(19), anchor="lm")
        y = self.image.height - self.margin * 0.3
        legend = (
            (GREEN, "true pose"),
            (ORANGE, f"found, 95 % ellipse {ELLIPSE_GAIN:g} times enlarged"),
            (RED, "landmark and its code"),
        )
        x = float(self.margin)
        for color, text in legend:
            self.draw.line((x, y, x + 26 * OVERSAMPLE, y), fill=color, width=5 * OVERSAMPLE)
            self.draw.text((x + 34 * OVERSAMPLE, y), text, INK, self.font(15), anchor="lm")
            x += 60 * OVERSAMPLE + self.draw.textlength(text, self.font(15))
        self.draw.text((self.image.width - self.margin, y), "grid 1 m", (140, 144, 150), self.font(14), anchor="rm")

    def png(self) -> bytes:
        size = (self.image.width // OVERSAMPLE, self.image.height // OVERSAMPLE)
        buffer = io.BytesIO()
        self.image.resize(size, Image.Resampling.LANCZOS).save(buffer, format="PNG")
        return buffer.getvalue()
