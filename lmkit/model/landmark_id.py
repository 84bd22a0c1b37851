"""The identity of a landmark: its family and its code."""

from __future__ import annotations

import operator
from collections.abc import Sequence
from typing import NamedTuple

from lmkit.errors import InputError
from lmkit.model.families import ALL_FAMILIES


class _FamilyAndCode(NamedTuple):
    family: str
    code: int


class LandmarkId(_FamilyAndCode):
    """A landmark's family and code, written ``lm8:137``.

    Codes of different families are different landmarks.  Ids sort by family, then by code.

    Raises:
        TypeError: the family is no text, or the code no whole number.
        ValueError: the code is negative, or one that the family does not have; families of others may have any.

    Examples:
        >>> import lmkit
        >>> str(lmkit.LandmarkId("lm8", 137))
        'lm8:137'
        >>> lmkit.LandmarkId.parse("lm12:5")
        LandmarkId('lm12', 5)
    """

    __slots__ = ()

    def __new__(cls, family: str, code: int) -> LandmarkId:
        """Take any whole number as the code, also numpy's."""
        if not isinstance(family, str):
            raise TypeError(
                f"the family of a landmark id must be text, such as LandmarkId('lm8', 137), not {family!r}"
            )
        try:
            number = operator.index(code)
        except TypeError:
            hint = "such as LandmarkId('lm8', 137); read text with LandmarkId.parse('lm8:137')"
            raise TypeError(f"the code of a landmark id must be a whole number, not {code!r}, {hint}") from None
        if number < 0:
            raise ValueError(f"the code of a landmark id must be 0 or more, not {number}")
        known = ALL_FAMILIES.get(family)
        if known is not None and number >= known.code_count:
            raise ValueError(f"family {family} has no code {number}: its codes are 0 to {known.code_count - 1}")
        return super().__new__(cls, family, number)

    def __str__(self) -> str:
        return f"{self.family}:{self.code}"

    def __repr__(self) -> str:
        return f"LandmarkId({self.family!r}, {self.code})"

    @classmethod
    def parse(cls, text: str, families: Sequence[str] = ()) -> LandmarkId:
        """Read ``lm8:137``, or a bare ``137`` where there is only one family it can belong to.

        Args:
            families: families in play, for a bare code.

        Raises:
            InputError: not an id, a code that the family does not have, or a bare code with several families in play.
        """
        if not isinstance(text, str):
            raise InputError("bad_id", f"{text!r} is not a landmark id", "write FAMILY:CODE, such as lm8:137")
        family, colon, code = text.strip().rpartition(":")
        if not code.isdecimal() or len(code) > 9 or bool(colon) != bool(family):
            raise InputError("bad_id", f"{text!r} is not a landmark id", "write FAMILY:CODE, such as lm8:137")
        known = (family,) if family else tuple(dict.fromkeys(families))
        if len(known) != 1:
            several = ", ".join(f"{name}:{code}" for name in known) or f"lm8:{code}"
            raise InputError(
                "no_family",
                f"code {code} is without its family",
                f"write it with its family: {several}",
            )
        try:
            return cls(known[0], int(code))
        except ValueError as error:
            raise InputError("code_range", str(error), "check the code, and the family") from None


def ids_text(ids: Sequence[LandmarkId]) -> str:
    """Ids as words for a sentence: bare codes where all are of one family, ``lm8:137`` otherwise."""
    if len({i.family for i in ids}) <= 1:
        return ", ".join(str(i.code) for i in ids)
    return ", ".join(map(str, ids))
