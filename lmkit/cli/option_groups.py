"""Groups of options common to several commands: a parameter of such a type stands for the options of the group."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass, fields, is_dataclass
from functools import wraps
from typing import Any, get_type_hints

from lmkit.cli import options


@dataclass(frozen=True)
class DrawnFloorOptions:
    """Options for reading walls from a drawing or an image of a floor plan."""

    scale: options.Scale = None
    islands: options.Islands = "obstacles"
    thin_lines: options.ThinLines = None
    curves: options.Curves = True
    layers: options.Layers = ""


PLAIN = DrawnFloorOptions()


def with_groups(run: Callable[..., None]) -> Callable[..., None]:
    """The command for the parser: each parameter that is a group is replaced by the fields of the group."""
    hints: dict[str, Any] = get_type_hints(run, include_extras=True)
    groups: dict[str, Any] = {name: kind for name, kind in hints.items() if is_dataclass(kind)}
    if not groups:
        return run

    @wraps(run)
    def grouped(**values: Any) -> None:
        for name, kind in groups.items():
            values[name] = kind(**{field.name: values.pop(field.name) for field in fields(kind)})
        run(**values)

    parameters: list[inspect.Parameter] = []
    for name, parameter in inspect.signature(run).parameters.items():
        if name in groups:
            parameters += inspect.signature(groups[name], eval_str=True).parameters.values()
        else:
            parameters.append(parameter.replace(annotation=hints[name]))
    keywords = [p.replace(kind=inspect.Parameter.KEYWORD_ONLY) for p in parameters]
    grouped.__signature__ = inspect.Signature(keywords)  # type: ignore[attr-defined]
    grouped.__annotations__ = {p.name: p.annotation for p in keywords}
    return grouped
