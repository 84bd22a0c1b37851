"""Documents (YAML) read with suspicion: safe loader, no duplicate or unknown keys, no NaN."""

from __future__ import annotations

import math
from collections.abc import Hashable
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, ConfigDict, ValidationError

from lmkit.errors import InputError

MAX_BYTES = 64 * 1024 * 1024


class Document(BaseModel):
    """Base of every file layout: unknown keys and values that are not finite are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


DocumentT = TypeVar("DocumentT", bound=Document)


class _UniqueKeyLoader(yaml.SafeLoader):
    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        seen = set()
        for key_node, _ in node.value:
            key = self.construct_object(key_node, deep=True)
            if not isinstance(key, str):
                raise yaml.constructor.ConstructorError(None, None, f"key {key!r} is not a word", key_node.start_mark)
            if key in seen:
                raise yaml.constructor.ConstructorError(None, None, f"key {key!r} stands twice", key_node.start_mark)
            seen.add(key)
        return super().construct_mapping(node, deep)


def read_text(path: Path, what: str) -> str:
    """The text of a file.

    Raises:
        InputError: no such file, not readable, too large, or not UTF-8.
    """
    try:
        if path.stat().st_size > MAX_BYTES:
            raise InputError(
                "file_too_large", f"{path}: larger than {MAX_BYTES >> 20} MiB, no {what}", f"give a {what}"
            )
        return path.read_text(encoding="utf-8")
    except OSError as error:
        raise InputError(
            "file_unreadable",
            f"cannot read {what} {path}: {error.strerror}",
            "check the path and its permissions",
        ) from None
    except UnicodeDecodeError:
        raise InputError("not_text", f"{path}: not a text file", f"give a {what}") from None


def read_document(path: Path, layout: type[DocumentT], what: str) -> DocumentT:
    """Read and validate a YAML (or JSON) file.

    Args:
        layout: the pydantic layout it must follow.
        what: its kind in error messages, e.g. ``rig file``.

    Raises:
        InputError: anything wrong with it, with the path of the offending key.
    """
    text = read_text(path, what)
    try:
        data = yaml.load(text, Loader=_UniqueKeyLoader)
    except (yaml.YAMLError, RecursionError) as error:
        mark = getattr(error, "problem_mark", None)
        where = f" line {mark.line + 1}, column {mark.column + 1}" if mark else ""
        problem = getattr(error, "problem", None) or type(error).__name__
        raise InputError("bad_yaml", f"{path}:{where} {problem}", "fix that line") from None
    if not isinstance(data, dict):
        raise InputError("bad_yaml", f"{path}: holds no keys", f"give a {what}, see docs/formats.md")
    kind = layout.model_fields["format"].default
    if data.get("format") != kind:
        raise InputError(
            "wrong_format",
            f"{path}: format is {data.get('format')!r}, expected {kind!r}",
            f"give a {what}, see docs/formats.md",
        )
    _refuse_not_finite(path, data, "")
    try:
        return layout.model_validate(data)
    except ValidationError as error:
        where, problem = first_problem(error)
        raise InputError("bad_value", f"{path}: {where}: {problem}", "see docs/formats.md") from None


def first_problem(error: ValidationError) -> tuple[str, str]:
    """(path of the key, what is wrong with it) of a validation's first complaint."""
    detail = error.errors(include_url=False, include_context=False)[0]
    where = ""
    for part in detail["loc"]:
        where += f"[{part}]" if isinstance(part, int) else f".{part}" if where else str(part)
    messages = {"extra_forbidden": "unknown key", "missing": "missing"}
    problem = messages.get(detail["type"], detail["msg"].removeprefix("Value error, "))
    return where or "the file", problem


def _refuse_not_finite(path: Path, value: object, where: str) -> None:
    if isinstance(value, float) and not math.isfinite(value):
        raise InputError("not_finite", f"{path}: {where} is {value}", "write a finite number")
    if isinstance(value, dict):
        for key, item in value.items():
            _refuse_not_finite(path, item, f"{where}.{key}" if where else str(key))
    elif isinstance(value, list):
        for index, item in enumerate(value):
            _refuse_not_finite(path, item, f"{where}[{index}]")


class _TidyDumper(yaml.SafeDumper):
    """Numbers in full precision, short lists on one line."""


def _represent_list(dumper: yaml.SafeDumper, values: list[Any]) -> yaml.Node:
    flat = all(isinstance(v, int | float) for v in values)
    return dumper.represent_sequence("tag:yaml.org,2002:seq", values, flow_style=flat)


_TidyDumper.add_representer(list, _represent_list)


def dump_yaml(data: dict[str, Any]) -> str:
    """``data`` as YAML, keys in the order given."""
    return yaml.dump(data, Dumper=_TidyDumper, sort_keys=False, allow_unicode=True, width=110)
