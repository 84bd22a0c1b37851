"""`lmkit run`: from cameras to a pose on the robot's bus."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lmkit.cli import map_options, options
from lmkit.cli.output import print_line
from lmkit.errors import InputError, NegativeAnswer

if TYPE_CHECKING:
    from lmkit.live.live_run import RunSummary
    from lmkit.live.run_settings import RunSettings

Sources = Annotated[
    list[str],
    typer.Argument(
        help="One source per camera: camera:0, split:camera:0, pipe:COMMAND, rtsp://..., a video, a folder, "
        "replay:FILE.mcap, or sim: (a simulated robot); or a run file (lmkit-run/1)."
    ),
]


def run(
    sources: Sources,
    rig: options.OptionalRigFile = None,
    landmark_map: options.OptionalMapFile = None,
    marker_family: map_options.MarkerFamily = None,
    marker_size: map_options.MarkerSize = None,
    odometry: Annotated[
        str | None,
        typer.Option(
            "--odometry", help="Odometry: ros2:TOPIC, mavlink:CONNECTION or ws:PORT. For recorded images, a file."
        ),
    ] = None,
    odometry_kind: Annotated[
        str | None, typer.Option("--odometry-kind", help="Kind of odometry: wheels (on a floor) or poses (in space).")
    ] = None,
    gyro: Annotated[
        str | None,
        typer.Option("--gyro", help="Gyro: ros2:TOPIC, mavlink:CONNECTION or ws:PORT. For recorded images, a file."),
    ] = None,
    to: Annotated[
        list[str] | None,
        typer.Option(
            "--to",
            metavar="OUTPUT",
            help="Output: stdout, ws[:PORT], mavlink:CONNECTION, nt:HOST or ros2; repeatable.",
        ),
    ] = None,
    rate: Annotated[float | None, typer.Option("--rate", help="Largest number of poses per second.")] = None,
    hz: options.Hz = None,
    profile: Annotated[
        str | None, typer.Option("--profile", help="Detector profile: fast, balanced or accurate.")
    ] = None,
    budget: Annotated[
        str | None,
        typer.Option(
            "--budget",
            help="Largest latency, such as 50ms. Above it, detection becomes faster, then images are skipped.",
        ),
    ] = None,
    coast: Annotated[
        str | None, typer.Option("--coast", help="Longest time to publish poses from odometry alone, such as 1s.")
    ] = None,
    confirm: Annotated[
        int | None,
        typer.Option("--confirm", help="Number of different landmarks that must confirm a pose after each start."),
    ] = None,
    health: Annotated[str | None, typer.Option("--health", help="Serve a health page at HOST:PORT.")] = None,
    record: Annotated[
        Path | None,
        typer.Option("--record", help="MCAP file of the whole run to write, for replay:FILE.mcap and viewers."),
    ] = None,
    as_json: options.Json = False,
    seconds: Annotated[float | None, typer.Option("--seconds", help="Stop after this many seconds.")] = None,
    check: Annotated[bool, typer.Option("--check", help="Check the settings and exit.")] = False,
) -> None:
    """Publish the pose of a robot while it drives. Reads cameras, gives poses with covariance; ends with Ctrl-C."""
    from lmkit.live.open_run import check_files, open_run
    from lmkit.live.source_address import parse_seconds

    if seconds is not None and not 0 < seconds < 1e9:
        raise InputError("bad_option", f"--seconds {seconds:g} is out of range", "give seconds above 0")
    given = {
        "rig": rig,
        "map": landmark_map,
        "family": marker_family,
        "size": marker_size,
        "odometry": odometry,
        "odometry_kind": odometry_kind,
        "gyro": gyro,
        "to": [*(to or []), *(["stdout"] if as_json else [])] or None,
        "rate": rate,
        "hz": hz,
        "profile": profile,
        "budget_ms": None if budget is None else 1000 * parse_seconds(budget, "--budget"),
        "coast_s": None if coast is None else parse_seconds(coast, "--coast"),
        "confirm": confirm,
        "health": health,
        "record": record,
    }
    settings = _settings(sources, {name: value for name, value in given.items() if value is not None})
    if check:
        check_files(settings)
        print_line("the settings are valid")
        return
    live = open_run(settings)
    from lmkit.live.service import run_until_stopped

    summary = run_until_stopped(live, settings, seconds)
    if not as_json and "stdout" not in settings.values.to:
        _print(summary)
    if not summary.statuses.get("ok"):
        raise NegativeAnswer("not_located", "no pose was published", _why(summary))


def _settings(sources: list[str], given: dict[str, Any]) -> RunSettings:
    from lmkit.live.run_settings import RunSettings, read_run_file, settings_of

    if Path(sources[0]).suffix.lower() not in (".yaml", ".yml", ".json"):
        return settings_of({"sources": sources, **given}, Path())
    if len(sources) > 1:
        raise InputError("not_together", "a run file and sources cannot be combined", "leave one of them out")
    filed = read_run_file(Path(sources[0]))
    # Paths in options are relative to the working folder, paths in the file to the file's folder.
    here = {k: str(Path(str(v)).resolve()) if k in ("rig", "map", "record") else v for k, v in given.items()}
    return RunSettings(settings_of({**filed.values.model_dump(), **here}, filed.folder).values, filed.folder)


def _print(summary: RunSummary) -> None:
    counts = ", ".join(f"{count} {status}" for status, count in summary.statuses.most_common())
    print_line(f"{summary.steps} steps in {summary.seconds:.1f} s: {counts or 'no images'}")
    events = {code: count for code, count in summary.events.items() if not code.startswith("status_")}
    if events:
        print_line("events: " + ", ".join(f"{count} {code}" for code, count in sorted(events.items())))


def _why(summary: RunSummary) -> str:
    if not summary.steps:
        return "no image came: check the sources with lmkit doctor --cameras"
    return "check that landmarks of the map are in view: lmkit detect IMAGE, lmkit locate"
