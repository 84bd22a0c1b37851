"""What `lmkit survey` and `lmkit track` write alike: plans of a drive."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from lmkit.errors import InputError

if TYPE_CHECKING:
    pass

PLAN_KINDS = ("png", "svg")


def check_outputs(paths: Sequence[Path | None], plan: Path | None, force: bool) -> None:
    """Refuse what cannot be written before the work begins.

    Raises:
        InputError: a file exists, its folder cannot be written to, or the plan is of an unknown kind.
    """
    from lmkit.formats.files import check_writable

    for path in (*paths, plan):
        if path is not None:
            check_writable(path, force)
    if plan is not None and plan_kind(plan) not in PLAN_KINDS:
        raise InputError("bad_suffix", f"cannot write {plan}: unknown kind", "name it .png or .svg")


def plan_kind(path: Path) -> str:
    """``png`` or ``svg``, as the file's name says."""
    return path.suffix.lower().lstrip(".")
