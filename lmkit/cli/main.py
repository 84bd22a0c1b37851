"""The command line: commands, exit codes, and one line per error."""

from __future__ import annotations

import os
import sys
import traceback
from collections.abc import Callable
from typing import Any

# Small matrices many times over: threads of the linear algebra library cost more than they bring.
for _variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")
# What goes wrong is reported in lmkit's own words; OpenCV and its FFmpeg would print theirs on stderr as well.
os.environ.setdefault("OPENCV_LOG_LEVEL", "SILENT")
os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")

import typer

from lmkit.cli import (
    board,
    calibrate,
    convert,
    demo,
    detect,
    doctor,
    evaluate,
    generate,
    locate,
    plan,
    rectify,
    simulate,
    survey,
    track,
    unbag,
    verify,
)
from lmkit.errors import LmkitError
from lmkit.version import __version__

EXIT_FAULT = 70
EXIT_INTERRUPTED = 130

app = typer.Typer(
    name="lmkit",
    help="Printed landmarks for robots: from print to pose.",
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

for _command in (
    generate,
    board,
    verify,
    detect,
    calibrate,
    rectify,
    convert,
    locate,
    survey,
    track,
    unbag,
    evaluate,
    simulate,
    demo,
    doctor,
):
    app.command(name=_command.__name__.rpartition(".")[2])(_command.run)
app.add_typer(plan.app, name="plan")


def _show_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"lmkit {__version__}")
        raise typer.Exit


@app.callback(invoke_without_command=True)
def _options(
    context: typer.Context,
    version: bool = typer.Option(
        False, "--version", callback=_show_version, is_eager=True, help="Print the version and exit."
    ),
    debug: bool = typer.Option(False, "--debug", help="Print a traceback on errors."),
) -> None:
    """Printed landmarks for robots: from print to pose."""
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())
        raise typer.Exit(2)


def main() -> None:
    """Run the command line: every failure is one line on stderr and an exit code."""
    debug = "--debug" in sys.argv
    # `--debug` may stand anywhere.
    arguments = [a for a in sys.argv[1:] if a != "--debug"]
    sys.exit(guarded(lambda: app(arguments, prog_name="lmkit", standalone_mode=False), debug))


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
    groups = [
        f"{group.name} {command.name}"
        for group in app.registered_groups
        if group.typer_instance is not None
        for command in group.typer_instance.registered_commands
    ]
    return [*(command.name or "" for command in app.registered_commands), *groups]
