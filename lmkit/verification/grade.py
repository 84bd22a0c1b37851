"""Grades A to F, line by line, similar to ISO/IEC 15415: the worst line decides.

It is not ISO/IEC 15415, which needs calibrated light, and claims no compliance.  The limits were set on simulated
good prints under many lights and on planted defects (benchmarks/prints.py), then checked on other seeds.
"""

from __future__ import annotations

from dataclasses import dataclass

from lmkit.detection.register_and_decode import Candidate
from lmkit.detection.tag_registration import TagCandidate, TagRule
from lmkit.verification.flat_print import FINE_SIDE_PX
from lmkit.verification.measure import PrintMeasures
from lmkit.verification.measure_tag import TagPrintMeasures

GRADES = "ABCDF"


@dataclass(frozen=True)
class GradedLine:
    """One line of the report.

    Attributes:
        name: name of the measured property.
        value: the value, as text.
        grade: A, B, C, D, F, or None if it is not known.
        advice: how to improve it; empty for A and B.
    """

    name: str
    value: str
    grade: str | None
    advice: str


@dataclass(frozen=True)
class _Scale:
    """Limits of A, B, C and D; decreasing if larger values are better, increasing if smaller ones are."""

    name: str
    limits: tuple[float, float, float, float]
    advice: str

    def line(self, value: float | None, text: str, why_unknown: str = "") -> GradedLine:
        """The line for this value; ``text`` contains the value in braces."""
        if value is None:
            return GradedLine(self.name, "unknown", None, why_unknown)
        text = text.format(value)
        falling = self.limits[0] > self.limits[-1]
        reached = [value >= limit if falling else value <= limit for limit in self.limits]
        grade = next((g for g, ok in zip(GRADES, reached, strict=False) if ok), "F")
        return GradedLine(self.name, text, grade, "" if grade in "AB" else self.advice)


# Log likelihood ratios that a print must reach; grade A requires five times as much.
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
# Every pixel contributes to every cell, so the margin grows with the number of pixels, not with the size.
TAG_DECODABILITY = _Scale(DECODABILITY.name, (2.0, 1.6, 1.3, 1.0), DECODABILITY.advice)
CELLS = _Scale("modulation of cells", (0.6, 0.5, 0.4, 0.25), "clean the cells; look for shine or dirt on them")
BLACK_CONTRAST = _Scale(
    "contrast of black", (0.78, 0.68, 0.55, 0.35), "more ink: normal or best quality, fresh cartridge"
)
QUIET_ZONE = _Scale(MARGIN.name, MARGIN.limits, "leave one cell of white around the black border")
GLARE = _Scale("glare", (0.004, 0.015, 0.04, 0.1), "matt paper, or light from aside")
STRAIGHTNESS = _Scale(
    "border straightness", (0.002, 0.004, 0.008, 0.015), "mount it flat; lens distortion curves lines too"
)
SHARPNESS = _Scale("sharpness", (0.009, 0.014, 0.022, 0.035), "focus, hold still, or print at a higher resolution")
SCALE = _Scale("scale", (0.004, 0.008, 0.015, 0.025), "print at 100 %; or reprint with --compensate")
ASPECT = _Scale("X to Y", (0.003, 0.006, 0.012, 0.02), "reprint with --compensate WIDTHxHEIGHT as measured")
SKEW = _Scale("skew", (0.15, 0.3, 0.6, 1.2), "feed the paper straight; scan flat")
CONTENT = "content"
UNMEASURED = "C"  # grade of a print whose size is stated and could not be measured
UNSTATED = "B"  # grade of a print without a stated size
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
    """All lines of one ring landmark.

    Args:
        side_mm: measured width and height, or None if the scale is unknown.
        stated_mm: nominal width and height.
        content_problem: how it differs from its label or manifest; None if it agrees, or if
            there is neither.
    """
    m, decoding = measures, candidate.decoding
    optical = _Optical(m.side_px)
    lines = [
        _content(candidate, content_problem),
        DECODABILITY.line(decoding.code_margin / NEEDED_CODE_MARGIN, "{:.1f} times what is needed"),
        ROTATION.line(decoding.turn_margin / NEEDED_TURN_MARGIN, "{:.1f} times what is needed"),
        MODULATION.line(m.modulation, "{:.2f}"),
        optical.line(RED_CONTRAST, m.red_contrast, "{:.2f}"),
        optical.line(BLUE_CONTRAST, m.blue_contrast, "{:.2f}"),
        optical.line(RED_COLOR, m.red_distance, "dE00 {:.0f}"),
        optical.line(BLUE_COLOR, m.blue_distance, "dE00 {:.0f}"),
        optical.line(MARGIN, m.margin_share, "{:.0%} white"),
    ]
    return lines + _of_any_print(optical, m) + _scale_lines(side_mm, skew_deg, stated_mm)


