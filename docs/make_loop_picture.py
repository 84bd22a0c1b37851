"""Makes docs/loop.png, the README's picture of the loop, from the folder that `lmkit demo` wrote.

python docs/make_loop_picture.py lmkit-demo
"""

import sys
from pathlib import Path

import pypdfium2
from PIL import Image, ImageDraw, ImageFont, ImageOps

HEIGHT, GAP, CAPTION = 300, 46, 44
INK, PAPER = (45, 48, 54), (255, 255, 255)


def main(demo: Path) -> None:
    sheet = pypdfium2.PdfDocument(demo / "prints" / "landmarks.pdf")[0].render(scale=1.5).to_pil()
    board = Image.open(sorted((demo / "boards" / "left").glob("*.png"))[3])
    seen = Image.open(demo / "overlays" / "0000.jpg")
    plan = Image.open(demo / "plan.png")
    steps = [
        ("print", ImageOps.expand(sheet.convert("RGB"), 2, (200, 200, 200))),
        ("calibrate", board),
        ("detect", seen),
        ("locate", plan),
    ]
    tiles = [(name, image.resize((round(image.width * HEIGHT / image.height), HEIGHT))) for name, image in steps]
    width = sum(tile.width for _, tile in tiles) + GAP * (len(tiles) - 1)
    canvas = Image.new("RGB", (width, HEIGHT + CAPTION), PAPER)
    draw = ImageDraw.Draw(canvas)
    x = 0
    for index, (name, tile) in enumerate(tiles):
        canvas.paste(tile, (x, 0))
        centre = (x + tile.width / 2, HEIGHT + CAPTION / 2)
        draw.text(centre, name, INK, ImageFont.load_default(24), anchor="mm")
        x += tile.width
        if index < len(tiles) - 1:
            y, a = HEIGHT // 2, x + 10
            draw.line((a, y, a + GAP - 24, y), fill=INK, width=4)
            draw.polygon([(a + GAP - 20, y), (a + GAP - 34, y - 9), (a + GAP - 34, y + 9)], fill=INK)
        x += GAP
    canvas.save(Path(__file__).with_name("loop.png"), optimize=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
