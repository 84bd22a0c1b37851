"""`lmkit plan`: a group of commands."""

from __future__ import annotations

import typer

from lmkit.cli import plan_coverage, plan_place, plan_route, plan_sheet

HELP = "Plan landmark positions, accuracy and routes."

app = typer.Typer(help=HELP)


@app.callback(invoke_without_command=True, help=HELP)
def _without_command(context: typer.Context) -> None:
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())
        raise typer.Exit(2)


app.command("coverage")(plan_coverage.run)
app.command("place")(plan_place.run)
app.command("route")(plan_route.run)
app.command("sheet")(plan_sheet.run)
