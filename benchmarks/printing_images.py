"""The images of docs/printing.md: how far a landmark is read, the templates, and what goes wrong.

    uv run --extra benchmark python benchmarks/printing_images.py

The faults are planted and photographed by prints.py; everything in them is simulated.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import matplotlib.pyplot as plt
import numpy as np
import prints
import pypdfium2
from PIL import Image, ImageDraw, ImageFont

from lmkit.generation.pdf import pages_to_pdf
from lmkit.generation.sheet import Wording, compose_sheets
from lmkit.generation.tiles import compose_tiles
from lmkit.io.template import load_template, shipped_templates
from lmkit.model.landmark import LM8
from lmkit.simulation.inks import OFFSET, as_printed
from lmkit.verification.prints import Stated, grade_sheet

OUT = Path(__file__).resolve().parents[1] / "docs" / "printing"
# Sides at which 95 of 100 are read, benchmarks/README.md: frontal, and tilted by 45 degrees.
FRONTAL_PX, TILTED_PX = 17.5, 21.5
FAULTS = ("scale 0.97", "faded blue", "magenta cast", "streaks", "margin cut", "glare spot", "low ink", "moire")


def chart() -> None:
    """Distance against size for three cameras."""
    plt.switch_backend("Agg")
    figure, axis = plt.subplots(figsize=(8, 4.5))
    sizes = np.linspace(0.03, 0.6, 100)
    cameras = (("f = 450 px (VGA, wide)", 450), ("f = 600 px (VGA)", 600), ("f = 1200 px (720p)", 1200))
    for (name, focal), color in zip(cameras, ("#b5442e", "#00549f", "#2b7a3d"), strict=True):
        axis.plot(1000 * sizes, focal * sizes / FRONTAL_PX, color=color, label=f"{name}, seen from the front")
        axis.plot(1000 * sizes, focal * sizes / TILTED_PX, color=color, ls="--", label="    tilted by 45 deg")
    axis.axvline(180, color="gray", lw=0.8)
    axis.annotate("180 mm", (184, 0.7), color="gray")
    axis.set_xlabel("size: outer edge to outer edge of the red border, mm")
    axis.set_ylabel("distance at which 95 of 100 are read, m")
    axis.set_ylim(0, 25)
    axis.grid(alpha=0.3)
    axis.legend(fontsize=8)
    figure.tight_layout()
    figure.savefig(OUT / "distance.png", dpi=110)


def with_caption(drawn: np.ndarray, words: str, size: tuple[int, int]) -> Image.Image:
    """An RGB image fitted into a box, with a line under it."""
    box = Image.new("RGB", (size[0], size[1] + 26), "white")
    image = Image.fromarray(drawn)
    image.thumbnail((size[0] - 8, size[1] - 4), Image.Resampling.LANCZOS)
    box.paste(image, ((size[0] - image.width) // 2, (size[1] - image.height) // 2))
    ImageDraw.Draw(box).text((size[0] // 2, size[1] + 2), words, "black", ImageFont.load_default(13), anchor="ma")
    return box


def mosaic(boxes: list[Image.Image], columns: int, path: Path) -> None:
    """Boxes row by row."""
    width, height = boxes[0].size
    whole = Image.new("RGB", (columns * width, -(-len(boxes) // columns) * height), "white")
    for k, box in enumerate(boxes):
        whole.paste(box, ((k % columns) * width, (k // columns) * height))
    whole.save(path, optimize=True)


def raster(pages: list, number: int) -> np.ndarray:
    """A page with a thin gray edge, RGB."""
    rgb = np.asarray(pypdfium2.PdfDocument(pages_to_pdf(pages, ""))[number].render(scale=0.7).to_pil().convert("RGB"))
    return cv2.copyMakeBorder(rgb, 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=(150, 150, 150))


def templates() -> None:
    """The first sheet of every template, and of a tiled landmark."""
    boxes = []
    for name in shipped_templates():
        codes = range(137, 157)
        pages = compose_sheets(LM8, list(codes), load_template(name), wording=Wording("Room 12", "second floor"))
        boxes.append(with_caption(raster(pages, 0), name, (190, 240)))
    tiles = compose_tiles(LM8, 137, 540, "a4")
    boxes += [with_caption(raster(tiles, k), f"--size 540mm, page {k + 1}", (190, 240)) for k in (0, 6)]
    mosaic(boxes, 7, OUT / "templates.png")


def faults() -> None:
    """Photographs of prints with planted faults, each with the grade line that reports it."""
    boxes = []
    for name in FAULTS:
        rng = np.random.default_rng(11)
        sheet, look = prints.Sheet(prints.drawn(137), 137), prints.Viewing()
        sheet, look = prints.DEFECTS[name][0](sheet, look, rng)
        printed = prints.Sheet(as_printed(sheet.texture.astype(np.float32), OFFSET), sheet.code)
        photo = prints.photograph(printed, look, rng)
        (item, *_) = grade_sheet("", photo, None, (Stated(137, LM8, 180.0),))
        wanted = prints.DEFECTS[name][1]
        answer = min(
            (line for line in item.lines if line.name in wanted), key=lambda line: "FDCBA".index(line.grade or "A")
        )
        middle = item.observation.corners.mean(axis=0).astype(int)
        reach = int(0.8 * np.ptp(item.observation.corners[:, 0]))
        part = photo[max(middle[1] - reach, 0) : middle[1] + reach, max(middle[0] - reach, 0) : middle[0] + reach]
        caption = f"{answer.name}: {answer.value} -> {answer.grade}"
        boxes.append(with_caption(part[:, :, ::-1].copy(), caption, (300, 290)))
    mosaic(boxes, 4, OUT / "faults.png")


if __name__ == "__main__":
    chart()
    templates()
    faults()
