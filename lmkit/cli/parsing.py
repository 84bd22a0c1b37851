"""Option values read from text: noise, priors, constraints, boards, required accuracy."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from lmkit.cli.output import BOARD_HELP
from lmkit.errors import InputError
from lmkit.units import parse_length_mm, parse_sigma, parse_size_mm

if TYPE_CHECKING:
    from lmkit.localization.pose_prior import PosePrior
    from lmkit.localization.range_bearing_noise import ReadingNoise
    from lmkit.mapping.wall_constraints import LandmarkConstraint
    from lmkit.model.board import BoardSpec
    from lmkit.planning.coverage import Demand

WALL_SIGMA = "5mm,1deg"
_HEADING = re.compile(r"\s*(-?\d+(?:\.\d+)?)\s*(?:(?:\+-|±)\s*(\d+(?:\.\d+)?))?\s*")


def parse_noise(range_sigma: str | None, bearing_sigma: float | None) -> ReadingNoise:
    """Noise of range and bearing readings; defaults for missing options."""
    from lmkit.localization.range_bearing_noise import ReadingNoise

    if bearing_sigma is not None and not 0 < bearing_sigma < 90:
        raise InputError(
            "bad_sigma", f"--bearing-sigma {bearing_sigma:g} is out of range", "give degrees, such as 1.0"
        )
    noise = ReadingNoise()
    if range_sigma is not None and range_sigma.endswith("%"):
        noise = replace(noise, range_m=0.0, range_share=_share(range_sigma))
    elif range_sigma is not None:
        noise = replace(noise, range_m=parse_meters(range_sigma, "--range-sigma"), range_share=0.0)
    return noise if bearing_sigma is None else replace(noise, bearing_rad=math.radians(bearing_sigma))


def _share(text: str) -> float:
    try:
        share = float(text[:-1]) / 100
    except ValueError:
        share = 0.0
    if not 0 < share < 1:
        hint = "give a length or a percentage, such as 0.1m or 3%"
        raise InputError("bad_sigma", f"--range-sigma {text} is not a percentage between 0 and 100", hint)
    return share


def parse_prior(heading: str | None, planar: str | None) -> PosePrior | None:
    """Prior on the camera's pose from ``--heading`` (``90+-3``, degrees) and ``--planar`` (``0.42m,10``)."""
    from lmkit.localization.pose_prior import PosePrior

    if heading is None and planar is None:
        return None
    prior = PosePrior()
    if heading is not None:
        match = _HEADING.fullmatch(heading)
        if match is None or abs(float(match[1])) > 360 or (match[2] and float(match[2]) <= 0):
            hint = "give degrees from -360 to 360, such as 90 or 90+-3"
            raise InputError("bad_heading", f"--heading {heading!r} is not a valid heading", hint)
        sigma = prior.heading_sigma if match[2] is None else math.radians(float(match[2]))
        prior = replace(prior, heading_rad=math.radians(float(match[1])), heading_sigma=sigma)
    if planar is not None:
        height, _, tilt = planar.partition(",")
        down = _tilt(planar, tilt)
        height_m = parse_meters(height, "height of --planar")
        prior = replace(prior, height_m=height_m, down=(0.0, math.cos(down), math.sin(down)))
    return prior


def _tilt(planar: str, tilt: str) -> float:
    try:
        down = math.radians(float(tilt or 0))
    except ValueError:
        down = math.nan
    if not abs(down) < math.pi / 2:
        hint = "give height and tilt in degrees, such as 0.42m,10"
        raise InputError("bad_planar", f"--planar {planar!r}: {tilt!r} is not a valid tilt", hint)
    return down


def parse_constraints(
    walls: list[str], heights: list[str], sigma: str | None, families: Sequence[str]
) -> list[LandmarkConstraint]:
    """Constraints from ``--wall`` and ``--same-height``, with the standard deviations of ``--wall-sigma``."""
    from lmkit.mapping.wall_constraints import LandmarkConstraint
    from lmkit.model.landmark_id import LandmarkId

    if sigma is not None and not walls and not heights:
        raise InputError("no_wall", "--wall-sigma needs --wall or --same-height", "add --wall 12,44,137")
    spread = parse_sigma(sigma or WALL_SIGMA, "--wall-sigma", f"give a length and an angle, such as {WALL_SIGMA}")
    constraints = []
    for kind, name, texts in (("wall", "--wall", walls), ("height", "--same-height", heights)):
        for text in texts:
            words = [word.strip() for word in text.split(",")]
            ids = tuple(dict.fromkeys(LandmarkId.parse(word, families) for word in words if word))
            if len(ids) < 2 or len(ids) < len(words):
                hint = f"list each code once, such as {name} 12,44,137"
                raise InputError("bad_codes", f"{name} {text} does not list two or more codes", hint)
            constraints.append(LandmarkConstraint(kind, ids, *spread))
    return constraints


def parse_board(board: str | None, measured: str | None) -> BoardSpec:
    """The board of ``--board``, with its size as ``--measured``."""
    from lmkit.model.board import BoardSpec

    if board is None:
        raise InputError("no_board", "no board given", f"add --board. {BOARD_HELP}")
    spec = BoardSpec.parse(board)
    return spec if measured is None else spec.measured(*parse_size_mm(measured, "--measured"))


def parse_demand(error: str, heading: float, in_view: int, headings: float, share: float) -> Demand:
    """Required accuracy; ``heading`` in degrees, ``headings`` and ``share`` in percent."""
    from lmkit.planning.coverage import Demand

    for name, value in (("--headings", headings), ("--share", share)):
        if not 0 < value <= 100:
            raise InputError("out_of_range", f"{name} {value:g} is outside 0 to 100 %", "give percent, such as 90")
    if not 0 < heading <= 180:
        raise InputError("out_of_range", f"--heading {heading:g} is outside 0 to 180 deg", "give degrees, such as 2")
    if not 0 <= in_view <= 20:
        raise InputError("out_of_range", f"--in-view {in_view} is outside 0 to 20", "2 is usual")
    return Demand(parse_meters(error, "--error"), math.radians(heading), in_view, headings / 100, share / 100)


def parse_meters(text: str, name: str) -> float:
    """Meters of a length with a unit."""
    return parse_length_mm(text, name) / 1000


def require_rate(hz: float | None) -> None:
    """Refuse implausible frame rates.

    Raises:
        InputError: it is not positive, or beyond 10 kHz.
    """
    if hz is not None and not 0 < hz < 1e4:
        raise InputError("bad_rate", f"--hz {hz:g} is out of range", "give frames per second, such as 5")


def require_dpi(dpi: float) -> None:
    """Refuse implausible print resolutions.

    Raises:
        InputError: outside 1 to 4800.
    """
    if not 1 <= dpi <= 4800:
        raise InputError("bad_dpi", f"--dpi {dpi:g} is outside 1 to 4800", "300 suits most printers")
