"""Plain messages for invalid values in files, instead of those of Python and pydantic."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pydantic import ValidationError

MOST_SHOWN = 40  # characters of a value
# By pydantic's name of the problem; {value} and its limits are filled in.
SENTENCES = {
    "extra_forbidden": "unknown key",
    "missing": "missing",
    "model_type": "contains no keys",
    "dict_type": "contains no keys",
    "float_type": "{value} is not a number",
    "float_parsing": "{value} is not a number",
    "int_type": "{value} is not a whole number",
    "int_parsing": "{value} is not a whole number",
    "int_from_float": "{value} is not a whole number",
    "finite_number": "{value} is not finite",
    "string_type": "{value} is not text",
    "string_too_short": "is empty",
    "string_too_long": "is longer than {max_length} letters",
    "string_pattern_mismatch": "{value} is not written as it should be",
    "bool_type": "{value} is neither true nor false",
    "bool_parsing": "{value} is neither true nor false",
    "list_type": "{value} is not a list",
    "tuple_type": "{value} is not a list",
    "greater_than": "{value} is not above {gt}",
    "greater_than_equal": "{value} is below {ge}",
    "less_than": "{value} is not below {lt}",
    "less_than_equal": "{value} is above {le}",
    "literal_error": "{value} is unknown, {expected} is expected",
    "too_short": "needs {min_length} or more values, but has {actual_length}",
    "too_long": "has more than {max_length} values",
}


def first_problem(error: ValidationError) -> tuple[str, str]:
    """(path of the key, problem) of the first error of a validation."""
    detail = error.errors(include_url=False)[0]
    sentence = sentence_of(detail["type"], detail["input"], detail.get("ctx", {}), detail["msg"])
    return path_of(detail["loc"]), sentence


def path_of(place: Iterable[str | int]) -> str:
    """Path of a value, such as ``cameras[0].K``, from its keys and list indices."""
    where = ""
    for part in place:
        where += f"[{part}]" if isinstance(part, int) else f".{part}" if where else str(part)
    return where or "the file"


def sentence_of(kind: str, given: object, limits: Mapping[str, object], otherwise: str = "") -> str:
    """Sentence about a value.

    Args:
        kind: name of the problem.
        given: the value.
        limits: numbers that the sentence names.
        otherwise: the sentence for an unknown kind of problem.
    """
    if kind == "too_short" and not given:
        return "contains nothing"
    sentence = SENTENCES.get(kind)
    if sentence is None:
        return otherwise.removeprefix("Value error, ")
    value = {True: "true", False: "false"}[given] if isinstance(given, bool) else repr(given)
    if given is None:
        return "has no value"
    shown = value if len(value) <= MOST_SHOWN else f"{value[:MOST_SHOWN]}..."
    return sentence.format_map({**limits, "value": shown})


def plain_problem(error: Exception) -> str:
    """A problem with values of a file, without Python's own message for a missing key or a wrong type."""
    text = str(error)
    if isinstance(error, KeyError):
        return f"{error.args[0]} is missing"
    if isinstance(error, TypeError | AttributeError | IndexError):
        return "a value or list of another kind is expected"
    if text.startswith(("invalid literal for int", "could not convert string to float")):
        return f"{text.rpartition(': ')[2]} is not a number"
    return text
