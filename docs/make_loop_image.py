"""Makes docs/loop.png, the first image of the README, from the folder that `lmkit demo` wrote.

python docs/make_loop_image.py lmkit-demo
"""

import json
import sys
from pathlib import Path

import cv2
import numpy as np
import pypdfium2
from PIL import Image, ImageDraw, ImageFont

import lmkit

SIZE, GAP, TITLE, RIM = (500, 400), 64, 76, 10
INK, MUTED, SHEET, FRAME = (38, 42, 50), (108, 114, 124), (255, 255, 255), (208, 212, 218)


def main(demo: Path) -> None:
    tiles = [
        ("1  Print", "true to scale, read back", sheet_of(demo / "prints" / "landmarks.pdf")),
        ("2  Calibrate", "a board in both cameras", board_of(demo / "boards" / "left")),
        ("3  Detect", "landmarks in a color image", detections_of(demo)),
        ("4  Locate", "pose with covariance", plan_of(demo / "plan.png")),
    ]
    width, height = SIZE
    canvas = Image.new("RGB", (len(tiles) * (width + GAP) - GAP + 2 * RIM, height + TITLE + 56 + 2 * RIM), SHEET)
    draw = ImageDraw.Draw(canvas)
    for index, (title, text, tile) in enumerate(tiles):
        x, y = RIM + index * (width + GAP), RIM + TITLE
        draw.text((x, RIM + 28), title, INK, ImageFont.load_default(46), anchor="lm")
        canvas.paste(tile.resize(SIZE, Image.Resampling.LANCZOS), (x, y))
        draw.rectangle((x, y, x + width - 1, y + height - 1), outline=FRAME, width=2)
        draw.text((x, y + height + 32), text, MUTED, ImageFont.load_default(34), anchor="lm")
        if index < len(tiles) - 1:
            arrow(draw, x + width + GAP // 2, y + height // 2)
    canvas.quantize(200, dither=Image.Dither.NONE).save(Path(__file__).with_name("loop.png"), optimize=True)


def arrow(draw: ImageDraw.ImageDraw, x: int, y: int) -> None:
    """An arrow to the right, centered at a point."""
    draw.line((x - 20, y, x + 8, y), fill=INK, width=6)
    draw.polygon([(x + 22, y), (x + 2, y - 14), (x + 2, y + 14)], fill=INK)


def part(image: Image.Image, center: tuple[float, float], width: float) -> Image.Image:
    """A part with the shape of a tile, shifted to lie inside the image."""
    height = min(width * SIZE[1] / SIZE[0], image.height)
    width = min(height * SIZE[0] / SIZE[1], image.width)
    x = float(np.clip(center[0] - width / 2, 0, image.width - width))
    y = float(np.clip(center[1] - height / 2, 0, image.height - height))
    return image.crop((round(x), round(y), round(x + width), round(y + height)))


def sheet_of(path: Path) -> Image.Image:
    """The first page, centered on white."""
    page = pypdfium2.PdfDocument(path)[0].render(scale=2).to_pil().convert("RGB")
    wide = Image.new("RGB", (round(page.height * 0.75 * SIZE[0] / SIZE[1]), round(page.height * 0.75)), SHEET)
    wide.paste(page, ((wide.width - page.width) // 2, 0))
    return part(wide, (wide.width / 2, 0), wide.width)


def board_of(folder: Path) -> Image.Image:
    """The view in which the board is largest, around the board."""
    best = (0.0, Image.new("RGB", (1, 1)), (0.0, 0.0))
    for path in sorted(folder.glob("*.png")):
        image = lmkit.read_image(path)
        found, corners = cv2.findChessboardCornersSB(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), (9, 6))
        points = np.reshape(corners, (-1, 2)) if found else np.zeros((1, 2))  # OpenCV 4 and 5 differ in shape
        width, (x, y) = float(np.ptp(points, axis=0).max()), points.mean(axis=0)
        if width > best[0]:
            best = (
                width,
                as_pil(cv2.drawChessboardCorners(image.copy(), (9, 6), corners, found)),
                (float(x), float(y)),
            )
    return part(best[1], best[2], best[0] * 1.8)


def detections_of(demo: Path) -> Image.Image:
    """Detections in the image with the largest landmarks of all that show two or more."""
    truth = json.loads((demo / "truth.json").read_text(encoding="utf-8"))["pairs"]
    seen = {p["pair"]: p["landmarks"]["left"] for p in truth if len(p["landmarks"]["left"]) > 1}
    name = max(seen, key=lambda k: min(entry["side_px"] for entry in seen[k]))
    image = lmkit.read_image(demo / "drive" / "left" / f"{name}.png")
    found = lmkit.detect(image)
    center = found.centers.mean(axis=0)
    drawn = as_pil(lmkit.draw(image, found, enlarge=2))
    width = 2 * (float(np.ptp(found.corners[:, :, 0])) + 60)
    return part(drawn, (2 * float(center[0]), 2 * float(center[1])), width)


def plan_of(path: Path) -> Image.Image:
    """The plan without its rim."""
    plan = Image.open(path).convert("RGB")
    return part(plan, (plan.width / 2, plan.height * 0.53), plan.width * 0.93)


def as_pil(image: np.ndarray) -> Image.Image:
    """A BGR array as an image."""
    return Image.fromarray(np.ascontiguousarray(image[:, :, ::-1]))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
