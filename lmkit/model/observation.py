"""Observations: landmarks, calibration boards, range and bearing readings."""

from __future__ import annotations

from dataclasses import dataclass

from lmkit.arrays import FloatArray, IntArray, frozen
from lmkit.geometry.homography import crossing
from lmkit.model.landmark_id import LandmarkId


@dataclass(frozen=True, eq=False)
class Detection:
    """One landmark read in one image.

    Attributes:
        id: family and code, as read.
        corners: (4,2) outer corners of the border, pixels of the image as delivered; the
            landmark's top left first, then clockwise as the landmark stands.
        confidence: probability that the code is right, 0..1.
        margin: log likelihood ratio of this code in this rotation against the runner-up.
        covariance: (8,8) of the corners x0 y0 x1 y1 ..., pixels squared, if estimated.

    Raises:
        TypeError: the id is no LandmarkId.
        ValueError: an array has another shape, or values that are not finite; the confidence is no probability.

    Examples:
        >>> import lmkit
        >>> corners = [[100, 100], [150, 100], [150, 150], [100, 150]]
        >>> lmkit.Detection(lmkit.LandmarkId("lm8", 137), corners, confidence=0.99, margin=20.0).center.tolist()
        [125.0, 125.0]
    """

    id: LandmarkId
    corners: FloatArray
    confidence: float
    margin: float
    covariance: FloatArray | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.id, LandmarkId):
            raise TypeError(f"id of a Detection must be a LandmarkId, as LandmarkId('lm8', 137), not {self.id!r}")
        object.__setattr__(self, "corners", frozen(self.corners, (4, 2), "corners"))
        if not 0 <= self.confidence <= 1:
            raise ValueError(f"confidence of {self.id} is {self.confidence!r}, outside 0 to 1")
        if self.covariance is not None:
            object.__setattr__(self, "covariance", frozen(self.covariance, (8, 8), "covariance"))

    @property
    def code(self) -> int:
        """The code, without the family."""
        return self.id.code

    @property
    def family(self) -> str:
        """Name of the landmark family."""
        return self.id.family

    @property
    def center(self) -> FloatArray:
        """(2,) the landmark's center in the image: the intersection of its diagonals."""
        return crossing(self.corners[0], self.corners[2], self.corners[1], self.corners[3])

    def __repr__(self) -> str:
        x, y = self.center
        return f"Detection({self.id}, center {x:.1f} {y:.1f} px, confidence {self.confidence:.4f})"

    def to_dict(self) -> dict[str, object]:
        """One entry of ``detections`` in `lmkit detect --json`."""
        return {
            "id": str(self.id),
            "code": self.code,
            "family": self.family,
            "corners": self.corners.tolist(),
            "center": self.center.tolist(),
            "confidence": self.confidence,
            "margin": self.margin,
        }


@dataclass(frozen=True, eq=False)
class BoardObservation:
    """A calibration board seen in one image.

    Attributes:
        ids: (N,) indices of the board's corners (rows of ``BoardSpec.object_points``).
        image_points: (N,2) those corners in pixels.
        noise_px: standard deviation of one coordinate, if estimated.
    """

    ids: IntArray
    image_points: FloatArray
    noise_px: float | None = None


@dataclass(frozen=True, eq=False)
class PairView:
    """A board's corners in the two images of a stereo pair.

    Attributes:
        name: of the pair.
        ids_left, ids_right: (N,), (M,) rows of the board's object points.
        left, right: (N,2), (M,2) pixels.
        noise_left, noise_right: standard deviation of one coordinate, px, or None where unknown.
    """

    name: str
    ids_left: IntArray
    left: FloatArray
    ids_right: IntArray
    right: FloatArray
    noise_left: float | None = None
    noise_right: float | None = None


@dataclass(frozen=True)
class RangeBearing:
    """One reading of a landmark by a planar sensor.

    Attributes:
        id: the landmark.
        range_m: distance, meters; None where not measured.
        bearing_rad: direction, rad, positive to the left of straight ahead; None where not measured.
        time_s: when, seconds.
        range_sigma_m, bearing_sigma_rad: standard deviations, where the sensor states them for each reading.
    """

    id: LandmarkId
    range_m: float | None
    bearing_rad: float | None
    time_s: float = 0.0
    range_sigma_m: float | None = None
    bearing_sigma_rad: float | None = None
