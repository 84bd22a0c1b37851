"""Packages of extras that outputs need."""

from __future__ import annotations

from importlib.util import find_spec

from lmkit.errors import EXTRA, InputError


def require(module: str, what: str, extra: str) -> None:
    """Refuse an output whose package is missing.

    Raises:
        InputError: with the command that installs it.
    """
    try:
        found = find_spec(module) is not None
    except ModuleNotFoundError:
        found = False
    if not found:
        raise InputError("extra_missing", f"{what} needs the package {module}", EXTRA.format(extra))
