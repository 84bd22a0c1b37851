"""Layouts of rig and map files: their keys, and the allowed values.

Every command that locates something reads both.  `document_models.py` describes other files by models of pydantic,
whose import alone takes a quarter of `lmkit locate`; problems have the same words here (`field_problems.py`).

A layout is a dataclass.  Each key's value passes a check, a function that returns the value or raises
`FieldProblem`: ``code: Annotated[int, count]``.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import MISSING, fields
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, TypeVar, cast, get_args, get_origin, get_type_hints

from lmkit.errors import InputError
from lmkit.io.documents import read_keys
from lmkit.io.field_problems import path_of, sentence_of

Value = TypeVar("Value")
LayoutT = TypeVar("LayoutT", bound="Layout")
Check = Callable[[Any], Value]


class FieldProblem(Exception):
    """Problem of a value, such as a key that is missing.

    Args:
        sentence: what is wrong, e.g. ``-3 is below 0``.
    """

    def __init__(self, sentence: str) -> None:
        super().__init__(sentence)
        self.place: list[str | int] = []  # keys and numbers of list items, the innermost first
        self.sentence = sentence

    @classmethod
    def known(cls, kind: str, given: object = "", **limits: object) -> FieldProblem:
        """A problem with a name in `field_problems.py`, of a value, with the limits that its sentence names."""
        return cls(sentence_of(kind, given, limits))


class Layout:
    """Base of every layout: a dataclass of keyword arguments alone.  Keys with a default may be left out."""


def number(least: float = -math.inf, most: float = math.inf, above: float = -math.inf) -> Check[float]:
    """Check for a finite number within bounds; text that is a number counts as one."""

    def check(given: Any) -> float:
        if isinstance(given, bool) or not isinstance(given, int | float | str):
            raise FieldProblem.known("float_type", given)
        try:
            value = float(given)
        except ValueError:
            raise FieldProblem.known("float_type", given) from None
        if not math.isfinite(value):
            raise FieldProblem.known("finite_number", given)
        if value <= above:
            raise FieldProblem.known("greater_than", given, gt=above)
        if value < least:
            raise FieldProblem.known("greater_than_equal", given, ge=least)
        if value > most:
            raise FieldProblem.known("less_than_equal", given, le=most)
        return value

    return check


def whole_number(given: Any) -> int:
    """Check for a whole number, 640 or 640.0."""
    try:
        value = number()(given)
    except FieldProblem:
        raise FieldProblem.known("int_type", given) from None
    if value != int(value):
        raise FieldProblem.known("int_type", given)
    return int(value)


def count(given: Any) -> int:
    """Check for a whole number that is not negative, such as a code; 5.0 is refused."""
    if isinstance(given, bool) or not isinstance(given, int):
        raise FieldProblem.known("int_type", given)
    if given < 0:
        raise FieldProblem.known("greater_than_equal", given, ge=0)
    return given


def text(least_letters: int = 0) -> Check[str]:
    """Check for text."""

    def check(given: Any) -> str:
        if not isinstance(given, str):
            raise FieldProblem.known("string_type", given)
        if len(given) < least_letters:
            raise FieldProblem.known("string_too_short", given)
        return given

    return check


def word(*known: str) -> Check[str]:
    """Check for one of some words."""

    def check(given: Any) -> str:
        if given not in known:
            raise FieldProblem.known("literal_error", given, expected=" or ".join(map(repr, known)))
        return cast(str, given)

    return check


def items(check: Check[Value], least: int = 0, most: float = math.inf) -> Check[list[Value]]:
    """Check for a list of ``least`` to ``most`` values, each of which is checked."""

    def check_all(given: Any) -> list[Value]:
        if not isinstance(given, list):
            raise FieldProblem.known("list_type", given)
        if len(given) > most:
            raise FieldProblem.known("too_long", given, max_length=most)
        checked = [_at(place, check, value) for place, value in enumerate(given)]
        if len(given) < least:
            raise FieldProblem.known("too_short", given, actual_length=len(given), min_length=least)
        return checked

    return check_all


def pair(check: Check[Value]) -> Check[tuple[Value, Value]]:
    """Check for a list of two values."""

    def check_both(given: Any) -> tuple[Value, Value]:
        first, second = items(check, 2, 2)(given)
        return first, second

    return check_both


_USUAL: dict[Any, Check[Any]] = {
    float: number(),
    int: whole_number,
    str: text(),
    list[float]: items(number()),
    tuple[int, int]: pair(whole_number),
}


def matrix(rows: int, columns: int) -> Check[list[list[float]]]:
    """Check for a matrix of numbers."""
    return items(items(number(), columns, columns), rows, rows)


def keys_of(layout: type[LayoutT]) -> Check[LayoutT]:
    """Check for the keys of a layout."""

    def check(given: Any) -> LayoutT:
        if not isinstance(given, dict):
            raise FieldProblem.known("model_type", given)
        values, checks = {}, _checks(cast(Any, layout))
        for one in fields(cast(Any, layout)):
            if one.name in given:
                values[one.name] = _at(one.name, checks[one.name], given[one.name])
            elif one.default is MISSING:
                raise _within(one.name, FieldProblem.known("missing"))
        for name in given:
            if name not in checks:
                raise _within(name, FieldProblem.known("extra_forbidden"))
        return layout(**values)

    return check


@lru_cache
def _checks(layout: type[Layout]) -> dict[str, Check[Any]]:
    return {name: _check_of(hint) for name, hint in get_type_hints(layout, include_extras=True).items()}


def _check_of(hint: Any) -> Check[Any]:
    """The check of a type: its own, the usual one, or one of these that also accepts None."""
    if get_origin(hint) is Annotated:
        return cast(Check[Any], hint.__metadata__[0])
    if hint in _USUAL:
        return _USUAL[hint]
    if isinstance(hint, type) and issubclass(hint, Layout):
        return keys_of(hint)
    check = _check_of(get_args(hint)[0])  # of `Kind | None`
    return lambda given: None if given is None else check(given)


def _at(place: str | int, check: Check[Value], given: object) -> Value:
    try:
        return check(given)
    except FieldProblem as problem:
        raise _within(place, problem) from None


def _within(place: str | int, problem: FieldProblem) -> FieldProblem:
    problem.place.append(place)
    return problem


def read_layout(path: Path, layout: type[LayoutT], kind: str, what: str) -> LayoutT:
    """Read and check a YAML (or JSON) file.

    Args:
        kind: value of its key ``format``, which is no key of the layout.
        what: its kind in error messages, e.g. ``rig file``.

    Raises:
        InputError: anything wrong with it, with the path of the offending key.
    """
    data = read_keys(path, kind, what)
    del data["format"]
    try:
        return keys_of(layout)(data)
    except FieldProblem as problem:
        where = path_of(reversed(problem.place))
        raise InputError("bad_value", f"{path}: {where}: {problem.sentence}", "see docs/formats.md") from None
