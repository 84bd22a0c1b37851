"""Settings of detection: families, thoroughness, acceptance and lens."""

from __future__ import annotations

from dataclasses import dataclass

from lmkit.detection.acceptance import DEFAULT, AcceptanceRule
from lmkit.detection.candidates import Source, WhereToLook
from lmkit.detection.screening import ALIGNED_THRESHOLDS, ScreeningThresholds
from lmkit.geometry.camera import CameraModel
from lmkit.model.families import MarkerFamily
from lmkit.model.landmark import LM8, LandmarkFamily
from lmkit.model.square_marker import SquareMarkerFamily

GRAY = Source("gray", 1, 5, 0.01)
COARSE = Source("gray", 2, 5, 0.01)  # where edges are blurred over many pixels
FINE = Source("gray", 0, 5, 0.0)
# All that is no bright line counts as dark: the square stays whole before dark walls, and its margin around it
# (decision 56); before light walls margins are no lines (decision 60).
FINE_LINES = Source("gray", 0, 5, -0.02)
RED = Source("red", 1, 5, -0.03)
# The full image is searched where there is more contrast: a sixth of its time, and 1 of 254 landmarks on simulated
# images that no other search finds.
WHERE = WhereToLook(ratio=0.15, luma=0.2, fine_ratio=0.2, fine_luma=0.3)


@dataclass(frozen=True)
class DetectorConfig:
    """Thoroughness of detection; the profiles ``fast``, ``balanced`` and ``accurate`` are such configurations.

    Attributes:
        sources: images in which squares are searched; each costs a pass over the image, and more find more
            blurred, small or faded landmarks.
        where: parts of the image that are searched.
        min_pattern: share of the brightness that the pattern must explain before a candidate is aligned.
        align_rounds: steps of the alignment of one candidate.
        aligned: thresholds of an aligned candidate.
        min_aligned_pattern: share that the pattern must explain before a candidate is registered.
        shaded_pattern, shaded_aligned_pattern: the same two shares in the shadow-normalized image, which has
            patterns at edges of all kinds; landmarks have larger shares.
        pixels: number of registered pixels of one landmark; more pixels take more time and give better corners.
        in_shadow: search again in the shadow-normalized image if a shadow may end on a landmark.

    Examples:
        >>> from dataclasses import replace
        >>> import lmkit
        >>> config = replace(lmkit.DetectorConfig(), pixels=2000, in_shadow=False)
        >>> [d.id for d in lmkit.Detector(profile=config).detect("left.png")][:1]
        [LandmarkId('lm8', ...)]
    """

    sources: tuple[Source, ...] = (GRAY, COARSE, FINE)
    where: WhereToLook = WHERE
    min_pattern: float = 0.04
    align_rounds: int = 5
    aligned: ScreeningThresholds = ALIGNED_THRESHOLDS
    min_aligned_pattern: float = 0.12
    shaded_pattern: float = 0.08
    shaded_aligned_pattern: float = 0.18
    pixels: int = 1000
    in_shadow: bool = True


BALANCED = DetectorConfig()
ACCURATE = DetectorConfig(sources=(GRAY, COARSE, RED, FINE, FINE_LINES), pixels=1500)
FAST = DetectorConfig(sources=(GRAY, COARSE), align_rounds=3, pixels=600, in_shadow=False)
PROFILES = {"fast": FAST, "balanced": BALANCED, "accurate": ACCURATE}


@dataclass(frozen=True)
class DetectOptions:
    """Options of detection.

    Attributes:
        families: families to detect; no two may share a drawing.
        config: thoroughness; see :data:`PROFILES`.
        rule: least score of a landmark; see :data:`lmkit.detection.acceptance.STRICTNESSES`.
        through_lens: the image comes through a lens, so straight edges may be curved; off for scans and
            rasterized pages.
        camera: the camera that took the image, if it is calibrated: its own distortion then takes the
            place of a guessed distortion.
        inverted_tags: also read square markers in white on black.
    """

    families: tuple[MarkerFamily, ...] = (LM8,)
    config: DetectorConfig = BALANCED
    rule: AcceptanceRule = DEFAULT
    through_lens: bool = True
    camera: CameraModel | None = None
    inverted_tags: bool = False

    @property
    def ring_families(self) -> tuple[LandmarkFamily, ...]:
        """Families recognized by their colors."""
        return tuple(family for family in self.families if isinstance(family, LandmarkFamily))

    @property
    def square_families(self) -> tuple[SquareMarkerFamily, ...]:
        """Families of black and white cells; gray images do."""
        return tuple(family for family in self.families if isinstance(family, SquareMarkerFamily))
