"""The command line: commands, exit codes, and one line per error."""

from __future__ import annotations

import importlib
import os
import sys
import traceback
from collections.abc import Callable, Sequence
from typing import Any

# Small matrices many times over: threads of the linear algebra library cost more than they bring.
for _variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")
# What goes wrong is reported in lmkit's own words; OpenCV and its FFmpeg would print theirs on stderr as well.
os.environ.setdefault("OPENCV_LOG_LEVEL", "SILENT")
os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")

import typer

from lmkit.errors import LmkitError
from lmkit.version import __version__

EXIT_FAULT = 70
EXIT_INTERRUPTED = 130
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


def __getattr__(name: str) -> typer.Typer:
    """``app``, the whole command line, built when it is asked for."""
    if name != "app":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()["app"] = app = build_app()
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


def main() -> None:
    """Run the command line: every failure is one line on stderr and an exit code."""
    debug = "--debug" in sys.argv
    # `--debug` may stand anywhere.
    arguments = [a for a in sys.argv[1:] if a != "--debug"]
    command = next((a for a in arguments if not a.startswith("-")), None)
    names = (command,) if command in COMMANDS else COMMANDS
    sys.exit(
        guarded(lambda: build_app(names, command is None)(arguments, prog_name="lmkit", standalone_mode=False), debug)
    )


def guarded(run: Callable[[], Any], debug: bool) -> int:
    """The exit code of ``run``; a failure is reported in one line on stderr."""
    try:
        result = run()
        sys.stdout.flush()
        # Without its own exit, typer hands back the code of typer.Exit.
        return result if isinstance(result, int) else 0
    except LmkitError as error:
        return _report(error.message, error.hint, error.exit_code, debug)
    except (KeyboardInterrupt, typer.Abort):
        return _report("interrupted", "", EXIT_INTERRUPTED, False)
    except BrokenPipeError:
        # The reader of our output has closed it, as `head` does.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except typer.Exit as stop:
        return stop.exit_code
    except Exception as error:
        usage = getattr(error, "format_message", None)
        if usage is not None:
            return _report(usage().rstrip("."), "see lmkit --help", int(getattr(error, "exit_code", 2)), debug)
        return _report(
            f"internal error (please report): {type(error).__name__}: {error}", _FAULT_HINT, EXIT_FAULT, debug
        )


_FAULT_HINT = "run again with --debug for the traceback"


def _report(message: str, hint: str, code: int, debug: bool) -> int:
    if debug:
        traceback.print_exc()
    line = " ".join(f"{message}; {hint}".split()) if hint else message
    sys.stderr.write(f"lmkit: {line}\n")
    return code


def public_commands() -> list[str]:
    """Names of all commands, for the tests of the docs."""
    names = []
    for name in COMMANDS:
        group = getattr(importlib.import_module(f"lmkit.cli.{name}"), "app", None)
        names += [name] if group is None else [f"{name} {command.name}" for command in group.registered_commands]
    return names
