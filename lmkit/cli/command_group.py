"""A group of commands, such as `lmkit plan`: alone it prints its help."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import typer

from lmkit.cli.checked_options import CheckedOptions
from lmkit.cli.option_groups import with_groups


def command_group(summary: str, commands: Mapping[str, Callable[..., None]]) -> typer.Typer:
    """A typer app with these commands.

    Args:
        summary: one sentence for the list of commands.
        commands: function of each command, by name.
    """
    group = typer.Typer(help=summary)
    group.callback(invoke_without_command=True, help=summary)(_print_help)
    for name, function in commands.items():
        group.command(name, cls=CheckedOptions)(with_groups(function))
    return group


def _print_help(context: typer.Context) -> None:
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())
        raise typer.Exit(2)
