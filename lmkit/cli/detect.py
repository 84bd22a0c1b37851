"""`lmkit detect`: find and read landmarks in images and videos."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import Annotated

import typer

from lmkit.cli import options
from lmkit.cli.output import check_outputs, print_json, print_line, progress, warn, write_outputs
from lmkit.errors import InputError, NegativeAnswer
from lmkit.units import counted

COLORS_HINT = "landmarks are recognized by red against blue; use a color camera, or AprilTags (--family tag36h11)"
NOTHING_HINT = "check light, focus and distance: 15 px per side or more"
MARKERS_HINT = f"{NOTHING_HINT}; AprilTags and ArUco markers need --family, such as tag36h11"


def run(
    sources: Annotated[
        list[str], typer.Argument(help="Images, folders, globs, videos, camera:0, or - for standard input.")
    ],
    as_json: options.Json = False,
    csv: Annotated[Path | None, typer.Option("--csv", help="CSV file of detections to write.")] = None,
    annotate: Annotated[
        Path | None,
        typer.Option("--annotate", help="Folder for annotated images (.jpg) and videos; of one video also FILE.mp4."),
    ] = None,
    family: options.Family = "lm8",
    fast: Annotated[
        bool, typer.Option("--fast", help="Faster; misses small landmarks and landmarks in shadow.")
    ] = False,
    strict: Annotated[
        bool, typer.Option("--strict", help="Fewer wrong codes; rejects more small and blurred landmarks.")
    ] = False,
    eager: Annotated[
        bool, typer.Option("--eager", help="Read more small and blurred landmarks; more codes are wrong.")
    ] = False,
    inverted: Annotated[
        bool, typer.Option("--inverted", help="Also read AprilTags and ArUco markers in white on black.")
    ] = False,
    jobs: options.Jobs = None,
    force: options.Force = False,
) -> None:
    """Find and read landmarks in images and videos."""
    from lmkit.detection.acceptance import STRICTNESSES
    from lmkit.detection.config import BALANCED, FAST, DetectOptions
    from lmkit.io.image_sources import frame_count
    from lmkit.io.images import read_image
    from lmkit.model.families import families_named
    from lmkit.pipelines.detect_images import (
        DETECTION_COLUMNS,
        detect_in_sources,
        detected_dict,
        detected_line,
        detected_rows,
    )

    if strict and eager:
        raise InputError("contradicting_options", "--strict and --eager exclude each other", "give one of them")
    rule = STRICTNESSES["strict" if strict else "eager" if eager else "default"]
    choices = DetectOptions(families_named(family), FAST if fast else BALANCED, rule, inverted_tags=inverted)
    check_outputs((csv,), force)
    count = found = colorless = 0
    failed: list[InputError] = []
    rows = [DETECTION_COLUMNS]
    with ExitStack() as stack:
        drawn = None
        if annotate is not None:
            from lmkit.pipelines.annotated import AnnotatedFolder
            from lmkit.visualization.overlay import draw_landmarks

            drawn = stack.enter_context(AnnotatedFolder(annotate, force))
        answers = detect_in_sources(sources, choices, with_images=annotate is not None)
        for answer in progress(answers, frame_count(sources), "detecting landmarks"):
            count += 1
            found += len(answer.landmarks)
            blind = answer.colorless and not choices.square_families
            colorless += blind
            if blind and colorless == 1:
                warn(f"{answer.name} has no color; {COLORS_HINT}")
            if as_json:
                print_json(detected_dict(answer))
            elif answer.error is None:
                print_line(detected_line(answer))
            elif len(sources) > 1 or count > 1:
                warn(str(answer.error))
            if answer.error is not None:
                failed.append(answer.error)
                continue
            if csv is not None:
                rows += detected_rows(answer)
            if drawn is not None:
                image = read_image(Path(answer.name)) if answer.image is None else answer.image
                drawn.add(answer.name, draw_landmarks(image, answer.landmarks, enlarge=1), answer.time_s)
    if len(failed) < count:
        write_outputs({csv: "\n".join(rows) + "\n"}, force)
    if failed:
        more = f" (and {len(failed) - 1} more)" if len(failed) > 1 else ""
        raise InputError(failed[0].code, failed[0].message + more, failed[0].hint)
    if found == 0:
        hint = COLORS_HINT if colorless == count else NOTHING_HINT if choices.square_families else MARKERS_HINT
        raise NegativeAnswer("nothing_found", f"no landmark of {family} in {counted(count, 'image')}", hint)
