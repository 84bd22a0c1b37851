"""Graded prints as JSON, as lines of text, and as annotated images."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from lmkit.arrays import ByteArray
from lmkit.verification.prints import PrintedLandmark
from lmkit.visualization.overlay import GREEN, RED, YELLOW, draw_landmarks

# ANSI color numbers of the grades, for terminals.
GRADE_COLORS = {"A": 32, "B": 32, "C": 33, "D": 33, "F": 31}
OUTLINES = {"A": GREEN, "B": GREEN, "C": YELLOW, "D": YELLOW, "F": RED}
SMALL_PX = 800  # images whose longer side is shorter are drawn twice as large


def print_dict(item: PrintedLandmark, passes: bool) -> dict[str, Any]:
    """The JSON result of one graded landmark (docs/formats.md)."""
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
        in_full: with a line for every graded property.
        color: with ANSI colors for the grades.
    """
    seen, size = item.observation, _size(item, "size not measured (use a ruler)")
    problems = f": {'; '.join(item.problems)}" if item.problems else ""
    lines = [f"{item.source}: code {seen.code}, {size}, grade {item.grade}{problems}"]
    for line in item.lines if in_full else ():
        grade = line.grade or "-"
        if line.grade is not None and color:
            grade = f"\x1b[{GRADE_COLORS[line.grade]}m{grade}\x1b[0m"
        lines.append(f"  {grade}  {line.name:<24} {line.value:<34} {line.advice}".rstrip())
    return lines


def annotated_prints(found: Sequence[PrintedLandmark]) -> Iterator[tuple[str, ByteArray]]:
    """Name and annotated image of each page, with each landmark's outline, code, size and grade.

    Names are those of the files, with ``#N`` for page N of a PDF.
    """
    for source in dict.fromkeys(item.source for item in found):
        some = [item for item in found if item.source == source]
        labels = [f"{item.observation.code}: {item.grade}, {_size(item, 'size not measured')}" for item in some]
        image = some[0].image
        drawn = draw_landmarks(
            image,
            [item.observation for item in some],
            2 if max(image.shape[:2]) < SMALL_PX else 1,
            labels,
            [OUTLINES[item.grade] for item in some],
        )
        yield source.replace(" page ", "#"), drawn


def _size(item: PrintedLandmark, unmeasured: str) -> str:
    """Measured size as text; ``unmeasured`` where a size is stated and none was measured."""
    if item.side_mm is None:
        return unmeasured if item.stated_mm is not None else "size unknown"
    return f"{item.side_mm[0]:.2f} x {item.side_mm[1]:.2f} mm"
