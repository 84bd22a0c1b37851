"""Landmarks that are partly covered by another landmark's sheet, whose covered gaps give no information.

If two sheets overlap, the nearer one is wholly visible, and fits better; a landmark that is read within another one's
face is on top of it.  The content of the nearer sheet may resemble a gap or a ring of the other one.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, TypeVar

import cv2
import numpy as np

from lmkit.arrays import FloatArray
from lmkit.detection.pixel_sampling import middle_of
from lmkit.detection.register_and_decode import Candidate
from lmkit.model.landmark import LandmarkFamily

if TYPE_CHECKING:
    from lmkit.detection.tag_registration import TagCandidate

AnyCandidate = TypeVar("AnyCandidate", bound="Candidate | TagCandidate")
NEAR = 1 + 1e-9  # of both sides together: middles further apart do not overlap
POINTS_ACROSS_GAP, COVERED_POINTS = 7, 5  # of one gap position; fewer leave enough of it to read


def without_covered(candidates: Sequence[AnyCandidate]) -> list[AnyCandidate]:
    """The candidates without gap positions that a nearer sheet covers for the most part."""
    if len(candidates) < 2:
        return list(candidates)
    middles = np.array([middle_of(one.corners) for one in candidates])
    sides = np.array([one.side_px for one in candidates])
    apart = np.linalg.norm(middles[:, None] - middles, axis=2)
    near = np.argwhere(apart <= NEAR * (sides[:, None] + sides)).tolist()
    covered = {lower for upper, lower in near if _covers(candidates[upper], candidates[lower])}
    return [one for k, one in enumerate(candidates) if k not in covered]


def _covers(upper: Candidate | TagCandidate, lower: Candidate | TagCandidate) -> bool:
    if not isinstance(lower, Candidate) or upper is lower:
        return False
    apart = math.dist(middle_of(upper.corners), middle_of(lower.corners))
    larger = lower.side_px - upper.side_px
    is_nested = apart < 0.5 * abs(larger)
    is_nearer = larger > 0 if is_nested else upper.log_odds > lower.log_odds
    if not is_nearer or apart > upper.side_px + lower.side_px:
        return False
    reach = upper.family.half_mm + upper.family.margin_mm
    sheet = _in_image(upper, np.array([(-reach, reach), (reach, reach), (reach, -reach), (-reach, -reach)]))
    outline = sheet.astype(np.float32)
    points = _in_image(lower, _gap_points(lower.family)).tolist()
    under = [cv2.pointPolygonTest(outline, (x, y), False) >= 0 for x, y in points]
    return bool(np.reshape(under, (-1, POINTS_ACROSS_GAP)).sum(axis=1).max() >= COVERED_POINTS)


def _gap_points(family: LandmarkFamily) -> FloatArray:
    """(N,2) mm, points along the middle of every gap position, gap after gap."""
    turns = np.linspace(-0.5, 0.5, POINTS_ACROSS_GAP)
    places = [
        ((ring.inner_mm + ring.outer_mm) / 2, math.radians(center + ring.gap_width_deg * turn))
        for ring in family.rings
        for center in ring.gap_centers_deg
        for turn in turns.tolist()
    ]
    return np.array([(radius * math.sin(angle), radius * math.cos(angle)) for radius, angle in places])


def _in_image(candidate: Candidate | TagCandidate, points_mm: FloatArray) -> FloatArray:
    """(N,2) px of points of the landmark's plane."""
    face = candidate.family.object_points(candidate.family.side_mm)[:, :2]
    H = cv2.getPerspectiveTransform(face.astype(np.float32), candidate.corners.astype(np.float32))
    return np.asarray(cv2.perspectiveTransform(points_mm[None], H)[0], dtype=np.float64)
