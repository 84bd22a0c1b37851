"""Reports as one HTML page each, light and dark alike; nothing is fetched from anywhere."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape

GRAY = "#888"
_STYLE = """
:root { color-scheme: light dark; --line: #8884; --good: #1a7f37; --fair: #9a6700; --poor: #cf222e; }
body { font: 16px/1.5 system-ui, sans-serif; max-width: 66rem; margin: 2rem auto; padding: 0 1rem; }
h1 { font-size: 1.5rem; margin-bottom: 0; } h2 { font-size: 1.15rem; margin-top: 2.4rem; margin-bottom: .4rem; }
.headline { border-left: 6px solid var(--tone); padding: .6rem 1rem; background: #8881; font-size: 1.1rem; }
.headline b { display: block; font-size: 1.25rem; } p.note { margin: .3rem 0; opacity: .8; max-width: 46rem; }
table { border-collapse: collapse; margin: .5rem 0; } td, th { padding: .25rem .9rem .25rem 0; text-align: left; }
tr { border-bottom: 1px solid var(--line); } .n { text-align: right; font-variant-numeric: tabular-nums; }
figure { margin: .6rem 0; } figcaption { font-size: .9rem; opacity: .8; }
img, svg { max-width: 100%; height: auto; display: block; }
.grid { display: grid; grid-template-columns: repeat(auto-fill, minmax(18.5rem, 1fr)); gap: .2rem 1.4rem; }
.grid.two { grid-template-columns: repeat(auto-fill, minmax(min(24rem, 100%), 1fr)); }
@media (max-width: 44rem) { table { display: block; overflow-x: auto; } }
"""


def page(title: str, parts: Iterable[str]) -> str:
    """The whole file, of HTML parts."""
    head = (
        "<!doctype html><html lang='en'><head><meta charset='utf-8'>"
        "<meta name='viewport' content='width=device-width,initial-scale=1'>"
        f"<title>{escape(title)}</title><style>{_STYLE}</style></head><body><h1>{escape(title)}</h1>"
    )
    return "\n".join([head, *parts, "</body></html>"])


def headline(tone: str, headline: str, reason: str) -> str:
    """The one sentence to take away; ``tone`` is ``good``, ``fair`` or ``poor``."""
    return f"<p class='headline' style='--tone: var(--{tone})'><b>{escape(headline)}</b>{escape(reason)}</p>"


def listed(heading: str, texts: Sequence[str]) -> str:
    """A heading and a list; nothing where there is nothing to list."""
    if not texts:
        return ""
    return f"<h2>{escape(heading)}</h2><ul>{''.join(f'<li>{escape(text)}</li>' for text in texts)}</ul>"


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Words in the first column, numbers in the others."""
    names = "".join(f"<th{_right(k)}>{escape(name)}</th>" for k, name in enumerate(head))
    body = "".join(
        "<tr>" + "".join(f"<td{_right(k)}>{escape(cell)}</td>" for k, cell in enumerate(row)) + "</tr>"
        for row in rows
    )
    return f"<table><tr>{names}</tr>{body}</table>"


def figure(drawing: str, caption: str) -> str:
    """An image or drawing with words below."""
    return f"<figure>{drawing}<figcaption>{caption}</figcaption></figure>"


def grid(figures: Iterable[tuple[str, str]], kind: str = "") -> str:
    """Drawings with their captions, side by side."""
    return f"<div class='grid {kind}'>{''.join(figure(*one) for one in figures)}</div>"


def svg(box: tuple[float, float, float, float], width: int, label: str, body: str) -> str:
    """A drawing of x, y, width, height in its own units, so many pixels wide."""
    x, y, w, h = box
    return (
        f"<svg viewBox='{x:g} {y:g} {w:g} {h:g}' width='{width}' role='img' aria-label='{escape(label)}'>{body}</svg>"
    )


def svg_text(x: float, y: float, text: str, size: float, anchor: str = "start") -> str:
    """Gray words in a drawing."""
    place = f"x='{x:.1f}' y='{y:.1f}' font-size='{size:g}' text-anchor='{anchor}'"
    return f"<text {place} fill='{GRAY}'>{escape(text)}</text>"


def _right(column: int) -> str:
    return " class='n'" if column else ""
