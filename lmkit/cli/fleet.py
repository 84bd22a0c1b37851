"""`lmkit fleet`: a group of commands for many recordings."""

from __future__ import annotations

import typer

from lmkit.cli import fleet_maps, fleet_recordings

HELP = "Map a site from the recordings of many robots."

app = typer.Typer(help=HELP)


@app.callback(invoke_without_command=True, help=HELP)
def _without_command(context: typer.Context) -> None:
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())
        raise typer.Exit(2)


app.command("scan")(fleet_recordings.scan)
app.command("detect")(fleet_recordings.detect)
app.command("survey")(fleet_maps.survey)
app.command("track")(fleet_maps.track)
app.command("report")(fleet_maps.report)
