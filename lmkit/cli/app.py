"""The commands, imported when they run."""

from __future__ import annotations

import importlib
from collections.abc import Sequence

import typer

from lmkit.version import __version__

HELP = "Printed landmarks for robots: from print to pose."

# Each is a module of this folder with a function `run`, or a typer app for a group of commands.
COMMANDS = (
    "generate",
    "board",
    "verify",
    "detect",
    "calibrate",
    "rectify",
    "convert",
    "map",
    "locate",
    "survey",
    "track",
    "plan",
    "evaluate",
    "unbag",
    "simulate",
    "demo",
    "doctor",
)


def build_app(names: Sequence[str] = COMMANDS, listing: bool = False) -> typer.Typer:
    """The command line with some of its commands, whose modules are imported.

    Args:
        listing: only names and descriptions, for the list of commands; options take time to build.
    """
    app = typer.Typer(
        name="lmkit",
        help=HELP,
        add_completion=False,
        rich_markup_mode=None,
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["-h", "--help"]},
    )
    app.callback(invoke_without_command=True)(_options)
    for name in names:
        module = importlib.import_module(f"lmkit.cli.{name}")
        group = getattr(module, "app", None)
        if listing:
            app.command(name, help=module.HELP if group else module.run.__doc__)(_listed)
        elif group:
            app.add_typer(group, name=name)
        else:
            app.command(name)(module.run)
    return app


def _listed() -> None:
    """Stands for a command in the list of commands."""


def _show_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"lmkit {__version__}")
        raise typer.Exit


def _options(
    context: typer.Context,
    version: bool = typer.Option(
        False, "--version", callback=_show_version, is_eager=True, help="Print the version and exit."
    ),
    debug: bool = typer.Option(False, "--debug", help="Print a traceback on errors."),
) -> None:
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())
        raise typer.Exit(2)


def public_commands() -> list[str]:
    """Names of all commands, for the tests of the docs."""
    names = []
    for name in COMMANDS:
        group = getattr(importlib.import_module(f"lmkit.cli.{name}"), "app", None)
        names += [name] if group is None else [f"{name} {command.name}" for command in group.registered_commands]
    return names
