"""`lmkit detect`: find and read landmarks in pictures."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lmkit.cli.common import print_json, print_line, progress, warn
from lmkit.errors import InputError, NegativeAnswer

if TYPE_CHECKING:
    from lmkit.model.observation import LandmarkObservation


def run(
    sources: Annotated[list[str], typer.Argument(help="Pictures, folders, globs, videos, or - for standard input.")],
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object a line.")] = False,
    annotate: Annotated[Path | None, typer.Option("--annotate", help="Folder for pictures with overlays.")] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite files.")] = False,
) -> None:
    """Find and read landmarks."""
    from lmkit.detect.landmarks import detect_landmarks
    from lmkit.formats.sources import frames

    count = found = 0
    failed: list[InputError] = []
    for frame in progress(frames(sources), None, "detecting"):
        count += 1
        if frame.image is None:
            assert frame.error is not None
            failed.append(frame.error)
            if as_json:
                print_json({"image": frame.name, "error": frame.error.as_dict()})
            elif len(sources) > 1 or count > 1:
                warn(str(frame.error))
            continue
        detections = detect_landmarks(frame.image)
        found += len(detections)
        height, width = frame.image.shape[:2]
        if as_json:
            entries = [observation_dict(d) for d in detections]
            print_json({"image": frame.name, "width": width, "height": height, "detections": entries})
        else:
            codes = ", ".join(f"{d.code} ({d.confidence:.2f})" for d in detections) or "none"
            print_line(f"{frame.name}: {codes}")
        if annotate is not None:
            from lmkit.formats.files import write_file
            from lmkit.overlay import draw_landmarks, encode_jpeg

            target = annotate / f"{Path(frame.name).name.replace('#', '-')}.jpg"
            write_file(target, encode_jpeg(draw_landmarks(frame.image, detections)), force)
    if failed:
        first = failed[0]
        more = f" (and {len(failed) - 1} more)" if len(failed) > 1 else ""
        raise InputError(first.code, first.message + more, first.hint)
    if found == 0:
        raise NegativeAnswer(
            "nothing_found",
            f"no landmark in {count} pictures",
            "check light, focus and distance: 15 px a side and more",
        )


def observation_dict(observation: LandmarkObservation) -> dict[str, Any]:
    """One detection as docs/formats.md has it."""
    return {
        "code": observation.code,
        "family": observation.family,
        "corners": observation.corners.tolist(),
        "center": observation.center.tolist(),
        "confidence": observation.confidence,
        "margin": observation.margin,
    }
