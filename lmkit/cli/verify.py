"""`lmkit verify`: read prints back, measure and grade them."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lmkit.cli import options
from lmkit.cli.output import check_outputs, print_json, print_line, progress, write_outputs
from lmkit.errors import InputError, NegativeAnswer
from lmkit.units import parse_length_mm

if TYPE_CHECKING:
    from lmkit.verification.prints import PrintedLandmark, VerifiedSheet


MOST_IN_FULL = 4  # largest number of landmarks of a file that are listed with every line


def run(
    files: Annotated[list[Path], typer.Argument(help="PDF files, PNG files, scans or photographs of prints.")],
    family: options.Family = "lm8",
    size: Annotated[
        str | None, typer.Option("--size", help="Intended landmark size of scans and photographs, such as 180mm.")
    ] = None,
    manifest: Annotated[
        Path | None,
        typer.Option("--manifest", help="Manifest of the print (FILE.pdf.json), for scans and photographs."),
    ] = None,
    least: Annotated[
        str, typer.Option("--least", metavar="GRADE", help="Lowest grade that passes: A, B, C or D.")
    ] = "D",
    annotate: Annotated[Path | None, typer.Option("--annotate", help="Folder for annotated images.")] = None,
    certificate: Annotated[
        Path | None, typer.Option("--certificate", help="PDF file to write, one page per landmark.")
    ] = None,
    as_json: options.Json = False,
    force: options.Force = False,
) -> None:
    """Read prints back and grade them from A to F. Codes and sizes are compared with labels and manifests."""
    from lmkit.detection.config import DetectOptions
    from lmkit.io.manifest import read_manifest
    from lmkit.model.families import families_named
    from lmkit.pipelines.annotated import AnnotatedFolder
    from lmkit.verification.grade import GRADES
    from lmkit.verification.prints import Stated, stated_by_manifest, verify_sheets
    from lmkit.verification.results import annotated_prints, print_dict, print_lines

    if least not in tuple("ABCD"):
        raise InputError("bad_grade", f"--least {least} is not a grade", "choose A, B, C or D")
    if size is not None and manifest is not None:
        raise InputError("size_twice", "--size and --manifest both state the size", "give one of them")
    check_outputs((certificate,), force)
    folder = None if annotate is None else AnnotatedFolder(annotate, force, videos=False)
    stated: tuple[Stated, ...] = ()
    if size is not None:
        stated = (Stated(None, None, parse_length_mm(size, "--size")),)
    if manifest is not None:
        stated = stated_by_manifest(read_manifest(manifest))
    choices = DetectOptions(families_named(family))
    color = sys.stdout.isatty() and not os.environ.get("NO_COLOR")
    bad: list[str] = []
    prints: list[PrintedLandmark] = []
    for path, sheets in progress(
        ((path, verify_sheets(path, choices, stated)) for path in files), len(files), "reading"
    ):
        found = [item for sheet in sheets for item in sheet.found]
        prints += found
        bad += _print_unread(path, sheets, as_json)
        for item in found:
            passes = GRADES.index(item.grade) <= GRADES.index(least)
            if not passes:
                bad.append(item.source)
            if as_json:
                print_json(print_dict(item, passes))
                continue
            for line in print_lines(item, in_full=len(found) <= MOST_IN_FULL or not passes, color=color):
                print_line(line)
        if len(sheets) == 1 and len(found) > 1 and not as_json:
            worst = max(item.grade for item in found)
            hint = "if one is missing here, take an image of it alone, from nearer"
            print_line(f"{path}: {len(found)} landmarks graded, worst grade {worst}; {hint}")
        if folder is not None:
            for name, image in annotated_prints(found):
                folder.add(name, image)
    if certificate is not None and prints:
        from datetime import date

        from lmkit.reports.certificate import certificate as certificate_of

        write_outputs({certificate: certificate_of(prints, date.today())}, force)
    if bad:
        hint = "print again at 100 %" + (", in color" if choices.ring_families else "")
        if not prints and manifest is None:
            hint = f"{hint}; --family names another family than {family}"
        fail = "1 print fails" if len(bad) == 1 else f"{len(bad)} prints fail, the first"
        raise NegativeAnswer("print_fails", f"{fail}: {bad[0]}", hint)


def _print_unread(path: Path, sheets: Sequence[VerifiedSheet], as_json: bool) -> list[str]:
    """Print the landmarks that should be on the sheets of a file but cannot be read; returns the sheets' names."""
    unread: list[tuple[str, int | None]] = [(sheet.source, code) for sheet in sheets for code in sheet.missing]
    if not unread and not any(sheet.found for sheet in sheets):
        unread = [(str(path), None)]
    for source, code in unread:
        problem = "no landmark can be read" if code is None else f"code {code} cannot be read"
        if as_json:
            print_json({"source": source, "code": code, "problems": [problem], "ok": False})
        else:
            print_line(f"{source}: {problem}")
    return [source for source, _ in unread]
