"""Codes and gaps (docs/landmark.md, section 3).

A word is an integer with one bit, most significant first, for each gap position of the family
(outer ring first, then inward; clockwise from the triangle's apex):
1 = gap, 0 = no gap.  A family's codes number the words that it uses.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import lru_cache

import numpy as np

from lmkit.errors import InputError

TRIANGLE_BITS = 2  # what a triangle in another quarter turn is worth


def code_to_gaps(code: int, gap_count: int) -> tuple[bool, ...]:
    """Gaps of ``code``: ``gap_count`` flags, True where the ring is open.

    Raises:
        InputError: the code does not fit into ``gap_count`` bits.
    """
    if not 0 <= code < 1 << gap_count:
        raise InputError(
            "code_range",
            f"code {code} is outside 0 to {(1 << gap_count) - 1}",
            f"choose a code from 0 to {(1 << gap_count) - 1}",
        )
    return tuple(bool(code >> (gap_count - 1 - k) & 1) for k in range(gap_count))


def gaps_to_code(gaps: Sequence[bool]) -> int:
    """Code of the gaps; the inverse of :func:`code_to_gaps`."""
    code = 0
    for gap in gaps:
        code = code << 1 | int(gap)
    return code


def turned_word(word: int, gap_counts: Sequence[int], quarters: int) -> int:
    """Word of a landmark that is rotated clockwise by quarter turns, read as if it were upright."""
    gaps = list(code_to_gaps(word, sum(gap_counts)))
    turned: list[bool] = []
    for count in gap_counts:
        ring, gaps = gaps[:count], gaps[count:]
        shift = quarters * count // 4
        turned += ring[count - shift :] + ring[: count - shift]
    return gaps_to_code(turned)


@lru_cache(maxsize=8)
def codewords(gap_counts: tuple[int, ...], distance: int) -> tuple[int, ...]:
    """Words that differ in ``distance`` bits at least, chosen greedily in rising order (a lexicode).

    In other quarter turns the triangle differs too, which counts for ``TRIANGLE_BITS``, and a word
    must differ from its own turns as well.
    """
    words = np.arange(1 << sum(gap_counts))
    ones = np.array([word.bit_count() for word in words.tolist()])
    free = np.ones(len(words), dtype=bool)
    chosen = []
    for word in words.tolist():
        turns = [turned_word(word, gap_counts, quarter) for quarter in range(4)] if free[word] else []
        if not turns or any((word ^ t).bit_count() + TRIANGLE_BITS < distance for t in turns[1:]):
            continue
        chosen.append(word)
        for quarter, turned in enumerate(turns):
            differing = ones[words ^ turned] + (TRIANGLE_BITS if quarter else 0)
            free &= differing >= distance
    return tuple(chosen)


def parse_codes(text: str, code_count: int) -> list[int]:
    """Read ``0-15,42`` into ``[0, ..., 15, 42]``, in the order written, without repeats.

    Raises:
        InputError: not a number or range, a range that runs backwards, or a code that the family
            does not have.
    """
    hint = f"write codes from 0 to {code_count - 1} as in 0-15,42"
    codes: dict[int, None] = {}
    for part in text.split(","):
        first, dash, last = (piece.strip() for piece in part.partition("-"))
        if not first.isdecimal() or (dash and not last.isdecimal()):
            raise InputError("bad_codes", f"{part.strip()!r} in codes {text!r} is not a code or range", hint)
        low, high = int(first), int(last) if dash else int(first)
        if high < low:
            raise InputError(
                "bad_codes", f"range {part.strip()} in codes {text!r} runs backwards", f"write {high}-{low}"
            )
        if high >= code_count:
            raise InputError("code_range", f"code {high} is outside 0 to {code_count - 1}", hint)
        codes.update(dict.fromkeys(range(low, high + 1)))
    return list(codes)


def format_codes(codes: Iterable[int]) -> str:
    """Codes in their shortest written form, e.g. ``0-15,42``; the inverse of :func:`parse_codes`."""
    runs: list[list[int]] = []
    for code in codes:
        if runs and code == runs[-1][1] + 1:
            runs[-1][1] = code
        else:
            runs.append([code, code])
    return ",".join(str(a) if a == b else f"{a}-{b}" for a, b in runs)
