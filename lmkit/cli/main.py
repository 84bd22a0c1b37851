"""The command line: exit codes, and one line per error."""

from __future__ import annotations

import contextlib
import gc
import io
import os
import signal
import sys
import warnings
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

# For many small matrices, threads of the linear algebra library cost more time than they save.
for _variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")
# Errors are reported in lmkit's own messages; OpenCV and FFmpeg would also print theirs on stderr.
os.environ.setdefault("OPENCV_LOG_LEVEL", "SILENT")
os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
# Pydantic searches all installed packages for plugins; lmkit needs none.
os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")

from lmkit.cli.commands import COMMANDS, list_of_commands
from lmkit.errors import InputWarning, LmkitError, problem_and_remedy, system_problem
from lmkit.version import __version__

if TYPE_CHECKING:
    import typer

EXIT_WRONG_USE, EXIT_FAULT, EXIT_INTERRUPTED = 2, 70, 130
_MEMORY_HINT = "give smaller inputs, or fewer processes (--jobs)"
_FAULT_HINT = "run again with --debug for the traceback"
OPENCV_NO_MEMORY = -4
GARBAGE_AFTER = 20_000  # new containers; imports leave no garbage, and the search took 5 % of a short process


def __getattr__(name: str) -> typer.Typer:
    """``app``, the whole command line, built on first access."""
    if name != "app":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from lmkit.cli.app import build_app

    globals()["app"] = app = build_app()
    return app


def main() -> None:
    """Run the command line: every failure is one line on stderr and an exit code."""
    gc.set_threshold(GARBAGE_AFTER)
    open_standard_streams()
    signal.signal(signal.SIGTERM, _terminate)
    debug = "--debug" in sys.argv
    # `--debug` may be at any position.
    arguments = [a for a in sys.argv[1:] if a != "--debug"]
    sys.exit(guarded(lambda: run_arguments(arguments), debug))


def _terminate(*_: object) -> None:
    """End on SIGTERM as on Ctrl-C, so that no partial files and workers remain."""
    raise KeyboardInterrupt


def open_standard_streams() -> None:
    """Replacements for closed standard streams, whose descriptors the next opened file would get."""
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w"))  # noqa: SIM115, PTH123
    if isinstance(sys.stdout, io.TextIOWrapper):  # file names may be undecodable; they are escaped as in JSON
        sys.stdout.reconfigure(errors="backslashreplace")


def run_arguments(arguments: Sequence[str]) -> Any:
    """Parse and run one command line; only the module of its command is imported."""
    first = arguments[0] if arguments else "--help"
    if first in ("-h", "--help", "--version"):
        sys.stdout.write(f"lmkit {__version__}\n" if first == "--version" else list_of_commands() + "\n")
        return 0 if arguments else EXIT_WRONG_USE
    import typer

    from lmkit.cli.app import build_app

    command = next((a for a in arguments if not a.startswith("-")), None)
    names = (command,) if command in COMMANDS else COMMANDS
    try:
        return build_app(names)(arguments, prog_name="lmkit", standalone_mode=False)
    except typer.Abort as abort:
        if isinstance(abort.__context__, EOFError):  # typer treats every end of a file as the end of a dialog
            raise abort.__context__ from None
        raise KeyboardInterrupt from None


def guarded(run: Callable[[], Any], debug: bool) -> int:
    """The exit code of ``run``; failures and warnings about inputs are reported in one line each on stderr."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("always", InputWarning)
            warnings.formatwarning = _one_line
            result = run()
        sys.stdout.flush()
        # Not in standalone mode, typer returns the code of typer.Exit, and of an interruption.
        code = result if isinstance(result, int) else 0
        return _report("interrupted", "", code, False) if code == EXIT_INTERRUPTED else code
    except LmkitError as error:
        return _report(error.message, error.hint, error.exit_code, debug)
    except KeyboardInterrupt:
        return _report("interrupted", "", EXIT_INTERRUPTED, False)
    except BrokenPipeError:
        # The reader of the output has closed it, as `head` does.
        _forget_output()
        return 0
    except SystemExit as stop:
        # Typer ends this way if the reader of the output has closed it.
        if type(sys.stdout).__name__ != "PacifyFlushWrapper":
            raise
        _forget_output()
        return 0 if stop.code == 1 else int(stop.code or 0)
    except MemoryError:
        return _report("out of memory", _MEMORY_HINT, EXIT_WRONG_USE, debug)
    except Exception as error:
        if type(error).__module__.startswith("cv2") and getattr(error, "code", 0) == OPENCV_NO_MEMORY:
            return _report("out of memory", _MEMORY_HINT, EXIT_WRONG_USE, debug)
        if isinstance(error, OSError) and (problem := system_problem(error)):
            if error.filename is None:
                _forget_output()
            return _report(*problem, EXIT_WRONG_USE, debug)
        if hasattr(error, "format_message"):
            from lmkit.cli.wrong_use import wrong_use

            return _report(*wrong_use(error), debug)
        return _report(
            f"internal error (please report): {type(error).__name__}: {error}", _FAULT_HINT, EXIT_FAULT, debug
        )


def _forget_output() -> None:
    """Discard buffered standard output, so that the interpreter reports no error at exit."""
    with contextlib.suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


_FORMAT = warnings.formatwarning


def _one_line(message: Warning | str, category: type[Warning], *place: Any, **more: Any) -> str:
    return f"lmkit: {message}\n" if issubclass(category, InputWarning) else _FORMAT(message, category, *place, **more)


def _report(message: str, hint: str, code: int, debug: bool) -> int:
    if debug:
        import traceback

        traceback.print_exc()
    sys.stderr.write(f"lmkit: {problem_and_remedy(message, hint)}\n")
    return code
