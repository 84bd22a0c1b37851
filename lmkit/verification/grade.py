"""Grades A to F, line by line, in the manner of ISO/IEC 15415: the worst line decides.

Not that standard, and no claim of compliance: its symbols are black and white, its light is
calibrated.  The limits were set on simulated good prints under many lights and on planted defects
(benchmarks/prints.py), then checked on other seeds.
"""

from __future__ import annotations

from dataclasses import dataclass

from lmkit.detection.register_and_decode import Candidate
from lmkit.verification.measure import PrintMeasures

GRADES = "ABCDF"
FINE_SIDE_PX = 120.0  # below, fine lines of the print do not show in the image


@dataclass(frozen=True)
class GradedLine:
    """One line of the report.

    Attributes:
        name: what was measured.
        value: the figure, as text.
        grade: A, B, C, D, F, or None where it is not known.
        advice: what to do about it; empty for A and B.
    """

    name: str
    value: str
    grade: str | None
    advice: str


@dataclass(frozen=True)
class _Scale:
    """Limits of A, B, C and D; falling where more is better, rising where less is."""

    name: str
    limits: tuple[float, float, float, float]
    advice: str

    def line(self, value: float | None, text: str, why_unknown: str = "") -> GradedLine:
        """The line for this value; ``text`` has it in braces."""
        if value is None:
            return GradedLine(self.name, "unknown", None, why_unknown)
        text = text.format(value)
        falling = self.limits[0] > self.limits[-1]
        reached = [value >= limit if falling else value <= limit for limit in self.limits]
        grade = next((g for g, ok in zip(GRADES, reached, strict=False) if ok), "F")
        return GradedLine(self.name, text, grade, "" if grade in "AB" else self.advice)


# Log likelihood ratios that a print must reach; grade A takes five times as much.
NEEDED_CODE_MARGIN, NEEDED_TURN_MARGIN = 9.0, 24.0
DECODABILITY = _Scale("decodability", (5, 3, 2, 1), "print larger or sharper; take the image from nearer")
ROTATION = _Scale("rotation margin", (5, 3, 2, 1), "print larger or sharper; keep the triangle clean")
MODULATION = _Scale(
    "ring and gap modulation", (0.6, 0.5, 0.4, 0.25), "clean the rings; look for shine or dirt on them"
)
RED_CONTRAST = _Scale("contrast of red", (0.68, 0.6, 0.5, 0.35), "more ink: normal or best quality, fresh cartridge")
BLUE_CONTRAST = _Scale(
    "contrast of blue", (0.78, 0.68, 0.55, 0.35), "more ink: normal or best quality, fresh cartridge"
)
RED_COLOR = _Scale("color of red", (12, 17, 24, 32), "check the printer's color settings and cartridges")
BLUE_COLOR = _Scale("color of blue", (12, 17, 24, 32), "check the printer's color settings and cartridges")
EVENNESS = _Scale("evenness", (0.08, 0.14, 0.22, 0.35), "clean the print head; photograph without a screen's pattern")
MARGIN = _Scale("white margin", (0.97, 0.93, 0.85, 0.7), "leave 10 mm of white (for 180 mm) around the red border")
GLARE = _Scale("glare", (0.004, 0.015, 0.04, 0.1), "matt paper, or light from aside")
STRAIGHTNESS = _Scale(
    "border straightness", (0.002, 0.004, 0.008, 0.015), "mount it flat; lens distortion curves lines too"
)
SHARPNESS = _Scale("sharpness", (0.009, 0.014, 0.022, 0.035), "focus, hold still, or print at a higher resolution")
SCALE = _Scale("scale", (0.004, 0.008, 0.015, 0.025), "print at 100 %; or reprint with --compensate")
ASPECT = _Scale("X to Y", (0.003, 0.006, 0.012, 0.02), "reprint with --compensate WIDTHxHEIGHT as measured")
SKEW = _Scale("skew", (0.15, 0.3, 0.6, 1.2), "feed the paper straight; scan flat")
CONTENT = "content"
UNMEASURED = "C"  # of a print whose size is stated and could not be measured
UNSTATED = "B"  # of a print of which nobody says how large it should be
NOT_MEASURED = "measure with a ruler, or photograph the whole sheet (own paper size: --manifest) or a bank card"
NOT_STATED = "say how large it should be: --size 180mm, or --manifest FILE"
NOT_SCANNED = "a photograph does not show it; scan the sheet"


