"""SVG of a page in exact size, in millimeters."""

from __future__ import annotations

from xml.sax.saxutils import escape

from lmkit.generation.artwork import FilledPath
from lmkit.generation.page import Page, Text


def page_to_svg(page: Page) -> str:
    """An SVG document; one user unit is one millimeter."""
    width, height = page.size_mm
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:g}mm" height="{height:g}mm" '
        f'viewBox="0 0 {width:g} {height:g}">',
        f"<title>{escape(page.title)}</title>",
        f'<rect width="{width:g}" height="{height:g}" fill="#ffffff"/>',
    ]
    (x0, y0), (x1, y1) = page.on_paper((0.0, 0.0)), page.on_paper((1.0, 1.0))
    if (x0, y0, x1, y1) != (0.0, 0.0, 1.0, 1.0):
        lines.append(f'<g transform="matrix({x1 - x0:.8g} 0 0 {y1 - y0:.8g} {x0:.8g} {y0:.8g})">')
    else:
        lines.append("<g>")
    if page.window is not None:
        left, top, right, bottom = page.window
        lines.append(
            f'<clipPath id="window"><rect x="{left:g}" y="{top:g}" width="{right - left:g}" '
            f'height="{bottom - top:g}"/></clipPath>'
        )
        lines += ['<g clip-path="url(#window)">', *(_path(shape) for shape in page.windowed), "</g>"]
    lines += [_text(item) if isinstance(item, Text) else _path(item) for item in page.items]
    return "\n".join([*lines, "</g>", "</svg>", ""])


def _color(rgb: tuple[int, int, int]) -> str:
    return "#{:02x}{:02x}{:02x}".format(*rgb)


def _path(shape: FilledPath) -> str:
    d = " ".join(command[0] + " ".join(f"{x:.5f},{y:.5f}" for x, y in command[1:]) for command in shape.commands)
    return f'<path class="{shape.role}" fill="{_color(shape.color)}" fill-rule="evenodd" d="{d}"/>'


def _text(text: Text) -> str:
    x, y = text.at
    rotation = f' transform="rotate({-text.rotation_deg} {x:g} {y:g})"' if text.rotation_deg else ""
    weight = ' font-weight="bold"' if text.bold else ""
    return (
        f'<text x="{x:g}" y="{y:g}" font-family="Helvetica, Arial, sans-serif" font-size="{text.height_mm:g}"'
        f'{weight} text-anchor="{text.anchor}" fill="{_color(text.color)}"{rotation}>{escape(text.content)}</text>'
    )
