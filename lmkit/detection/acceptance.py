"""Thresholds that decide whether a decoded square is a landmark."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class AcceptanceRule:
    """Thresholds for a square to be called a landmark; each figure is argued in docs/landmark.md, section 6.

    Attributes:
        turn_margin: least log likelihood ratio against any other quarter turn; 8 bits hold no
            redundancy, so this is what tells a landmark from a square with something in it.
        code_margin: least log likelihood ratio against any other code.
        parts_misfit: most that triangle, rings and gaps may differ from the blue or white that the code
            says, as a mean square in standard deviations.
        red_over_blue: least colour difference of border and ground (log ratio).
        white_over_ground: (least, most) ratio of brightness; no paint and paper exceed the latter.
        part_deviation: most that the triangle's and the rings' white may differ from the margin's.
        part_overshoot: no part may be darker than blue or brighter than white by more of their difference.
        part_sigma: a part must be known at least this well.
        hidden: most that the misfit around one gap position may exceed the usual one; beyond, something
            lies over it.
        plain_code_factor: codes that look alike in every quarter turn (rings all closed or all open)
            are what road signs and logos resemble; they need this many times the turn margin.
        plain_parts_misfit: most that the parts of such codes may differ.
    """

    turn_margin: float = 24.0
    code_margin: float = 9.0
    parts_misfit: float = 1.35
    red_over_blue: float = 0.4
    white_over_ground: tuple[float, float] = (2.2, 40.0)
    part_deviation: float = 0.3
    part_overshoot: float = 0.5
    part_sigma: float = 0.25
    hidden: float = 6.5
    plain_code_factor: float = 2.0
    plain_parts_misfit: float = 0.9