def grade_tag(
    candidate: TagCandidate,
    measures: TagPrintMeasures,
    side_mm: tuple[float, float] | None,
    skew_deg: float | None,
    stated_mm: float | None,
    content_problem: str | None,
) -> list[GradedLine]:
    """All lines of one square marker; arguments as for :func:`grade_print`."""
    m, optical = measures, _Optical(measures.side_px)
    needed = TagRule.of(candidate.family).margin
    lines = [
        _content(candidate, content_problem),
        TAG_DECODABILITY.line(candidate.decoding.margin / needed, "{:.1f} times what is needed"),
        CELLS.line(m.modulation, "{:.2f}"),
        optical.line(BLACK_CONTRAST, m.contrast, "{:.2f}"),
        optical.line(QUIET_ZONE, m.margin_share, "{:.0%} white"),
    ]
    return lines + _of_any_print(optical, m) + _scale_lines(side_mm, skew_deg, stated_mm)


@dataclass(frozen=True)
class _Optical:
    """Lines that need a close image."""

    side_px: float

    def line(self, scale: _Scale, value: float | None, text: str) -> GradedLine:
        if self.side_px >= FINE_SIDE_PX:
            return scale.line(value, text, "too blurred to tell; " + SHARPNESS.advice)
        unseen = f"take the image from nearer: {self.side_px:.0f} px a side, {FINE_SIDE_PX:.0f} are needed"
        return scale.line(None, text, unseen)


def _content(candidate: Candidate | TagCandidate, problem: str | None) -> GradedLine:
    if candidate.rejected is not None:
        return GradedLine(CONTENT, "unknown", None, "the reader refuses it")
    if problem is not None:
        return GradedLine(CONTENT, problem, "F", "do not mount it; print again")
    return GradedLine(CONTENT, f"code {candidate.decoding.code} of {candidate.family.name}", "A", "")


def _of_any_print(optical: _Optical, m: PrintMeasures | TagPrintMeasures) -> list[GradedLine]:
    return [
        optical.line(EVENNESS, m.unevenness, "{:.2f}"),
        optical.line(GLARE, m.glare_share, "{:.1%} of the inks"),
        optical.line(STRAIGHTNESS, m.bow, "{:.2%} of the side"),
        optical.line(SHARPNESS, m.blur, "blur {:.2%} of the side"),
    ]


def _scale_lines(
    side_mm: tuple[float, float] | None, skew_deg: float | None, stated_mm: float | None
) -> list[GradedLine]:
    no_scale = NOT_MEASURED if stated_mm is not None else NOT_STATED
    off = aspect = None
    if side_mm is not None:
        aspect = abs(side_mm[0] / side_mm[1] - 1)
        off = None if stated_mm is None else max(abs(length / stated_mm - 1) for length in side_mm)
    if off is None and stated_mm is not None:
        # The most common fault is "fit to page", so an unmeasured size is not reliable.
        scale = GradedLine(SCALE.name, f"not measured, {stated_mm:g} mm stated", UNMEASURED, NOT_MEASURED)
    elif off is None or side_mm is None:
        scale = GradedLine(SCALE.name, "unknown", UNSTATED, no_scale)
    else:
        measured = f"{side_mm[0]:.2f} x {side_mm[1]:.2f} mm"
        scale = SCALE.line(off, f"{measured} for {stated_mm or 0:g} mm", no_scale)
    return [
        scale,
        ASPECT.line(aspect, "{:.2%} apart", "needs the scale"),
        SKEW.line(skew_deg, "{:.2f} deg", NOT_SCANNED),
    ]


def overall_grade(lines: list[GradedLine]) -> str:
    """The worst of the known grades."""
    return max((line.grade for line in lines if line.grade is not None), key=GRADES.index)
