"""Values of a command line without typer's validation, which uses pydantic.

Loading pydantic takes a quarter of `lmkit detect`.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from typer.core import TyperGroup

KINDS: dict[Any, type] = {str: str, list[str]: str, Path: Path, list[Path]: Path, int: int, float: float}
# Settings of an option that convert or restrict its text.
RESTRICTING = ("parser", "exists", "writable", "resolve_path", "allow_dash", "path_type")


class PlainGroup(TyperGroup):
    """The group of all commands, whose own options are flags."""

    def get_params(self, ctx: Any) -> list[Any]:
        """Options, including the parser's own."""
        return taken_plainly(super().get_params(ctx))


@dataclass(frozen=True)
class PlainValues:
    """Conversion of the values of one option or argument: text and defaults here, other values by typer.

    Attributes:
        kind: type of each value; None if typer converts all of them.
        option: typer's option.
    """

    kind: type | None
    option: Any

    def coerce(self, value: Any, param: Any, ctx: Any) -> Any:
        """The value as typer would convert it."""
        several = param.multiple or param.nargs == -1
        if value is None:
            return () if several else None
        values = list(value) if several and not isinstance(value, str) else [value]
        if self.kind is None or not all(map(self._is_plain, values)):
            return type(self.option).get_runtime_param(self.option).coerce(value, param, ctx)
        converted = [self.kind(one) for one in values]
        return converted if several else converted[0]

    def _is_plain(self, value: Any) -> bool:
        if self.kind is Path:  # typer refuses an unreadable file
            return isinstance(value, str | Path) and (os.access(value, os.R_OK) or not Path(value).exists())
        return type(value) is self.kind  # numbers of the command line are still text


def taken_plainly(options: list[Any]) -> list[Any]:
    """Options and arguments of typer that convert plain values themselves; older versions of typer always do."""
    for option in options:
        described = getattr(option, "type_descriptor", None)
        if described is not None and "get_runtime_param" not in vars(option):
            restricted = any(getattr(described.parameter_info, name, None) for name in RESTRICTING)
            plain = PlainValues(None if restricted else KINDS.get(described.annotation), option)
            option.get_runtime_param = lambda plain=plain: plain
    return options
