"""The dials of detection: which landmarks, how hard to look, what to accept, through which lens."""

from __future__ import annotations

from dataclasses import dataclass, field

from lmkit.detection.acceptance import AcceptanceRule
from lmkit.detection.candidates import FAST_SOURCES, SOURCES, Source
from lmkit.detection.pixel_sampling import MAX_PIXELS
from lmkit.detection.screening import ALIGNED_THRESHOLDS, ScreeningThresholds
from lmkit.geometry.camera import CameraModel
from lmkit.model.landmark import LM8, LandmarkFamily


@dataclass(frozen=True)
class Effort:
    """How hard to look.

    Attributes:
        sources: where squares come from.
        min_pattern: candidates whose pattern explains less than this share are not aligned.
        max_aligned: at most so many are, best first.
        look: what a candidate must show once aligned.
        min_aligned_pattern: those that explain less than this once aligned are not registered.
        max_registered: at most so many are, best first; bounds the time on cluttered pictures.
        pixels: of one landmark that are registered; more bring better corners.
        in_shadow: look again, with the light taken out, where a shadow may end on a landmark.
    """

    sources: tuple[Source, ...] = SOURCES
    min_pattern: float = 0.04
    max_aligned: int = 100
    look: ScreeningThresholds = ALIGNED_THRESHOLDS
    min_aligned_pattern: float = 0.2
    max_registered: int = 24
    pixels: int = MAX_PIXELS
    in_shadow: bool = True


FAR = Effort()
FAST = Effort(sources=FAST_SOURCES, max_aligned=40, max_registered=12, pixels=500, in_shadow=False)


@dataclass(frozen=True)
class DetectOptions:
    """The few dials of detection.

    Attributes:
        families: which landmarks to look for; no two may share a drawing.
        effort: ``FAR`` reads what can be read, ``FAST`` gives up small and shaded landmarks for speed.
        rule: what a landmark must show.
        through_lens: the picture comes through a lens, so straight edges may be bent; off for scans and
            rasterised pages.
        camera: the camera that took the picture, if it is calibrated: its own distortion then takes the
            place of a guessed bend.
    """

    families: tuple[LandmarkFamily, ...] = (LM8,)
    effort: Effort = FAR
    rule: AcceptanceRule = field(default_factory=AcceptanceRule)
    through_lens: bool = True
    camera: CameraModel | None = None
