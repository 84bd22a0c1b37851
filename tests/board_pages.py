"""Views of a board's page as it is printed, and where its corners are."""

import cv2
import numpy as np

from lmkit.generation.board import compose_board_page
from lmkit.generation.page import Text
from lmkit.generation.png import page_to_image

DPI = 127  # five pixels a millimeter: every edge of these boards lies between two pixels


def seen_at(board, H, size, rng):
    """A view of the board's page: (H,W,3) BGR, light blurred before it is encoded."""
    page = np.asarray(page_to_image(compose_board_page(board), DPI))[:, :, ::-1]
    linear = ((np.arange(256) / 255) ** 2.2).astype(np.float32)
    light = cv2.warpPerspective(linear[page], H, size, flags=cv2.INTER_LINEAR, borderValue=(0.2, 0.2, 0.2))
    light = np.clip(cv2.GaussianBlur(light, (0, 0), 0.8) + rng.normal(0, 0.004, light.shape), 0, 1)
    return (255 * light ** (1 / 2.2)).round().astype(np.uint8)


def pattern_on_page(board):
    """(2,2) px of the page at `DPI`: upper left and lower right end of the pattern."""
    page = compose_board_page(board)
    marks = [item for item in page.items if not isinstance(item, Text)]
    points = np.array([p for mark in marks for command in mark.commands for p in command[1:]])
    middle, size = (points.min(axis=0) + points.max(axis=0)) / 2, np.array(board.pattern_mm)
    return np.array([middle - size / 2, middle + size / 2]) / 25.4 * DPI - 0.5


def corners_on_page(board):
    """(N,2) px of the page at `DPI`."""
    inward = 0.0 if board.is_grid else board.square_mm
    return pattern_on_page(board)[0] + (board.object_points[:, :2] * 1000 + inward) / 25.4 * DPI


def onto(board, quad):
    """(3,3) homography of the page that brings the pattern to a (4,2) quad, px."""
    low, high = pattern_on_page(board)
    ends = np.array([low, (high[0], low[1]), high, (low[0], high[1])], dtype=np.float32)
    return cv2.getPerspectiveTransform(ends, np.asarray(quad, dtype=np.float32))
