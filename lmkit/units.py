"""Lengths as people write them (``180mm``, ``7.1in``), and the units lmkit converts between."""

from __future__ import annotations

import math
import re

from lmkit.errors import InputError

MM_PER_UNIT = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "in": 25.4, "pt": 25.4 / 72.0}
POINTS_PER_MM = 72.0 / 25.4
MM_PER_INCH = 25.4
NANOSECONDS_FROM = 1e17  # seconds since 1970 pass this in three billion years, nanoseconds did in 1973

UNITS_PER_METER = {1000.0: "millimeters", 100.0: "centimeters", 39.37: "inches", 3.281: "feet"}
LIKE_UNIT = 0.12  # logarithm of a ratio to that of a unit

_LENGTH = re.compile(r"\s*([0-9]+(?:\.[0-9]*)?|\.[0-9]+)\s*([a-z]*)\s*", re.IGNORECASE)


def counted(count: int, noun: str) -> str:
    """A number of things in words: ``1 warning``, ``2 warnings``."""
    return f"{count} {noun}{'' if count == 1 else 's'}"


def length_text(meters: float) -> str:
    """A length to two digits in the unit that shows it: ``3.4 mm``, ``4.2 cm``, ``1.30 m``."""
    if meters < 0.00995:
        return f"{1000 * meters:.1f} mm"
    return f"{100 * meters:.2g} cm" if meters < 0.995 else f"{meters:.2f} m"


def parse_length_mm(text: str, what: str = "length") -> float:
    """Read a positive length such as ``180mm``, ``18 cm``, ``7.09in``; returns millimeters.

    Args:
        text: number and unit; the unit is required, since a bare number is how prints come out
            25.4 times too small.
        what: the name of the value in error messages.

    Raises:
        InputError: no number, no known unit, or not positive.
    """
    match = _LENGTH.fullmatch(text)
    unit = match.group(2).lower() if match else ""
    if match is None or unit not in MM_PER_UNIT:
        raise InputError(
            "bad_length",
            f"{what} {text!r} is not a length",
            f"write a number with a unit, such as 180mm; units: {', '.join(MM_PER_UNIT)}",
        )
    value = float(match.group(1)) * MM_PER_UNIT[unit]
    if not math.isfinite(value) or value <= 0:
        raise InputError("bad_length", f"{what} {text!r} is not positive", "give a length above 0")
    return value


def parse_size_mm(text: str, what: str = "size") -> tuple[float, float]:
    """Read a width and a height such as ``249.1x174.4mm``; returns millimeters.

    Raises:
        InputError: not two lengths; the unit may follow the height alone.
    """
    width, separator, height = text.lower().partition("x")
    if not separator:
        raise InputError("bad_size", f"{what} {text!r} is not WIDTHxHEIGHT", "write for example 249.1x174.4mm")
    unit = height.strip().lstrip("0123456789. ")
    if not width.strip().endswith(tuple(MM_PER_UNIT)):
        width += unit
    return parse_length_mm(width, what), parse_length_mm(height, what)


def parse_sigma(text: str, name: str, hint: str) -> tuple[float, float]:
    """Meters and rad of a length and an angle."""
    length, _, angle = text.partition(",")
    try:
        degrees = float(angle.strip().removesuffix("deg"))
    except ValueError:
        raise InputError("bad_sigma", f"{name} {text} has no valid angle", hint) from None
    meters = parse_length_mm(length.strip(), name) / 1000
    if not (meters > 0 and 0 < degrees < 180):
        raise InputError("bad_sigma", f"{name} {text} is not positive", hint)
    return meters, math.radians(degrees)


def parse_two_lengths_mm(text: str, what: str) -> tuple[float, float]:
    """``178.6x179.4``, or one number for both; millimeters unless a unit says otherwise."""
    pieces = text.lower().split("x")
    if len(pieces) not in (1, 2):
        raise InputError("bad_length", f"{what} {text!r} is not WIDTHxHEIGHT", "write for example 178.6x179.4 (mm)")
    lengths = [parse_length_mm(p if p.strip()[-1:].isalpha() else f"{p}mm", what) for p in pieces]
    return lengths[0], lengths[-1]


def unit_of_ratio(ratio: float) -> str:
    """Question that names the unit in which a length is that many times too large; empty where none is."""
    for factor, name in UNITS_PER_METER.items():
        if abs(math.log(ratio / factor)) < LIKE_UNIT:
            return f" (is it in {name}?)"
    return ""
