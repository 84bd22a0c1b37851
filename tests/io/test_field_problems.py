"""Messages about values of files contain no text of pydantic or Python."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Annotated

import pytest
from pydantic import Field, ValidationError

from lmkit.errors import InputError
from lmkit.io.document_models import Document
from lmkit.io.field_problems import first_problem, plain_problem
from lmkit.io.layouts import Layout, items, keys_of, number, read_layout


class Model(Document):
    number: float = Field(1.0, gt=0)
    count: int = 1
    name: str = "a"
    pair: tuple[int, int] = (1, 2)
    many: list[float] = Field([1.0, 2.0], min_length=2)


@dataclass(frozen=True, kw_only=True)
class Keys(Layout):
    number: Annotated[float, number(above=0.0)] = 1.0
    count: int = 1
    name: str = "a"
    pair: tuple[int, int] = (1, 2)
    many: Annotated[list[float] | None, items(number(), 2)] = None
    other: Keys | None = None


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        ({"number": "far"}, ("number", "'far' is not a number")),
        ({"number": 0}, ("number", "0 is not above 0.0")),
        ({"number": None}, ("number", "has no value")),
        ({"count": 2.5}, ("count", "2.5 is not a whole number")),
        ({"name": True}, ("name", "true is not text")),
        ({"pair": [1, 2, 3]}, ("pair", "has more than 2 values")),
        ({"pair": [1]}, ("pair[1]", "missing")),
        ({"many": [1]}, ("many", "needs 2 or more values, but has 1")),
        ({"many": "x" * 99}, ("many", f"'{'x' * 39}... is not a list")),
        ({"nmae": "a"}, ("nmae", "unknown key")),
    ],
)
def test_a_value_is_named_with_its_fault(tmp_path, value, expected):
    with pytest.raises(ValidationError) as caught:
        Model.model_validate(value)
    assert first_problem(caught.value) == expected
    if expected != ("pair[1]", "missing"):  # a layout states the number of values
        assert problem_in_file(tmp_path, value) == expected


def problem_in_file(folder, value):
    (folder / "file.yaml").write_text(json.dumps({"format": "keys", **value}))
    with pytest.raises(InputError) as caught:
        read_layout(folder / "file.yaml", Keys, "keys", "file")
    _, where, problem = caught.value.message.split(": ", 2)
    return where, problem


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        ({"number": True}, ("number", "true is not a number")),
        ({"number": "inf"}, ("number", "'inf' is not finite")),
        ({"pair": [640, 2.5]}, ("pair[1]", "2.5 is not a whole number")),
        ({"many": []}, ("many", "contains nothing")),
        ({"other": []}, ("other", "contains no keys")),
        ({"other": {"many": [1, {}]}}, ("other.many[1]", "{} is not a number")),
        ({"other": {"nmae": "a"}}, ("other.nmae", "unknown key")),
    ],
)
def test_a_layout_names_values_within_values(tmp_path, value, expected):
    assert problem_in_file(tmp_path, value) == expected


def test_a_layout_takes_what_people_write():
    found = keys_of(Keys)({"number": "0.5", "pair": [640.0, 480], "many": [1, 2], "other": None})
    assert found == Keys(number=0.5, pair=(640, 480), many=[1.0, 2.0])


@pytest.mark.parametrize(
    ("make", "expected"),
    [
        (lambda: {}["pose"], "pose is missing"),
        (lambda: float("far"), "'far' is not a number"),
        (lambda: int("1.5"), "'1.5' is not a number"),
        (lambda: [][0], "a value or list of another kind is expected"),
    ],
)
def test_pythons_words_are_not_passed_on(make, expected):
    with pytest.raises((KeyError, ValueError, IndexError)) as caught:
        make()
    assert plain_problem(caught.value) == expected
