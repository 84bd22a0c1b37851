"""`lmkit verify`: read prints back and measure them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from lmkit.cli.common import print_json, print_line
from lmkit.errors import NegativeAnswer


def run(
    files: Annotated[list[Path], typer.Argument(help="PDF, PNG, scan or photograph.")],
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object a line.")] = False,
) -> None:
    """Read landmarks back from prints, measure them, and compare them with their labels."""
    from lmkit.verify.prints import verify_print

    bad: list[str] = []
    for path in files:
        found = verify_print(path)
        if not found:
            bad.append(str(path))
            if not as_json:
                print_line(f"{path}: no landmark can be read")
        for item in found:
            seen = item.observation
            if item.problems:
                bad.append(item.source)
            if as_json:
                print_json(
                    {
                        "source": item.source,
                        "code": seen.code,
                        "family": seen.family,
                        "corners": seen.corners.tolist(),
                        "confidence": seen.confidence,
                        "margin": seen.margin,
                        "side_mm": None if item.side_mm is None else list(item.side_mm),
                        "stated_code": item.stated_code,
                        "stated_mm": item.stated_mm,
                        "problems": list(item.problems),
                        "ok": not item.problems,
                    }
                )
                continue
            measured = "size unknown (no resolution in the file)"
            if item.side_mm is not None:
                measured = f"{item.side_mm[0]:.2f} x {item.side_mm[1]:.2f} mm"
            verdict = "; ".join(item.problems) or "ok"
            print_line(f"{item.source}: code {seen.code}, {measured}, confidence {seen.confidence:.3f}: {verdict}")
        if not found and as_json:
            print_json({"source": str(path), "code": None, "problems": ["no landmark can be read"], "ok": False})
    if bad:
        raise NegativeAnswer(
            "print_fails", f"{len(bad)} of the prints fail, first {bad[0]}", "print again at 100 %, in colour"
        )
