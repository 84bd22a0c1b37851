"""What the commands share: JSON lines, tables, progress, and files refused before the work begins."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

from lmkit.errors import InputError

Item = TypeVar("Item")
PICTURE_KINDS = ("png", "svg")
BOARD_HELP = "chessboard:9x6:30mm, charuco:8x6:30mm:22mm:DICT_5X5_100[:legacy] or landmarks:4x3:60mm:48mm[:FIRST]"


def print_json(data: dict[str, Any]) -> None:
    """One JSON object on one line of stdout; refuses what JSON cannot hold (NaN, infinities)."""
    sys.stdout.write(json.dumps(data, allow_nan=False, ensure_ascii=False) + "\n")
    sys.stdout.flush()


def print_line(text: str = "") -> None:
    """A line for a person, on stdout."""
    sys.stdout.write(text + "\n")


def warn(text: str) -> None:
    """A line on stderr that stops nothing."""
    sys.stderr.write(f"lmkit: {' '.join(text.split())}\n")


def progress(items: Iterable[Item], total: int | None, what: str) -> Iterator[Item]:
    """The items, with a progress bar on stderr where that is a terminal."""
    if not sys.stderr.isatty():
        yield from items
        return
    from rich.console import Console
    from rich.progress import track

    yield from track(items, description=what, total=total, console=Console(stderr=True), transient=True)


def progress_counter(total: int, what: str) -> Callable[[int, int], None]:
    """The same for work that tells after every step how many are done, of how many."""
    ticks = progress(range(total + 1), total, what)
    next(ticks)

    def on_step(done: int, total: int) -> None:
        next(ticks, None)

    return on_step


def require_no(option: str, others: Mapping[str, object]) -> None:
    """Refuse options, by name, that would be ignored beside another one.

    Raises:
        InputError: one of them was given (is not None).
    """
    for name, value in others.items():
        if value is not None:
            raise InputError("not_together", f"{option} and {name} do not go together", "leave one of them out")


def check_outputs(paths: Sequence[Path | None], plan: Path | None, force: bool) -> None:
    """Refuse what cannot be written before the work begins.

    Args:
        plan: a picture to write, as PNG or SVG.

    Raises:
        InputError: a file exists, its folder cannot be written to, or the picture is of an unknown kind.
    """
    from lmkit.io.files import check_writable

    for path in (*paths, plan):
        if path is not None:
            check_writable(path, force)
    if plan is not None and picture_kind(plan) not in PICTURE_KINDS:
        raise InputError("bad_suffix", f"cannot write {plan}: unknown kind", "name it .png or .svg")


def picture_kind(path: Path) -> str:
    """``png`` or ``svg``, as the file's name says."""
    return path.suffix.lower().lstrip(".")
