"""Ids of landmarks: as text, in order, and bare codes only if there is one family."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lmkit.errors import InputError
from lmkit.model.families import ALL_FAMILIES
from lmkit.model.landmark_id import LandmarkId, ids_text

NAMES = st.from_regex(r"[a-z][a-z0-9]{0,7}(_[0-9]{1,3})?", fullmatch=True).filter(
    lambda name: name not in ALL_FAMILIES
)
IDS = st.builds(LandmarkId, NAMES, st.integers(0, 10**9 - 1))


@given(IDS)
def test_what_is_written_reads_back(id_):
    assert LandmarkId.parse(str(id_)) == id_


@given(IDS)
def test_a_bare_code_is_of_the_only_family(id_):
    assert LandmarkId.parse(str(id_.code), [id_.family, id_.family]) == id_


@pytest.mark.parametrize("families", [(), ("lm8", "lm12")])
def test_a_bare_code_needs_one_family(families):
    with pytest.raises(InputError, match="without its family"):
        LandmarkId.parse("5", families)


@pytest.mark.parametrize("text", ["", ":", "lm8:", ":5", "lm8:x", "x", "-1", "1.5", "lm8:-1", "9" * 10])
def test_what_is_no_id_is_refused(text):
    with pytest.raises(InputError, match="not a landmark id"):
        LandmarkId.parse(text, ["lm8"])


@pytest.mark.parametrize("family", ["lm8", "aruco4x4_50"])
def test_a_code_that_the_family_does_not_have_is_refused(family):
    last = ALL_FAMILIES[family].code_count - 1
    assert LandmarkId.parse(str(last), [family]) == LandmarkId(family, last)
    with pytest.raises(ValueError, match=f"{family} has no code {last + 1}: its codes are 0 to {last}"):
        LandmarkId(family, last + 1)
    with pytest.raises(InputError, match=f"{family} has no code {last + 1}"):
        LandmarkId.parse(f"{family}:{last + 1}")


def test_sentences_name_the_family_only_where_there_are_several():
    assert ids_text([LandmarkId("lm8", 3), LandmarkId("lm8", 12)]) == "3, 12"
    assert ids_text([LandmarkId("lm8", 3), LandmarkId("lm12", 3)]) == "lm8:3, lm12:3"
