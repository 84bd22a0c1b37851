"""AprilGrids in images: first the tags, then every corner where four squares meet.

Black squares touch the tags at their corners, so no tag is an isolated square: dark parts are eroded until
they separate.  A few tags give the pose of the grid, from which the others are predicted.
"""

from __future__ import annotations

import cv2
import numpy as np

from lmkit.arrays import ByteArray, FloatArray
from lmkit.detection.board_corners import refine_corners
from lmkit.detection.candidates import find_candidates, grown
from lmkit.detection.config import ACCURATE, DetectOptions
from lmkit.detection.linear_image import LinearImage
from lmkit.detection.tag_detector import DETAILED, TAGS_WHERE, read_tags
from lmkit.detection.tag_registration import TagCandidate
from lmkit.detection.windows import is_colorless
from lmkit.geometry.homography import transform_points
from lmkit.model.board import BoardSpec
from lmkit.model.observation import BoardObservation

THINNED_PX = (1, 2, 4)  # from every side of what is dark
LEAST_TAGS = 2
CLEAR = 0.4  # sides of a small square: nothing but four squares lies so near a corner


def detect_april_grid(image: ByteArray, board: BoardSpec) -> BoardObservation | None:
    """An AprilGrid in (H,W,3) BGR, 8 bit; None where fewer than two of its tags are read."""
    options = DetectOptions((board.tag_family,), config=ACCURATE)
    linear, gray = LinearImage.of(image), is_colorless(image)
    seen: dict[int, TagCandidate] = {}
    for quads in (_thinned_quads(image, px) for px in THINNED_PX):
        _add(seen, read_tags(linear, quads, options, gray), board)
    if len(seen) < LEAST_TAGS:
        return None
    _add(seen, read_tags(linear, _expected_quads(seen, board, linear.size), options, gray), board)
    places = [board.codes.index(code) for code in seen]
    ids = np.concatenate([4 * place + np.arange(4) for place in places])
    corners = np.concatenate([tag.corners for tag in seen.values()])
    plane = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), dtype=np.uint8)
    points, noise_px = refine_corners(plane, corners, board.object_points[ids, :2], board.gap_mm / 1000, CLEAR)
    return BoardObservation(ids, points, noise_px)


def _add(seen: dict[int, TagCandidate], tags: list[TagCandidate], board: BoardSpec) -> None:
    for tag in tags:
        if tag.decoding.code in board.codes:
            seen.setdefault(tag.decoding.code, tag)


def _thinned_quads(image: ByteArray, px: int) -> FloatArray:
    """(N,4,2) dark squares after erosion by some pixels on each side, at their original size."""
    light = np.asarray(cv2.dilate(image, np.ones((2 * px + 1, 2 * px + 1), np.uint8)), dtype=np.uint8)
    thinned = LinearImage.of(light)
    quads = find_candidates(thinned.pyramid.levels, (*ACCURATE.sources, DETAILED), TAGS_WHERE, thinned.noise)
    if not len(quads):
        return quads
    sides = np.linalg.norm(np.roll(quads, -1, axis=1) - quads, axis=2).mean(axis=1)
    return np.array([grown(q[None], 1 + 2 * px / side)[0] for q, side in zip(quads, sides, strict=True)])


def _expected_quads(seen: dict[int, TagCandidate], board: BoardSpec, size: tuple[int, int]) -> FloatArray:
    """(N,4,2) predicted places of tags that were not read, inside the image."""
    points = board.object_points[:, :2].reshape(-1, 4, 2)
    places = [board.codes.index(code) for code in seen]
    H, _ = cv2.findHomography(
        points[places].reshape(-1, 2), np.concatenate([tag.corners for tag in seen.values()]), 0
    )
    if H is None:
        return np.zeros((0, 4, 2))
    missing = np.array([place for place in range(len(points)) if place not in places], dtype=int)
    quads = transform_points(np.asarray(H, dtype=np.float64), points[missing].reshape(-1, 2)).reshape(-1, 4, 2)
    return quads[((quads > 0) & (quads < np.array(size) - 1)).all(axis=(1, 2))]
