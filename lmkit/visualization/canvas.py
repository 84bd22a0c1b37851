"""Drawing surfaces: one interface for PNG and SVG."""

from __future__ import annotations

import base64
import io
from collections.abc import Sequence
from html import escape
from typing import Protocol

from PIL import Image, ImageDraw, ImageFont

from lmkit.arrays import ByteArray

PAPER = (252, 252, 250)
OVERSAMPLE = 2
HALO, HALO_PX = (255, 255, 255), 3  # outline of words, so that they are readable on lines and colors


Rgb = tuple[int, int, int]


Points = Sequence[tuple[float, float]]


class Canvas(Protocol):
    """Interface of a drawing surface; pixels from the top left."""

    size: tuple[int, int]

    def line(self, points: Points, color: Rgb, width: float) -> None: ...
    def box(self, a: tuple[float, float], b: tuple[float, float], fill: Rgb) -> None: ...
    def text(
        self, at: tuple[float, float], text: str, size: float, color: Rgb, anchor: str, halo: bool = False
    ) -> float: ...
    def image(self, a: tuple[float, float], b: tuple[float, float], rgb: ByteArray) -> None: ...
    def file(self) -> bytes: ...


class PngCanvas:
    """PNG by Pillow, drawn larger and reduced."""

    def __init__(self, size: tuple[int, int]) -> None:
        self.size = size
        self._image = Image.new("RGB", (size[0] * OVERSAMPLE, size[1] * OVERSAMPLE), PAPER)
        self._draw = ImageDraw.Draw(self._image)

    def line(self, points: Points, color: Rgb, width: float) -> None:
        larger = [(x * OVERSAMPLE, y * OVERSAMPLE) for x, y in points]
        self._draw.line(larger, fill=color, width=round(width * OVERSAMPLE), joint="curve")

    def box(self, a: tuple[float, float], b: tuple[float, float], fill: Rgb) -> None:
        corners = [v * OVERSAMPLE for v in (*a, *b)]
        self._draw.rectangle(corners, fill=fill)

    def text(
        self, at: tuple[float, float], text: str, size: float, color: Rgb, anchor: str, halo: bool = False
    ) -> float:
        font = ImageFont.load_default(size * OVERSAMPLE)
        place = (at[0] * OVERSAMPLE, at[1] * OVERSAMPLE)
        around = HALO_PX * OVERSAMPLE
        place_of = {"start": "lm", "middle": "mm", "end": "rm"}[anchor]
        if halo:
            self._draw.text(place, text, HALO, font, anchor=place_of, stroke_width=around, stroke_fill=HALO)
        self._draw.text(place, text, color, font, anchor=place_of)
        return float(self._draw.textlength(text, font)) / OVERSAMPLE

    def image(self, a: tuple[float, float], b: tuple[float, float], rgb: ByteArray) -> None:
        # A floor far from the rest of the plan may be smaller than a pixel.
        size = (max(1, round((b[0] - a[0]) * OVERSAMPLE)), max(1, round((b[1] - a[1]) * OVERSAMPLE)))
        drawn = Image.fromarray(rgb).resize(size, Image.Resampling.NEAREST)
        self._image.paste(drawn, (round(a[0] * OVERSAMPLE), round(a[1] * OVERSAMPLE)))

    def file(self) -> bytes:
        buffer = io.BytesIO()
        self._image.resize(self.size, Image.Resampling.LANCZOS).save(buffer, format="PNG")
        return buffer.getvalue()


class SvgCanvas:
    """SVG as text."""

    def __init__(self, size: tuple[int, int]) -> None:
        self.size = size
        self._parts = [f'<rect width="{size[0]}" height="{size[1]}" fill="{hex_color(PAPER)}"/>']

    def line(self, points: Points, color: Rgb, width: float) -> None:
        path = "L".join(f"{x:.1f} {y:.1f}" for x, y in points)
        self._parts.append(f'<path d="M{path}" fill="none" stroke="{hex_color(color)}" stroke-width="{width:g}"/>')

    def box(self, a: tuple[float, float], b: tuple[float, float], fill: Rgb) -> None:
        place = f'x="{a[0]:.1f}" y="{a[1]:.1f}" width="{b[0] - a[0]:.1f}" height="{b[1] - a[1]:.1f}"'
        self._parts.append(f'<rect {place} fill="{hex_color(fill)}"/>')

    def text(
        self, at: tuple[float, float], text: str, size: float, color: Rgb, anchor: str, halo: bool = False
    ) -> float:
        place = f'x="{at[0]:.1f}" y="{at[1] + size * 0.35:.1f}" font-size="{size:g}" text-anchor="{anchor}"'
        around = f'stroke="{hex_color(HALO)}" stroke-width="{2 * HALO_PX}" stroke-linejoin="round" ' if halo else ""
        order = 'paint-order="stroke" ' if halo else ""
        self._parts.append(f'<text {place} {around}{order}fill="{hex_color(color)}">{escape(text)}</text>')
        return 0.52 * size * len(text)

    def image(self, a: tuple[float, float], b: tuple[float, float], rgb: ByteArray) -> None:
        buffer = io.BytesIO()
        Image.fromarray(rgb).save(buffer, format="PNG")
        data = base64.b64encode(buffer.getvalue()).decode()
        place = f'x="{a[0]:.1f}" y="{a[1]:.1f}" width="{b[0] - a[0]:.1f}" height="{b[1] - a[1]:.1f}"'
        look = 'preserveAspectRatio="none" style="image-rendering:pixelated"'
        self._parts.append(f'<image {place} {look} href="data:image/png;base64,{data}"/>')

    def file(self) -> bytes:
        width, height = self.size
        head = (
            f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" '
            f'viewBox="0 0 {width} {height}" font-family="sans-serif">'
        )
        return "\n".join([head, *self._parts, "</svg>\n"]).encode()


def hex_color(color: Rgb) -> str:
    return "#{:02x}{:02x}{:02x}".format(*color)
