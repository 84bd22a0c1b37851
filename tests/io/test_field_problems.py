"""Sentences about values of files: none of pydantic's own, none of Python's."""

from __future__ import annotations

import pytest
from pydantic import Field, ValidationError

from lmkit.io.documents import Document
from lmkit.io.field_problems import first_problem, plain_problem


class Layout(Document):
    number: float = Field(1.0, gt=0)
    count: int = 1
    name: str = "a"
    pair: tuple[int, int] = (1, 2)
    many: list[float] = Field([1.0, 2.0], min_length=2)


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        ({"number": "far"}, ("number", "'far' is not a number")),
        ({"number": 0}, ("number", "0 is not above 0.0")),
        ({"number": None}, ("number", "holds no value")),
        ({"count": 2.5}, ("count", "2.5 is not a whole number")),
        ({"name": True}, ("name", "true is not text")),
        ({"pair": [1, 2, 3]}, ("pair", "holds more than 2 values")),
        ({"pair": [1]}, ("pair[1]", "missing")),
        ({"many": [1]}, ("many", "holds 1 of at least 2 values")),
        ({"many": "x" * 99}, ("many", f"'{'x' * 39}... is not a list")),
        ({"nmae": "a"}, ("nmae", "unknown key")),
    ],
)
def test_a_value_is_named_with_its_fault(value, expected):
    with pytest.raises(ValidationError) as caught:
        Layout.model_validate(value)
    assert first_problem(caught.value) == expected


@pytest.mark.parametrize(
    ("make", "expected"),
    [
        (lambda: {}["pose"], "pose is missing"),
        (lambda: float("far"), "'far' is not a number"),
        (lambda: int("1.5"), "'1.5' is not a number"),
        (lambda: [][0], "a value or list stands where another kind is expected"),
    ],
)
def test_pythons_words_are_not_passed_on(make, expected):
    with pytest.raises((KeyError, ValueError, IndexError)) as caught:
        make()
    assert plain_problem(caught.value) == expected
