"""The only reader of text and documents: regular files, bounded size, finite numbers, no duplicate or unknown keys.

A document (YAML or JSON) is bounded in bytes, values (an aliased value counts at every use) and depth
before any value is built.
"""

from __future__ import annotations

import json
import math
import os
import re
import stat
from collections.abc import Hashable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

from lmkit.errors import InputError

if TYPE_CHECKING:
    _BaseLoader = yaml.SafeLoader
else:
    _BaseLoader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # the compiled loader is ten times as fast

MAX_BYTES = 64 * 1024 * 1024
MAX_VALUES = 1_000_000  # of a document, keys included
MAX_DEPTH = 40
MAX_INTEGER = 2**63
_NO_TIMES = ("tag:yaml.org,2002:timestamp", "tag:yaml.org,2002:int", "tag:yaml.org,2002:float")
# First bytes of other files, and what to do with them.
_BINARY = (
    (b"\x1f\x8b", "unpack it first (gunzip)"),
    (b"PK\x03\x04", "unpack it first; of a numpy file (.npz), write the arrays as JSON, with tolist()"),
    (b"\x93NUMPY", "write the array of the numpy file as JSON or text, with tolist()"),
    (b"\x80", "write what the pickle contains as JSON, arrays with tolist()"),
    (b"MATLAB 5.0 MAT-file", "write its variables as YAML or JSON"),
    (b"SQLite format 3", "give the file that was exported from the database"),
)
_BOMS = ((b"\xef\xbb\xbf", "utf-8-sig"), (b"\xff\xfe", "utf-16"), (b"\xfe\xff", "utf-16"))


class PlainLoader(_BaseLoader):
    """YAML without dates and base-60 numbers, which YAML 1.1 reads from ordinary text."""

    yaml_implicit_resolvers = {  # noqa: RUF012  (PyYAML's own name and kind)
        first: [(tag, pattern) for tag, pattern in resolvers if tag not in _NO_TIMES]
        for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
    }


def _integer(loader: yaml.SafeLoader, node: yaml.ScalarNode) -> int:
    return int(str(loader.construct_scalar(node)).lstrip(), 10)


PlainLoader.add_constructor("tag:yaml.org,2002:int", _integer)
PlainLoader.add_implicit_resolver("tag:yaml.org,2002:int", re.compile(r"[-+]?[0-9]+$"), list("-+0123456789"))
PlainLoader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(
        r"(?:[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN))$"
    ),
    list("-+.0123456789"),
)


class _UniqueKeyLoader(PlainLoader):
    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        seen = set()
        for key_node, _ in node.value:
            key = self.construct_object(key_node, deep=True)
            if not isinstance(key, str):
                raise yaml.constructor.ConstructorError(None, None, f"key {key!r} is not a word", key_node.start_mark)
            if key in seen:
                raise yaml.constructor.ConstructorError(None, None, f"duplicate key {key!r}", key_node.start_mark)
            seen.add(key)
        return super().construct_mapping(node, deep)


def with_article(what: str) -> str:
    """``a map file``, ``an odometry file``."""
    return f"{'an' if what[0].lower() in 'aeio' else 'a'} {what}"


def require_regular(path: Path, what: str) -> None:
    """Refuse a folder, a device or a pipe.

    Raises:
        InputError: no such file, or not a regular one.
    """
    try:
        mode = path.stat().st_mode
    except (OSError, ValueError) as error:
        raise unreadable(path, what, error) from None
    if stat.S_ISDIR(mode):
        raise InputError("is_folder", f"{path} is a folder, not {with_article(what)}", "give the file itself")
    if not stat.S_ISREG(mode):
        raise InputError(
            "not_a_file", f"{path} is a device or pipe, not {with_article(what)}", "save it as a file, and give that"
        )


def unreadable(path: Path, what: str, error: OSError | ValueError) -> InputError:
    """The error for a file that the operating system cannot read."""
    problem = getattr(error, "strerror", None) or error
    return InputError(
        "file_unreadable", f"cannot read {what} {path}: {problem}", "check the path and its permissions"
    )


