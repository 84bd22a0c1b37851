"""`lmkit fleet survey`, `lmkit fleet track` and `lmkit fleet report`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from lmkit.cli import options
from lmkit.cli.fleet_recordings import (
    Engine,
    Family,
    Hz,
    Retry,
    Shard,
    StoreUri,
    detect_options,
    parse_day,
    show_outcomes,
)
from lmkit.cli.map_options import read_mounted_map
from lmkit.cli.output import check_outputs, print_json, print_line, progress, write_outputs
from lmkit.errors import InputError
from lmkit.units import parse_length_mm


def survey(
    store: StoreUri,
    output: Annotated[
        Path,
        typer.Option("-o", "--output", help="Map file to write. With several sites, one file map-SITE.yaml each."),
    ],
    size: Annotated[
        str, typer.Option("--size", help="Landmark size, outer edge to outer edge of the border, such as 180mm.")
    ] = "180mm",
    known: Annotated[
        Path | None, typer.Option("--known", help="Map of landmarks with known poses; it defines the frame.")
    ] = None,
    since: Annotated[
        str, typer.Option("--since", help="First day of the recordings to survey, such as 2026-11-27; with --known.")
    ] = "",
    engine: Engine = "local",
    family: Family = "lm8",
    hz: Hz = None,
    jobs: options.Jobs = None,
    as_json: options.Json = False,
    force: options.Force = False,
) -> None:
    """Check every rig by the landmarks, and build the map of every site from all of its recordings."""
    from lmkit.fleet.detection import detected_recordings
    from lmkit.fleet.jobs import run_stage
    from lmkit.fleet.mapping import extended_surveys, parts_by_site, share_joined, survey_site, write_site
    from lmkit.fleet.rig_checks import STAGE as CHECK
    from lmkit.fleet.rig_checks import bumped_recordings, check_options, check_recording, store_check_options
    from lmkit.fleet.store import Store

    place, size_m = Store(store), parse_length_mm(size, "--size") / 1000
    anchors = None if known is None else read_mounted_map(known)
    detect = detect_options(family, hz)
    sites = parts_by_site(place, detect, parse_day(since, "--since"))
    if not sites:
        from_then = f" from {since} on" if since else ""
        raise InputError(
            "nothing_detected",
            f"no recording{from_then} was detected with these options",
            "run lmkit fleet detect with them",
        )
    extended = {} if known is None else extended_surveys(place, sites, known.read_bytes())
    outputs = {
        site: output if len(sites) == 1 else output.with_stem(f"{output.stem}-{site or 'site'}") for site in sites
    }
    check_outputs(tuple(outputs.values()), force)
    check = check_options(detect, size_m, {m.id: m.size_m for m in anchors or ()})
    ready = detected_recordings(place, detect)
    for _ in progress(
        run_stage(place, CHECK, check_recording, check, engine, recordings=ready), None, "checking rigs"
    ):
        pass
    store_check_options(place, check)
    bumped = bumped_recordings(place, check)
    for site, parts in sites.items():
        surveyed = survey_site(place, site, parts, size_m, anchors, bumped, engine)
        surveyed = surveyed.extending(extended[site]) if site in extended else surveyed
        write_outputs({outputs[site]: write_site(place, surveyed)}, force)
        summary = surveyed.facts
        if as_json:
            print_json({"map": str(outputs[site]), **summary})
            continue
        for text in (
            *(moved["sentence"] for moved in summary["moved"]),
            *(f"{name}: {why}" for name, why in summary["left_out"].items()),
            *summary["warnings"],
        ):
            print_line(text)
        print_line(f"{len(summary['landmarks'])} landmarks from {share_joined(summary)} -> {outputs[site]}")


def track(
    store: StoreUri,
    engine: Engine = "local",
    shard: Shard = None,
    family: Family = "lm8",
    hz: Hz = None,
    retry: Retry = False,
    jobs: options.Jobs = None,
    as_json: options.Json = False,
) -> None:
    """Track every recording through the map of its site."""
    from lmkit.fleet.detection import detected_recordings
    from lmkit.fleet.jobs import run_stage
    from lmkit.fleet.store import Store
    from lmkit.fleet.tracking import STAGE, track_recording

    place = Store(store)
    chosen = _track_options(place, family, hz)
    detected = detected_recordings(place, chosen["detect"])
    outcomes = run_stage(place, STAGE, track_recording, chosen, engine, shard, retry, detected)
    show_outcomes(outcomes, "tracking", as_json)


def report(
    store: StoreUri,
    output: Annotated[Path, typer.Option("-o", "--output", help="HTML file to write.")],
    family: Family = "lm8",
    hz: Hz = None,
    as_json: options.Json = False,
    force: options.Force = False,
) -> None:
    """Write one HTML page about recordings, robots, landmarks and faults."""
    from lmkit.fleet.mapping import stored_sites
    from lmkit.fleet.report import fleet_report, fleet_state
    from lmkit.fleet.store import Store

    check_outputs((output,), force)
    place = Store(store)
    tracked = _track_options(place, family, hz) if stored_sites(place) else None
    state = fleet_state(place, detect_options(family, hz), tracked)
    write_outputs({output: fleet_report(place, state)}, force)
    if as_json:
        print_json({"report": str(output), "faults": [fault.to_dict() for fault in state.faults()]})
        return
    for fault in state.faults():
        print_line(str(fault))
    print_line(str(output))


def _track_options(store: Any, family: str, hz: float | None) -> dict[str, Any]:
    from lmkit.fleet.mapping import stored_map, stored_sites

    sites = stored_sites(store)
    if not sites:
        raise InputError("no_map", "the store contains no map", "run lmkit fleet survey first")
    return {"maps": {site: stored_map(store, site) for site in sites}, "detect": detect_options(family, hz)}