def grade_print(
    candidate: Candidate,
    measures: PrintMeasures,
    side_mm: tuple[float, float] | None,
    skew_deg: float | None,
    stated_mm: float | None,
    content_problem: str | None,
) -> list[GradedLine]:
    """All lines of one landmark.

    Args:
        side_mm: measured width and height, or None where nothing gives the scale.
        stated_mm: what they should be.
        content_problem: why it is not what its label or manifest says; None where it is, or where
            neither says anything.
    """
    m, decoding = measures, candidate.decoding
    fine = m.side_px >= FINE_SIDE_PX
    unseen = f"take the image from nearer: {m.side_px:.0f} px a side, {FINE_SIDE_PX:.0f} are needed"
    if fine:
        unseen = "too blurred to tell; " + SHARPNESS.advice

    def optical(scale: _Scale, value: float | None, text: str) -> GradedLine:
        return scale.line(value if fine else None, text, unseen)

    content = GradedLine(CONTENT, f"code {decoding.code} of {candidate.family.name}", "A", "")
    if candidate.rejected is not None:
        content = GradedLine(CONTENT, "unknown", None, "the reader refuses it")
    elif content_problem is not None:
        content = GradedLine(CONTENT, content_problem, "F", "do not mount it; print again")
    lines = [
        content,
        DECODABILITY.line(decoding.code_margin / NEEDED_CODE_MARGIN, "{:.1f} times what is needed"),
        ROTATION.line(decoding.turn_margin / NEEDED_TURN_MARGIN, "{:.1f} times what is needed"),
        MODULATION.line(m.modulation, "{:.2f}"),
        optical(RED_CONTRAST, m.red_contrast, "{:.2f}"),
        optical(BLUE_CONTRAST, m.blue_contrast, "{:.2f}"),
        optical(RED_COLOR, m.red_distance, "dE00 {:.0f}"),
        optical(BLUE_COLOR, m.blue_distance, "dE00 {:.0f}"),
        optical(EVENNESS, m.unevenness, "{:.2f}"),
        optical(MARGIN, m.margin_share, "{:.0%} white"),
        optical(GLARE, m.glare_share, "{:.1%} of the inks"),
        optical(STRAIGHTNESS, m.bow, "{:.2%} of the side"),
        optical(SHARPNESS, m.blur, "blur {:.2%} of the side"),
    ]
    no_scale = NOT_MEASURED if stated_mm is not None else NOT_STATED
    off = aspect = None
    if side_mm is not None:
        aspect = abs(side_mm[0] / side_mm[1] - 1)
        off = None if stated_mm is None else max(abs(length / stated_mm - 1) for length in side_mm)
    measured = "" if side_mm is None else f"{side_mm[0]:.2f} x {side_mm[1]:.2f} mm"
    if off is None and stated_mm is not None:
        # The commonest fault is "fit to page": nobody may rely on a size that was not measured.
        lines.append(GradedLine(SCALE.name, f"not measured, {stated_mm:g} mm stated", UNMEASURED, NOT_MEASURED))
    elif off is None:
        lines.append(GradedLine(SCALE.name, "unknown", UNSTATED, no_scale))
    else:
        lines.append(SCALE.line(off, f"{measured} for {stated_mm or 0:g} mm", no_scale))
    lines.append(ASPECT.line(aspect, "{:.2%} apart", "known once the scale is"))
    lines.append(SKEW.line(skew_deg, "{:.2f} deg", NOT_SCANNED))
    return lines


def overall_grade(lines: list[GradedLine]) -> str:
    """The worst of those that are known."""
    return max((line.grade for line in lines if line.grade is not None), key=GRADES.index)