def read_text(path: Path, what: str, most: int = MAX_BYTES) -> str:
    """Text of a regular file of ``most`` bytes: UTF-8, or UTF-16 with a byte order mark; line ends become ``\\n``.

    Raises:
        InputError: no such file, not a regular one, not readable, too large, or not text.
    """
    require_regular(path, what)
    try:
        with path.open("rb") as stream:
            data = stream.read(most + 1)
    except OSError as error:
        raise unreadable(path, what, error) from None
    if len(data) > most:
        raise InputError(
            "file_too_large", f"{path}: larger than {most >> 20} MiB, no {what}", f"give {with_article(what)}"
        )
    encoding = next((name for mark, name in _BOMS if data.startswith(mark)), "utf-8")
    try:
        text = data.decode(encoding)
    except UnicodeDecodeError:
        raise InputError("not_text", f"{path}: not a text file (UTF-8)", _how_to_read(data, what)) from None
    if "\0" in text:
        raise InputError("not_text", f"{path}: not a text file (contains zero bytes)", _how_to_read(data, what))
    return text.replace("\r\n", "\n").replace("\r", "\n")


def _how_to_read(data: bytes, what: str) -> str:
    """Advice for bytes that are no text of UTF-8."""
    remedy = next((remedy for start, remedy in _BINARY if data.startswith(start)), None)
    if remedy is not None:
        return remedy
    is_old_text = not any(byte < 0x20 and byte not in b"\t\n\r\f" for byte in data)
    return "save it as UTF-8" if is_old_text else f"give {with_article(what)}"


def is_folder(path: Path) -> bool:
    """Whether a path is a folder; no path raises an error."""
    return os.path.isdir(path)  # noqa: PTH112  (Path.is_dir raises for overlong names)


def without_opencv_line(text: str) -> str:
    """The text without the first line of cv2.FileStorage, which is not YAML."""
    return text.removeprefix("%YAML:1.0")


def load_document(
    path: Path,
    text: str,
    loader: type[yaml.SafeLoader] = PlainLoader,
    finite: bool = True,
    several: bool = False,
) -> Any:
    """Values of a YAML or JSON text within the bounds of this module.

    Args:
        path: named in errors.
        finite: refuse numbers that are not finite.
        several: read the first of several documents instead of refusing them.

    Raises:
        InputError: ``bad_yaml`` with line and column, ``document_too_large``, or ``not_finite`` with the key.
    """
    text = without_opencv_line(text)
    try:
        _check_bounds(path, text)
        reader: Any = loader(text)
        try:
            data = reader.get_data() if reader.check_data() else None
            while not several and reader.check_data():
                if reader.get_data() is not None:
                    raise InputError("bad_yaml", f"{path}: several documents (---)", "keep one of them")
        finally:
            reader.dispose()
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = f" line {mark.line + 1}, column {mark.column + 1}" if mark else ""
        problem = getattr(error, "problem", None) or type(error).__name__
        raise InputError("bad_yaml", f"{path}:{where} {problem}", "fix that line") from None
    except (ValueError, KeyError, TypeError, AttributeError, IndexError, RecursionError, OverflowError) as error:
        raise InputError(
            "bad_yaml", f"{path}: a value does not fit its tag ({error})", "write plain values"
        ) from None
    _check_values(path, data, finite)
    return data


def load_json(path: Path, text: str) -> Any:
    """Values of a JSON text within the bounds of this module, all finite.

    Raises:
        InputError: as for :func:`load_document`.
    """
    depth = 0
    for sign in re.findall(r'"(?:[^"\\]|\\.)*"|[\[\]{}]', text):
        depth += {"[": 1, "{": 1, "]": -1, "}": -1}.get(sign, 0)
        if depth > MAX_DEPTH:
            raise _too_large(path, f"nested more than {MAX_DEPTH} deep")
    if text.count(",") + text.count(":") > MAX_VALUES:
        raise _too_large(path, f"more than {MAX_VALUES} values")
    try:
        data = json.loads(text)
    except json.JSONDecodeError as error:
        where = f"line {error.lineno}, column {error.colno}"
        raise InputError("bad_json", f"{path}: {where} {error.msg}", "fix that line") from None
    except (ValueError, RecursionError) as error:
        raise InputError("bad_json", f"{path}: {error}", "write plain values") from None
    _check_values(path, data, True)
    return data


