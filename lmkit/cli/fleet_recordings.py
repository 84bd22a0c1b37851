"""`lmkit fleet scan` and `lmkit fleet detect`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

from lmkit.cli import options
from lmkit.cli.output import print_json, print_line, progress
from lmkit.errors import InputError
from lmkit.units import parse_length_mm

if TYPE_CHECKING:
    from lmkit.fleet.jobs import StageRun

StoreUri = Annotated[
    str, typer.Option("--store", help="Folder or URI (s3://, gs://) for the results of all fleet commands.")
]
Engine = Annotated[str, typer.Option("--engine", help="Where jobs run: local, or dask:tcp://HOST:8786.")]
Shard = Annotated[
    str | None,
    typer.Option("--shard", help="Share of the jobs, for batch systems: K/N runs every N-th job from the K-th on."),
]
Retry = Annotated[bool, typer.Option("--retry", help="Run failed jobs again.")]
Family = Annotated[str, typer.Option("--family", help="Landmark families to detect, such as lm8,tag36h11.")]
Hz = Annotated[float | None, typer.Option("--hz", help="Frames per second, if file names contain no times.")]


def scan(
    pattern: Annotated[
        str, typer.Argument(help="Path pattern of the recordings, in quotes, such as 'logs/{site}/{robot}/*.mcap'.")
    ],
    store: StoreUri,
    rig: Annotated[
        str, typer.Option("--rig", help="Path pattern of the rig files, in quotes, such as 'rigs/{robot}.yaml'.")
    ] = "",
    wheel_track: options.WheelTrack = None,
    topic: Annotated[
        list[str] | None,
        typer.Option("--topic", help="Topic of the bags by role, such as left=/cam0/image_raw; may be repeated."),
    ] = None,
    as_json: options.Json = False,
) -> None:
    """List the recordings of a fleet in its store."""
    from lmkit.fleet.recordings import add_recordings, find_recordings
    from lmkit.fleet.store import Store, require_arrow

    require_arrow()
    track_m = 0.0 if wheel_track is None else parse_length_mm(wheel_track, "--wheel-track") / 1000
    found = find_recordings(pattern, rig, track_m, " ".join(topic or []))
    changed, total = add_recordings(Store(store), found)
    if as_json:
        print_json({"found": len(found), "changed": changed, "recordings": total})
        return
    print_line(f"{len(found)} recordings found, {changed} new or changed; {total} in {store}")


def detect(
    store: StoreUri,
    engine: Engine = "local",
    shard: Shard = None,
    family: Family = "lm8",
    hz: Hz = None,
    max_bytes: Annotated[
        int | None, typer.Option("--max-bytes", help="Largest size of a recording, bytes; larger ones are refused.")
    ] = None,
    retry: Retry = False,
    jobs: options.Jobs = None,
    as_json: options.Json = False,
) -> None:
    """Detect landmarks in every recording that is not yet done."""
    from lmkit.fleet.detection import STAGE, detect_recording
    from lmkit.fleet.jobs import run_stage
    from lmkit.fleet.store import Store

    chosen = detect_options(family, hz, max_bytes)
    show_outcomes(
        run_stage(Store(store), STAGE, detect_recording, chosen, engine, shard, retry), "detecting", as_json
    )


def detect_options(family: str, hz: float | None, max_bytes: int | None = None) -> dict[str, Any]:
    """All options that affect detections.

    Raises:
        InputError: an unknown family.
    """
    from lmkit.model.families import family_named

    chosen: dict[str, Any] = {"families": [family_named(name.strip()).name for name in family.split(",")], "hz": hz}
    return chosen if max_bytes is None else {**chosen, "max_bytes": max_bytes}


def parse_day(text: str, option: str) -> str:
    """A day such as 2026-11-27, or none.

    Raises:
        InputError: not such a text.
    """
    from datetime import date

    try:
        return date.fromisoformat(text).isoformat() if text else ""
    except ValueError:
        raise InputError("bad_day", f"{option} '{text}' is not a day", "write it as 2026-11-27") from None


def show_outcomes(run: StageRun, step: str, as_json: bool) -> None:
    """One line per failure and a summary, or one JSON object per job."""
    done = failed = 0
    for outcome in progress(run, None, step):
        done, failed = done + outcome.ok, failed + (not outcome.ok)
        if as_json:
            summary = {"recording": outcome.recording, "failure": outcome.failure or None, "seconds": outcome.seconds}
            print_json({**summary, **outcome.facts})
        elif not outcome.ok:
            print_line(f"{outcome.recording}: {outcome.failure}")
    if not as_json:
        before = f"; {run.failed_before} failed before: --retry runs them again" if run.failed_before else ""
        print_line(f"{done} done, {failed} failed{before}")
