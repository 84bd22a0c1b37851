"""`lmkit verify`: read prints back, measure and grade them."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lmkit.cli.output import print_json, print_line
from lmkit.errors import InputError, NegativeAnswer

if TYPE_CHECKING:
    from lmkit.verification.prints import PrintedLandmark


def run(
    files: Annotated[list[Path], typer.Argument(help="PDF, PNG, scan or photograph.")],
    family: Annotated[
        str, typer.Option("--family", help="Families to look for where no label or manifest says.")
    ] = "lm8",
    size: Annotated[
        str | None, typer.Option("--size", help="What scans and photographs should measure, such as 180mm.")
    ] = None,
    manifest: Annotated[
        Path | None, typer.Option("--manifest", help="The print's own, FILE.pdf.json, for scans and photographs.")
    ] = None,
    least: Annotated[str, typer.Option("--least", help="Worst grade that still passes: A, B, C or D.")] = "D",
    annotate: Annotated[Path | None, typer.Option("--annotate", help="Folder for marked pictures.")] = None,
    certificate: Annotated[
        Path | None, typer.Option("--certificate", help="FILE.pdf with one page for each landmark.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object a line.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Overwrite files.")] = False,
) -> None:
    """Read landmarks back from prints, grade them A to F, and compare them with their labels."""
    from lmkit.detection.config import DetectOptions
    from lmkit.io.files import check_writable, write_file
    from lmkit.io.manifest import read_manifest
    from lmkit.model.landmark import families_named
    from lmkit.units import parse_length_mm
    from lmkit.verification.grade import GRADES
    from lmkit.verification.prints import Stated, stated_by_manifest, verify_print

    if least not in tuple("ABCD"):
        raise InputError("bad_grade", f"--least {least} is no grade", "choose A, B, C or D")
    if certificate is not None:
        check_writable(certificate, force)
    if size is not None and manifest is not None:
        raise InputError("size_twice", "--manifest says the size already", "give --size or --manifest")
    stated: tuple[Stated, ...] = ()
    if size is not None:
        stated = (Stated(None, None, parse_length_mm(size, "--size")),)
    if manifest is not None:
        stated = stated_by_manifest(read_manifest(manifest))
    options = DetectOptions(families_named(family))
    bad: list[str] = []
    prints: list[PrintedLandmark] = []
    for path in files:
        found = verify_print(path, options, stated)
        prints += found
        if not found:
            bad.append(str(path))
            if as_json:
                print_json({"source": str(path), "code": None, "problems": ["no landmark can be read"], "ok": False})
            else:
                print_line(f"{path}: no landmark can be read")
        for item in found:
            passes = GRADES.index(item.grade) <= GRADES.index(least)
            if not passes:
                bad.append(item.source)
            if as_json:
                print_json(_as_dict(item, passes))
            else:
                _print_grades(item, in_full=len(found) == 1 or not passes)
        if annotate is not None and found:
            _annotate(found, annotate, force)
    if certificate is not None and prints:
        from lmkit.reports.certificate import certificate as certificate_of

        write_file(certificate, certificate_of(prints), force)
    if bad:
        raise NegativeAnswer(
            "print_fails", f"{len(bad)} of the prints fail, first {bad[0]}", "print again at 100 %, in colour"
        )


def _as_dict(item: PrintedLandmark, passes: bool) -> dict[str, Any]:
    seen = item.observation
    lines = {
        line.name: {"value": line.value, "grade": line.grade, "advice": line.advice or None} for line in item.lines
    }
    return {
        "source": item.source,
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


def _print_grades(item: PrintedLandmark, in_full: bool) -> None:
    seen = item.observation
    size = "size unknown"
    if item.side_mm is not None:
        size = f"{item.side_mm[0]:.2f} x {item.side_mm[1]:.2f} mm"
    verdict = "; ".join(item.problems)
    more = f": {verdict}" if verdict else ""
    print_line(f"{item.source}: code {seen.code}, {size}, grade {item.grade}{more}")
    if not in_full:
        return
    colours = {"A": 32, "B": 32, "C": 33, "D": 33, "F": 31}
    for line in item.lines:
        grade = line.grade or "-"
        if line.grade is not None and sys.stdout.isatty() and not os.environ.get("NO_COLOR"):
            grade = f"\x1b[{colours[line.grade]}m{grade}\x1b[0m"
        print_line(f"  {grade}  {line.name:<24} {line.value:<34} {line.advice}".rstrip())


def _annotate(found: list[PrintedLandmark], folder: Path, force: bool) -> None:
    """One marked picture for every page."""
    from lmkit.io.files import write_file
    from lmkit.visualization.overlay import draw_landmarks, encode_jpeg

    for source in dict.fromkeys(item.source for item in found):
        some = [item for item in found if item.source == source]
        picture = draw_landmarks(some[0].image, [item.observation for item in some])
        name = Path(source.replace(" page ", "-")).name
        write_file(folder / f"{name}.jpg", encode_jpeg(picture), force)
