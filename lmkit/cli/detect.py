"""`lmkit detect`: find and read landmarks in pictures."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lmkit.cli.output import print_json, print_line, progress, warn
from lmkit.errors import InputError, NegativeAnswer

if TYPE_CHECKING:
    from lmkit.pipelines.detect_images import Detected


def run(
    sources: Annotated[
        list[str], typer.Argument(help="Pictures, folders, globs, videos, camera:0, or - for standard input.")
    ],
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object a line.")] = False,
    annotate: Annotated[
        Path | None, typer.Option("--annotate", help="Folder for the pictures with overlays.")
    ] = None,
    family: Annotated[str, typer.Option("--family", help="Families to look for, as in lm8,lm4.")] = "lm8",
    fast: Annotated[bool, typer.Option("--fast", help="Give up small and shaded landmarks for speed.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Overwrite files.")] = False,
) -> None:
    """Find and read landmarks."""
    from lmkit.detection.config import BALANCED, FAST, DetectOptions
    from lmkit.model.landmark import families_named
    from lmkit.pipelines.detect_images import detect_in_sources

    options = DetectOptions(families_named(family), FAST if fast else BALANCED)
    count = found = colourless = 0
    failed: list[InputError] = []
    for answer in progress(detect_in_sources(sources, options), None, "detecting"):
        count += 1
        if answer.size is None:
            assert answer.error is not None
            failed.append(answer.error)
            if as_json:
                print_json({"image": answer.name, "error": answer.error.as_dict()})
            elif len(sources) > 1 or count > 1:
                warn(str(answer.error))
            continue
        found += len(answer.landmarks)
        if answer.colourless:
            colourless += 1
            if colourless == 1:
                warn(
                    f"{answer.name} has no colour: landmarks are recognised by red against blue; use a colour camera"
                )
        width, height = answer.size
        if as_json:
            entries = [d.to_dict() for d in answer.landmarks]
            print_json({"image": answer.name, "width": width, "height": height, "detections": entries})
        else:
            codes = ", ".join(f"{d.code} ({d.confidence:.2f})" for d in answer.landmarks) or "none"
            print_line(f"{answer.name}: {codes}")
        if annotate is not None:
            _annotate(answer, annotate, force)
    if failed:
        first = failed[0]
        more = f" (and {len(failed) - 1} more)" if len(failed) > 1 else ""
        raise InputError(first.code, first.message + more, first.hint)
    if found == 0:
        raise NegativeAnswer(
            "nothing_found",
            f"no landmark in {count} pictures",
            "the pictures have no colour, and landmarks are recognised by red against blue"
            if colourless == count
            else "check light, focus and distance: 15 px a side and more",
        )


def _annotate(answer: Detected, folder: Path, force: bool) -> None:
    """The picture with its landmarks drawn in; frames of videos and standard input are left out."""
    from lmkit.io.files import write_file
    from lmkit.io.images import read_image
    from lmkit.visualization.overlay import draw_landmarks, encode_jpeg

    path = Path(answer.name)
    if path.is_file():
        picture = draw_landmarks(read_image(path), answer.landmarks)
        write_file(folder / f"{path.name}.jpg", encode_jpeg(picture), force)
