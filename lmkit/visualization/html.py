"""Reports as one self-contained HTML page each, in light and dark colors."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from html import escape

GRAY = "#888"
_NUMBER = " class='n'"
SHORT_ROWS = 14  # tables with up to this many rows are not split in print
_STYLE = """
:root { color-scheme: light dark; --line: #8884; --good: #1a7f37; --fair: #9a6700; --poor: #cf222e; }
body { font: 1rem/1.5 system-ui, sans-serif; max-width: 66rem; margin: 2rem auto; padding: 0 1rem; }
h1 { font-size: 1.5rem; margin-bottom: 0; } h2 { font-size: 1.15rem; margin: 2.4rem 0 .4rem; }
.headline { border-left: 6px solid var(--tone); padding: .6rem 1rem; background: #8881; font-size: 1.1rem; }
.headline b { display: block; font-size: 1.25rem; } ul { padding-left: 1.3rem; } li { margin: .25rem 0; }
p.note { margin: .3rem 0; opacity: .8; max-width: 46rem; }
.table { overflow-x: auto; margin: .5rem 0; } table { border-collapse: collapse; }
td, th { padding: .25rem .9rem .25rem 0; text-align: left; } th { vertical-align: bottom; }
tr { border-bottom: 1px solid var(--line); }
.n { text-align: right; font-variant-numeric: tabular-nums; } td.n { white-space: nowrap; }
code { white-space: nowrap; } figure { margin: .6rem 0; } figcaption { font-size: .9rem; opacity: .8; }
img, svg { max-width: 100%; height: auto; display: block; } .narrow { display: none; }
.grid { display: grid; grid-template-columns: repeat(auto-fill, minmax(min(18.5rem, 100%), 1fr)); gap: .2rem 1.4rem; }
.grid.two { grid-template-columns: repeat(auto-fill, minmax(min(24rem, 100%), 1fr)); }
h2, h2 + p { break-after: avoid; } figure, tr, li, .headline, .short, h2 + p + ul { break-inside: avoid; }
h2 + p + ul { break-before: avoid; }
@media screen and (max-width: 44rem) {
  body { margin: 1rem auto; } .wide { display: none; } .narrow { display: block; }
  .table { font-size: .82rem; } td, th { padding-right: .6rem; }
  .table tr > :first-child { position: sticky; left: 0; background: Canvas; }
  .table { background: linear-gradient(to left, Canvas 40%, transparent) right / 2.5rem 100% no-repeat local,
    linear-gradient(to left, #8886, transparent) right / .8rem 100% no-repeat; }
}
@media print {
  @page { margin: 15mm; } body { font-size: 10pt; max-width: none; margin: 0; padding: 0; }
  h2 { margin-top: 1.4rem; } .table { font-size: 9pt; overflow: visible; }
  .headline, svg { print-color-adjust: exact; }
  .grid, .grid.two { grid-template-columns: 1fr 1fr; } img, svg { max-height: 220mm; }
}
"""


def page(title: str, parts: Iterable[str]) -> str:
    """The whole file from HTML parts."""
    head = (
        "<!doctype html><html lang='en'><head><meta charset='utf-8'>"
        "<meta name='viewport' content='width=device-width,initial-scale=1'>"
        f"<title>{escape(title)}</title><style>{_STYLE}</style></head><body><h1>{escape(title)}</h1>"
    )
    return "\n".join([head, *parts, "</body></html>"])


def headline(tone: str, headline: str, reason: str) -> str:
    """The main sentence of a report; ``tone`` is ``good``, ``fair`` or ``poor``."""
    return f"<p class='headline' style='--tone: var(--{tone})'><b>{escape(headline)}</b>{escape(reason)}</p>"


def listed(heading: str, texts: Sequence[str]) -> str:
    """A heading and a list; empty if there are no items."""
    if not texts:
        return ""
    return f"<h2>{escape(heading)}</h2><ul>{''.join(f'<li>{escape(text)}</li>' for text in texts)}</ul>"


def table(head: Sequence[str], rows: Iterable[Sequence[str]], words: Collection[int] = (0,)) -> str:
    """Table of rows of cells, with its own scroll bar on narrow pages.

    Args:
        head: names of the columns; empty: no header.
        words: columns with text; the others have numbers.
    """
    kinds = dict.fromkeys(words, "")
    names = "".join(f"<th{kinds.get(k, _NUMBER)}>{escape(name)}</th>" for k, name in enumerate(head))
    lines = [
        "<tr>" + "".join(f"<td{kinds.get(k, _NUMBER)}>{escape(cell)}</td>" for k, cell in enumerate(row)) + "</tr>"
        for row in rows
    ]
    top = f"<thead><tr>{names}</tr></thead>" if head else ""
    short = " short" if len(lines) <= SHORT_ROWS else ""
    return f"<div class='table{short}'><table>{top}<tbody>{''.join(lines)}</tbody></table></div>"


def columns_table(head: Sequence[str], columns: Sequence[Sequence[str]]) -> str:
    """Table of a few items with many values: one column per item, so that it fits on narrow pages.

    Args:
        head: names of the values; the first entry names the items.
        columns: name and values of each item.
    """
    first, *rows = zip(head, *columns, strict=True)
    return table(first, rows)


def figure(drawing: str, caption: str) -> str:
    """An image or drawing with a caption."""
    return f"<figure>{drawing}<figcaption>{caption}</figcaption></figure>"


def sized(wide: str, narrow: str) -> str:
    """Two versions of a drawing: the second one, with larger text, is shown on phones."""
    return f"<div class='wide'>{wide}</div><div class='narrow'>{narrow}</div>"


def grid(figures: Iterable[tuple[str, str]], kind: str = "") -> str:
    """Drawings with their captions, side by side."""
    return f"<div class='grid {kind}'>{''.join(figure(*one) for one in figures)}</div>"


def svg(box: tuple[float, float, float, float], width: int, label: str, body: str) -> str:
    """A drawing with its view box (x, y, width, height) and its width in pixels."""
    x, y, w, h = box
    return (
        f"<svg viewBox='{x:g} {y:g} {w:g} {h:g}' width='{width}' role='img' aria-label='{escape(label)}'>{body}</svg>"
    )


def svg_text(x: float, y: float, text: str, size: float, anchor: str = "start") -> str:
    """Gray words in a drawing."""
    place = f"x='{x:.1f}' y='{y:.1f}' font-size='{size:g}' text-anchor='{anchor}'"
    return f"<text {place} fill='{GRAY}'>{escape(text)}</text>"
