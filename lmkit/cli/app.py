"""The commands, imported when they run."""

from __future__ import annotations

import importlib
from collections.abc import Iterable

import typer

from lmkit.version import __version__

HELP = "Printed landmarks for robots: from print to pose."

# Each is a module of this folder with a function `run`, or a typer app for a group of commands.  The summaries stand
# here as well as in the modules, so that the list of commands imports none of them; a test compares both.
COMMANDS = {
    "generate": "Write printable landmarks, true to scale.",
    "board": "Write a calibration board, true to scale.",
    "verify": "Read prints back and grade them from A to F.",
    "detect": "Find and read landmarks in images and videos.",
    "calibrate": "Calibrate cameras from images of a board.",
    "rectify": "Rectify stereo pairs.",
    "convert": "Convert rigs, maps and trajectories.",
    "map": "Make a map from tape measurements; check and draw it.",
    "locate": "Locate the camera, or the robot, in the map.",
    "survey": "Build the landmark map from a recording.",
    "track": "Track the robot through a known map.",
    "run": "Publish the pose of a robot while it drives.",
    "plan": "Plan landmark positions, accuracy and routes.",
    "evaluate": "Compute the errors of a trajectory, as evo does.",
    "unbag": "Extract stereo images, rig, odometry and gyro from a ROS bag.",
    "web": "Serve a page in the browser.",
    "fleet": "Map a site from the recordings of many robots.",
    "simulate": "Simulate a room and a stereo camera.",
    "demo": "Run all steps in a simulated room.",
    "doctor": "Check the installation.",
}


def build_app(names: Iterable[str] = COMMANDS, listing: bool = False) -> typer.Typer:
    """The command line with some of its commands.

    Args:
        listing: only names and summaries, for the list of commands; modules take time to import.
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
        if listing:
            app.command(name, help=COMMANDS[name])(_listed)
            continue
        module = importlib.import_module(f"lmkit.cli.{name}")
        group = getattr(module, "app", None)
        if group:
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
