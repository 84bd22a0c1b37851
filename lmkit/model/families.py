"""All marker families by name: ring landmarks, and the square markers of others."""

from __future__ import annotations

from lmkit.errors import InputError
from lmkit.model.landmark import FAMILIES, LandmarkFamily
from lmkit.model.square_marker import SQUARE_FAMILIES, SquareMarkerFamily

MarkerFamily = LandmarkFamily | SquareMarkerFamily
ALL_FAMILIES: dict[str, MarkerFamily] = {**FAMILIES, **SQUARE_FAMILIES}


def family_named(name: str) -> MarkerFamily:
    """The family called ``name``.

    Raises:
        InputError: there is none.
    """
    try:
        return ALL_FAMILIES[name]
    except KeyError:
        hint = f"known: {', '.join(ALL_FAMILIES)}"
        raise InputError("unknown_family", f"there is no landmark family {name!r}", hint) from None


def families_named(names: str) -> tuple[MarkerFamily, ...]:
    """The families of a list such as ``lm8,tag36h11``, in that order.

    Raises:
        InputError: one does not exist.
    """
    return tuple(dict.fromkeys(family_named(name.strip()) for name in names.split(",")))
