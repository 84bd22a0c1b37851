"""The commands, imported when they run."""

from __future__ import annotations

import importlib
from collections.abc import Iterable

import typer

from lmkit.cli.checked_options import CheckedOptions
from lmkit.cli.commands import COMMANDS, DEBUG_HELP, HELP, VERSION_HELP
from lmkit.cli.option_groups import with_groups
from lmkit.cli.plain_values import PlainGroup
from lmkit.version import __version__


def build_app(names: Iterable[str] = COMMANDS) -> typer.Typer:
    """The command line with some of its commands; each name imports its module."""
    app = typer.Typer(
        name="lmkit",
        cls=PlainGroup,
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
        if group:
            app.add_typer(group, name=name)
        else:
            app.command(name, cls=CheckedOptions)(with_groups(module.run))
    return app


def _show_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"lmkit {__version__}")
        raise typer.Exit


def _options(
    context: typer.Context,
    version: bool = typer.Option(False, "--version", callback=_show_version, is_eager=True, help=VERSION_HELP),
    debug: bool = typer.Option(False, "--debug", help=DEBUG_HELP),
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
