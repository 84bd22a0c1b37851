"""Values of options, read from text: noise, constraints, lengths, accuracy requirements."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from lmkit.errors import InputError
from lmkit.localization.range_bearing_noise import ReadingNoise
from lmkit.mapping.wall_constraints import Tie
from lmkit.model.landmark_id import LandmarkId
from lmkit.planning.coverage import Demand
from lmkit.units import parse_length_mm, parse_sigma


def parse_noise(range_sigma: str | None, bearing_sigma: float | None) -> ReadingNoise:
    """As given, else as of a usual camera."""
    from lmkit.localization.range_bearing_noise import ReadingNoise
    from lmkit.units import parse_length_mm

    if bearing_sigma is not None and not 0 < bearing_sigma < 90:
        raise InputError("bad_sigma", f"--bearing-sigma {bearing_sigma:g} is no angle", "give degrees, such as 1.0")
    noise = ReadingNoise()
    if range_sigma is not None and range_sigma.endswith("%"):
        noise = replace(noise, range_m=0.0, range_share=parse_share(range_sigma))
    elif range_sigma is not None:
        noise = replace(noise, range_m=parse_length_mm(range_sigma, "--range-sigma") / 1000, range_share=0.0)
    return noise if bearing_sigma is None else replace(noise, bearing_rad=math.radians(bearing_sigma))


def parse_share(text: str) -> float:
    try:
        share = float(text[:-1]) / 100
    except ValueError:
        share = 0.0
    if not 0 < share < 1:
        raise InputError(
            "bad_sigma", f"--range-sigma {text} is no share", "give a length or a share, such as 0.1m or 3%"
        )
    return share


WALL_SIGMA = "5mm,1deg"


def parse_constraints(walls: list[str], heights: list[str], sigma: str | None, families: Sequence[str]) -> list[Tie]:
    from lmkit.mapping.wall_constraints import Tie

    if sigma is not None and not walls and not heights:
        raise InputError("no_wall", "--wall-sigma needs --wall or --same-height beside it", "give --wall 12,44,137")
    spread = parse_sigma(sigma or WALL_SIGMA, "--wall-sigma", f"give a length and an angle, such as {WALL_SIGMA}")
    ties = []
    for kind, name, texts in (("wall", "--wall", walls), ("height", "--same-height", heights)):
        for text in texts:
            words = [word.strip() for word in text.split(",")]
            ids = tuple(dict.fromkeys(LandmarkId.parse(word, families) for word in words if word))
            if len(ids) < 2 or len(ids) < len(words):
                raise InputError(
                    "bad_codes", f"{name} {text} does not list two codes or more", f"write {name} 12,44,137"
                )
            ties.append(Tie(kind, ids, *spread))
    return ties


def parse_demand(error: str, heading: float, in_view: int, headings: float, share: float) -> Demand:
    from lmkit.planning.coverage import Demand

    for name, value in (("--headings", headings), ("--share", share)):
        if not 0 < value <= 100:
            raise InputError("out_of_range", f"{name} {value:g} is outside 0 to 100 %", "give percent, as in 90")
    if not 0 < heading <= 180:
        raise InputError("out_of_range", f"--heading {heading:g} is outside 0 to 180 deg", "give degrees, as in 2")
    if not 0 <= in_view <= 20:
        raise InputError("out_of_range", f"--in-view {in_view} is outside 0 to 20", "2 are usual")
    return Demand(parse_metres(error, "--error"), math.radians(heading), in_view, headings / 100, share / 100)


def parse_metres(text: str, name: str) -> float:
    return parse_length_mm(text, name) / 1000
