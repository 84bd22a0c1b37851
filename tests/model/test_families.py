"""The families: their codewords, and the distances between these."""

from __future__ import annotations

import hashlib
from itertools import product

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lmkit.errors import InputError
from lmkit.model.codewords import TRIANGLE_BITS, turned_word
from lmkit.model.families import families_named
from lmkit.model.landmark import FAMILIES, LM4, LM8, LM8P, LM12, LM12H4

SUMS = {
    "lm4": "f564ce1656cb",
    "lm8": "84eb81ef573c",
    "lm8p": "e456ac4eda0e",
    "lm12": "3dc7633cbd29",
    "lm12h4": "8925c5462f99",
}


def test_the_words_stay_what_was_printed():
    """Prints are used longer than software: these checksums may never change."""
    sums = {name: hashlib.sha256(repr(family.words).encode()).hexdigest()[:12] for name, family in FAMILIES.items()}
    assert sums == SUMS


def test_how_many_codes_there_are():
    counts = {family.name: family.code_count for family in FAMILIES.values()}
    assert counts == {"lm4": 16, "lm8": 256, "lm8p": 128, "lm12": 184, "lm12h4": 128}
    assert LM8.words == tuple(range(256))
    assert LM4.words == tuple(range(16))


def test_even_parity_is_seven_bits_and_their_sum():
    for code, word in enumerate(LM8P.words):
        assert word == code << 1 | code.bit_count() % 2


@pytest.mark.parametrize("family", [LM8P, LM12, LM12H4], ids=lambda f: f.name)
def test_codes_differ_in_every_quarter_turn(family):
    counts = tuple(ring.gap_count for ring in family.rings)
    turned = [[turned_word(word, counts, quarter) for word in family.words] for quarter in range(4)]
    for (a, word), quarter in product(enumerate(family.words), range(4)):
        for b, other in enumerate(turned[quarter]):
            if a == b and quarter == 0:
                continue
            assert (word ^ other).bit_count() + (TRIANGLE_BITS if quarter else 0) >= family.distance


@given(st.sampled_from(list(FAMILIES.values())), st.integers(0, 3), st.integers(0, 1 << 12))
def test_four_quarter_turns_are_none(family, quarter, word):
    counts = tuple(ring.gap_count for ring in family.rings)
    word %= 1 << sum(counts)
    assert turned_word(turned_word(word, counts, quarter), counts, (4 - quarter) % 4) == word


def test_a_turned_landmark_shows_the_turned_word():
    # lm8: one gap, outer ring at the top; turned clockwise it is seen at the right.
    assert turned_word(0b10000000, (4, 4), 1) == 0b01000000
    assert turned_word(0b00001000, (4, 4), 1) == 0b00000100


@pytest.mark.parametrize("family", FAMILIES.values(), ids=lambda f: f.name)
def test_codes_outside_a_family_are_refused(family):
    assert len(family.gaps(family.code_count - 1)) == family.gap_count
    for code in (-1, family.code_count):
        with pytest.raises(InputError, match=rf"0 to {family.code_count - 1} of family {family.name}"):
            family.gaps(code)


def test_families_by_name():
    assert families_named("lm8, lm4,lm8") == (LM8, LM4)
    with pytest.raises(InputError, match="no landmark family 'lm9'"):
        families_named("lm8,lm9")
    assert LM8.is_drawn_like(LM8P)
    assert not LM8.is_drawn_like(LM8)
    assert not LM8.is_drawn_like(LM12)
