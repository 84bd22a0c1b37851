"""Graded prints as JSON, as lines of text, and as annotated images."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from lmkit.verification.prints import PrintedLandmark
from lmkit.visualization.overlay import draw_landmarks, encode_jpeg

# ANSI color numbers of the grades, for terminals.
GRADE_COLORS = {"A": 32, "B": 32, "C": 33, "D": 33, "F": 31}


def print_dict(item: PrintedLandmark, passes: bool) -> dict[str, Any]:
    """One graded landmark as docs/formats.md has it."""
    seen = item.observation
    lines = {
        line.name: {"value": line.value, "grade": line.grade, "advice": line.advice or None} for line in item.lines
    }
    return {
        "source": item.source,
        "id": str(seen.id),
        "code": seen.code,
        "family": seen.family,
        "corners": seen.corners.tolist(),
        "confidence": seen.confidence,
        "margin": seen.margin,
        "side_mm": None if item.side_mm is None else list(item.side_mm),
        "scale_from": item.scale_from,
        "stated_code": item.stated_code,
        "stated_mm": item.stated_mm,
        "grade": item.grade,
        "lines": lines,
        "problems": list(item.problems),
        "ok": passes,
    }


def print_lines(item: PrintedLandmark, in_full: bool, color: bool) -> list[str]:
    """One graded landmark as lines of text.

    Args:
        in_full: with a line for every property graded.
        color: with ANSI colors for the grades.
    """
    seen = item.observation
    size = "size not measured" if item.stated_mm is not None else "size unknown"
    if item.side_mm is not None:
        size = f"{item.side_mm[0]:.2f} x {item.side_mm[1]:.2f} mm"
    problems = f": {'; '.join(item.problems)}" if item.problems else ""
    lines = [f"{item.source}: code {seen.code}, {size}, grade {item.grade}{problems}"]
    for line in item.lines if in_full else ():
        grade = line.grade or "-"
        if line.grade is not None and color:
            grade = f"\x1b[{GRADE_COLORS[line.grade]}m{grade}\x1b[0m"
        lines.append(f"  {grade}  {line.name:<24} {line.value:<34} {line.advice}".rstrip())
    return lines


def annotated_prints(found: Sequence[PrintedLandmark]) -> dict[str, bytes]:
    """JPEG files by name: every page with its landmarks outlined."""
    files = {}
    for source in dict.fromkeys(item.source for item in found):
        some = [item for item in found if item.source == source]
        image = draw_landmarks(some[0].image, [item.observation for item in some])
        files[f"{Path(source.replace(' page ', '-')).name}.jpg"] = encode_jpeg(image)
    return files
