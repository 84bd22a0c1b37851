"""A page -> SVG of exact size, in millimetres."""

from __future__ import annotations

from xml.sax.saxutils import escape

from lmkit.generate.artwork import FilledPath
from lmkit.generate.page import Page, Text


def page_to_svg(page: Page) -> str:
    """An SVG document; one user unit is one millimetre."""
    width, height = page.size_mm
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:g}mm" height="{height:g}mm" '
        f'viewBox="0 0 {width:g} {height:g}">',
        f"<title>{escape(page.title)}</title>",
        f'<rect width="{width:g}" height="{height:g}" fill="#ffffff"/>',
    ]
    lines += [_text(item) if isinstance(item, Text) else _path(item) for item in page.items]
    return "\n".join([*lines, "</svg>", ""])


def _color(rgb: tuple[int, int, int]) -> str:
    return "#{:02x}{:02x}{:02x}".format(*rgb)


def _path(shape: FilledPath) -> str:
    d = " ".join(command[0] + " ".join(f"{x:.5f},{y:.5f}" for x, y in command[1:]) for command in shape.commands)
    return f'<path class="{shape.role}" fill="{_color(shape.color)}" fill-rule="evenodd" d="{d}"/>'


def _text(text: Text) -> str:
    x, y = text.at
    turn = f' transform="rotate(-90 {x:g} {y:g})"' if text.vertical else ""
    weight = ' font-weight="bold"' if text.bold else ""
    return (
        f'<text x="{x:g}" y="{y:g}" font-family="Helvetica, Arial, sans-serif" font-size="{text.height_mm:g}"'
        f'{weight} text-anchor="{text.anchor}" fill="{_color(text.color)}"{turn}>{escape(text.content)}</text>'
    )
