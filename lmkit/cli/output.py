"""Output of the commands: JSON lines, text, warnings, progress bars; and checks of outputs before the work begins."""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, TypeVar

from lmkit.errors import InputError

Item = TypeVar("Item")
BOARD_HELP = (
    "Board: chessboard:9x6:30mm (inner corners), charuco:8x6:30mm:22mm:DICT_5X5_100[:legacy] (squares), "
    "landmarks:4x3:60mm:48mm[:FIRST_CODE] or aprilgrid:6x6:22mm:0.3[:FAMILY] (Kalibr's)."
)


def print_json(data: dict[str, Any]) -> None:
    """Print one JSON object on one line of stdout; NaN and infinities are refused."""
    sys.stdout.write(json.dumps(data, allow_nan=False, ensure_ascii=False) + "\n")
    sys.stdout.flush()


def print_line(text: str = "") -> None:
    """Print a line of text on stdout."""
    sys.stdout.write(text + "\n")


def warn(text: str) -> None:
    """Print a warning on stderr."""
    sys.stderr.write(f"lmkit: {' '.join(text.split())}\n")


def warn_all(texts: Iterable[str], spared: Collection[str] = ()) -> None:
    """Print warnings on stderr, except repeated ones."""
    for text in texts:
        if text not in spared:
            warn(text)


# Prefix of the JSON lines of progress with LMKIT_PROGRESS=lines; `lmkit web` reads them.
PROGRESS_LINE = "\x1eprogress "
LEAST_APART_S = 0.1


class ProgressBars:
    """Progress bars with the time left, one per step, on stderr if that is a terminal."""

    def __init__(self) -> None:
        self._progress: Any = None
        self._tasks: dict[str, Any] = {}
        self._lines = os.environ.get("LMKIT_PROGRESS") == "lines"
        self._written_s = 0.0

    def __enter__(self) -> ProgressBars:
        if sys.stderr.isatty():
            from rich.console import Console
            from rich.progress import Progress

            # Rich would redirect stdout to its own console, which is stderr.
            to_terminal = sys.stdout.isatty()
            self._progress = Progress(console=Console(stderr=True), transient=True, redirect_stdout=to_terminal)
            self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._progress is not None:
            self._progress.stop()

    def update(self, step: str, done: int, total: int | None) -> None:
        """Show the number of finished items of a step; ``total`` is None if unknown."""
        if self._lines and (done in (0, total) or time.monotonic() - self._written_s > LEAST_APART_S):
            self._written_s = time.monotonic()
            sys.stderr.write(f"{PROGRESS_LINE}{json.dumps({'step': step, 'done': done, 'total': total})}\n")
            sys.stderr.flush()
        if self._progress is None:
            return
        if step not in self._tasks:
            self._tasks[step] = self._progress.add_task(step, total=total)
        self._progress.update(self._tasks[step], completed=done, total=total)

    def counter(self, step: str) -> Callable[[int, int], None]:
        """A callback for library functions that report (done, total)."""
        return lambda done, total: self.update(step, done, total)


def progress(items: Iterable[Item], total: int | None, step: str) -> Iterator[Item]:
    """The items, with a progress bar."""
    with ProgressBars() as bars:
        bars.update(step, 0, total)
        for done, item in enumerate(items, start=1):
            yield item
            bars.update(step, done, total)


def require_no(option: str, others: Mapping[str, object]) -> None:
    """Refuse options that would be ignored together with another option.

    Args:
        others: values by option name; None means not given.

    Raises:
        InputError: one of these options was given.
    """
    for name, value in others.items():
        if value is not None:
            raise InputError("not_together", f"{option} and {name} cannot be combined", "leave one of them out")


def check_outputs(paths: Iterable[Path | None], force: bool) -> None:
    """Refuse output files that cannot be written, before the work begins.

    Raises:
        InputError: a file exists, or its folder cannot be written to.
    """
    from lmkit.io.files import check_writable

    for path in paths:
        if path is not None:
            check_writable(path, force)


def image_kind(path: Path) -> str:
    """``png`` or ``svg``, from the file name."""
    return path.suffix.lower().lstrip(".")


def write_outputs(contents: Mapping[Path | None, bytes | str], force: bool) -> list[Path]:
    """Write the requested files (None: not requested), all or none; returns the written paths."""
    from lmkit.io.files import write_files

    wanted = {path: content for path, content in contents.items() if path is not None}
    write_files(wanted, force)
    return list(wanted)
