"""Screening of squares: white around a dark border, in light and in shadow."""

import cv2
import numpy as np

from lmkit.detection.tag_screening import look_at
from lmkit.model.square_marker import SQUARE_FAMILIES

TAG = SQUARE_FAMILIES["tag36h11"]
QUAD = np.array([[60.0, 60.0], [123.0, 60.0], [123.0, 123.0], [60.0, 123.0]])


def square(border: int, margin: int) -> np.ndarray:
    image = np.full((200, 200, 3), margin, dtype=np.uint8)
    cv2.rectangle(image, (60, 60), (123, 123), (border,) * 3, -1)
    cv2.rectangle(image, (75, 75), (108, 108), (160,) * 3, -1)
    return image


def test_white_around_a_dark_border_is_promising() -> None:
    assert look_at((square(30, 220),), QUAD[None], TAG).promising.all()
    assert look_at((square(30, 220),), QUAD[None] / 4 + 100, TAG).promising.tolist() == [False]


def test_a_shadow_across_does_not_hide_a_marker() -> None:
    image = square(60, 220)
    image[:, :95] //= 3
    assert look_at((image,), QUAD[None], TAG).promising.all()


def test_bright_borders_and_misshapen_squares_are_not() -> None:
    assert not look_at((square(220, 30),), QUAD[None], TAG).promising.any()
    folded = QUAD[[0, 2, 1, 3]]
    line = np.column_stack([np.arange(4.0) * 20 + 20, np.full(4, 50.0)])
    assert not look_at((square(30, 220),), np.stack([folded, line, QUAD[::-1]]), TAG).promising.any()
    assert look_at((square(30, 220),), np.zeros((0, 4, 2)), TAG).promising.shape == (0,)


def test_a_border_that_is_not_dark_all_around_is_not_promising() -> None:
    image = square(30, 220)
    for x, y in ((66, 92), (117, 92), (92, 66)):
        cv2.circle(image, (x, y), 15, (200,) * 3, -1)
    assert not look_at((image,), QUAD[None], TAG).promising.any()