def _check_bounds(path: Path, text: str) -> None:
    """Count values and depth from the parser's events, before anything is built."""
    count = depth = 0
    sizes: dict[str, int] = {}
    open_: list[tuple[str | None, int]] = []
    for event in yaml.parse(text, Loader=_BaseLoader):
        if isinstance(event, yaml.AliasEvent):
            if event.anchor not in sizes:
                raise InputError(
                    "bad_yaml", f"{path}: alias *{event.anchor} refers to itself or to nothing", "remove it"
                )
            count += sizes[event.anchor]
        elif isinstance(event, yaml.ScalarEvent):
            count += 1
            if event.anchor:
                sizes[event.anchor] = 1
        elif isinstance(event, yaml.CollectionStartEvent):
            open_.append((event.anchor, count))
            count, depth = count + 1, depth + 1
        elif isinstance(event, yaml.CollectionEndEvent):
            anchor, before = open_.pop()
            depth -= 1
            if anchor:
                sizes[anchor] = count - before
        if depth > MAX_DEPTH:
            raise _too_large(path, f"nested more than {MAX_DEPTH} deep")
        if count > MAX_VALUES:
            raise _too_large(path, f"more than {MAX_VALUES} values")


def _too_large(path: Path, problem: str) -> InputError:
    return InputError("document_too_large", f"{path}: {problem}", "give a smaller file, without aliases")


def _check_values(path: Path, data: object, finite: bool) -> None:
    for where, value in _leaves(data, ""):
        if isinstance(value, float) and finite and not math.isfinite(value):
            raise InputError("not_finite", f"{path}: {where} is {value}", "write a finite number")
        if isinstance(value, int) and abs(value) >= MAX_INTEGER:
            raise InputError("bad_value", f"{path}: {where}: an integer beyond 64 bits", "write a smaller number")
        if isinstance(value, str) and any("\ud800" <= letter <= "\udfff" for letter in value):
            raise InputError("bad_value", f"{path}: {where}: an incomplete character (surrogate)", "write plain text")


def _leaves(value: object, where: str) -> Iterator[tuple[str, object]]:
    if isinstance(value, dict):
        for key, item in value.items():
            yield where, key
            yield from _leaves(item, f"{where}.{key}" if where else str(key))
    elif isinstance(value, list):
        for index, item in enumerate(value):
            yield from _leaves(item, f"{where}[{index}]")
    else:
        yield where, value


def read_keys(path: Path, kind: str, what: str) -> dict[str, Any]:
    """Keys and values of a YAML (or JSON) file of lmkit.

    Args:
        kind: value that its key ``format`` must have, e.g. ``lmkit-rig/1``.
        what: its kind in error messages, e.g. ``rig file``.

    Raises:
        InputError: no such document, or a document of another kind.
    """
    data = load_document(path, read_text(path, what), _UniqueKeyLoader)
    if not isinstance(data, dict):
        raise InputError("bad_yaml", f"{path}: contains no keys", f"give a {what}, see docs/formats.md")
    if data.get("format") != kind:
        raise InputError(
            "wrong_format",
            f"{path}: format is {data.get('format')!r}, expected {kind!r}",
            f"give a {what}, see docs/formats.md",
        )
    return data


class _TidyDumper(yaml.SafeDumper):
    """Numbers in full precision, short lists on one line."""


def _represent_list(dumper: yaml.SafeDumper, values: list[Any]) -> yaml.Node:
    flat = all(isinstance(v, int | float) for v in values)
    return dumper.represent_sequence("tag:yaml.org,2002:seq", values, flow_style=flat)


_TidyDumper.add_representer(list, _represent_list)


def dump_yaml(data: dict[str, Any]) -> str:
    """``data`` as YAML, keys in the order given."""
    return yaml.dump(data, Dumper=_TidyDumper, sort_keys=False, allow_unicode=True, width=110)
