"""Values over time as plots of HTML reports."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.visualization.html import GRAY, svg, svg_text

MOST_DOTS = 3000
SEEN, LEFT_OUT, OTHER = "#2f6fde", "#cf222e", "#e8833a"
WIDTH, HEIGHT, ASIDE, BELOW = 330.0, 150.0, 46.0, 24.0  # narrow, so that text is readable on a phone


@dataclass(frozen=True, eq=False)
class Series:
    """Values (N,) at times (N,), drawn as dots or as a line."""

    times_s: FloatArray
    values: FloatArray
    color: str
    dots: bool = True


def over_time(series: Sequence[Series], label: str, log: bool = False) -> str:
    """Values over time, linear from 0 or logarithmic."""
    times = np.concatenate([s.times_s for s in series])
    values = np.concatenate([s.values for s in series])
    first, last = float(times.min()), max(float(times.max()), float(times.min()) + 1e-9)
    if log:
        low = 10 ** np.floor(np.log10(max(float(np.percentile(values, 1)), 1e-2)))
        high = 10 ** np.ceil(np.log10(max(float(values.max()), 10 * low)))
        ticks = [float(10**power) for power in range(round(np.log10(low)), round(np.log10(high)) + 1)]
    else:
        high = _round_up(float(values.max()))
        low, ticks = 0.0, [0.0, high / 2, high]

    def up(value: FloatArray) -> FloatArray:
        share = np.log(np.clip(value, low, high) / low) / np.log(high / low) if log else value / high
        return np.asarray(HEIGHT * (1 - share))

    def along(times_s: FloatArray) -> FloatArray:
        return np.asarray((times_s - first) / (last - first) * WIDTH)

    parts = []
    for tick in ticks:
        level = float(up(np.array(tick)))
        parts.append(f"<path d='M0 {level:.1f}H{WIDTH:g}' stroke='{GRAY}' stroke-opacity='.35'/>")
        parts.append(svg_text(-6, level + 4, _tick(tick), 12, "end"))
    for one in series:
        x, y = along(one.times_s), up(one.values)
        if one.dots:
            step = 1 + len(x) // MOST_DOTS
            parts += [
                f"<circle cx='{a:.1f}' cy='{b:.1f}' r='1.6' fill='{one.color}' fill-opacity='.6'/>"
                for a, b in zip(x[::step], y[::step], strict=True)
            ]
        else:
            path = "L".join(f"{a:.1f} {b:.1f}" for a, b in zip(x, y, strict=True))
            parts.append(f"<path d='M{path}' fill='none' stroke='{one.color}' stroke-width='1.6'/>")
    parts.append(svg_text(0, -8, label, 13))
    parts.append(svg_text(0, HEIGHT + 18, f"{first:.1f} s", 12))
    parts.append(svg_text(WIDTH, HEIGHT + 18, f"{last:.1f} s", 12, "end"))
    box = (-ASIDE, -BELOW, WIDTH + ASIDE + 12, HEIGHT + 2 * BELOW)
    return svg(box, 500, label, "".join(parts))


def _tick(value: float) -> str:
    """A short number: 1e5, not 100000."""
    return f"{value:g}" if value < 1e4 else f"{value:.0e}".replace("e+0", "e")


def _round_up(value: float) -> float:
    """The next of 1, 2, 5, 10, ..."""
    power = 10 ** np.floor(np.log10(max(value, 1e-9)))
    return float(next(step * power for step in (1, 2, 5, 10) if step * power >= value * (1 - 1e-9)))
