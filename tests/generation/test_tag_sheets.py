"""Words on the sheets of each kind of marker."""

from __future__ import annotations

import pytest

from lmkit.generation.page import Text
from lmkit.generation.sheet import compose_sheets
from lmkit.io.template import load_template, shipped_templates
from lmkit.model.families import family_named


@pytest.mark.parametrize(
    ("name", "says", "never"),
    [("lm8", ("red border", "Print in color", "triangle"), ()), ("tag36h11", ("black border",), ("red", "triangle"))],
)
def test_a_sheet_describes_its_own_marker(name, says, never):
    (page,) = compose_sheets(family_named(name), [5], load_template("a4"))
    words = " ".join(item.content for item in page.items if isinstance(item, Text))
    assert all(word in words for word in says)
    assert not any(word in words for word in never)


@pytest.mark.parametrize("template", shipped_templates())
def test_no_template_calls_a_black_border_red(template):
    for page in compose_sheets(family_named("tag36h11"), [5], load_template(template)):
        assert not any("red" in item.content.split() for item in page.items if isinstance(item, Text))
