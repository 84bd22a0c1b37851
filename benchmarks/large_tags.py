"""Large AprilTags, near the camera: read or not, and corner errors, beside AprilTag 3 on the same images.

    uv run --extra benchmark python benchmarks/large_tags.py [--images 12] [--first 20]

One `tag36h11` marker on white, drawn at 2 to 4 times the size with perspective, then averaged, blurred and given
noise; linear light, gamma 2.2.  Sizes of which `tags.py` has none: a robot before a door sees them.  An error is the
root mean square of the distances of the four corners.
"""

from __future__ import annotations

import argparse

import cv2
import numpy as np
from peers import READERS

from lmkit.detection.config import DetectOptions
from lmkit.detection.detector import detect_landmarks
from lmkit.model.families import families_named

SIDES_PX = (150, 250, 400, 600, 900)
LOOKS = ((0.3, 0.0), (0.8, 2.0), (2.0, 2.0))  # blur, px, and noise, code values
CELL_PX, CELLS, QUIET = 40, 8, 2  # of the drawing
TILT = 0.1  # corners are drawn nearer to the middle, or further off, by such a share


def photograph(
    side_px: float, blur_px: float, noise: float, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """(H,W,3) image and (4,2) true corners."""
    marker = cv2.aruco.generateImageMarker(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11), 5, CELLS)
    page = np.kron(np.pad(marker, QUIET, constant_values=255), np.ones((CELL_PX, CELL_PX), np.uint8))
    low, high = CELL_PX * QUIET - 0.5, CELL_PX * (QUIET + CELLS) - 0.5
    drawn = np.array([[low, low], [high, low], [high, high], [low, high]], np.float32)
    width, finer = int(1.6 * side_px), 4 if side_px < 700 else 2
    square = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * side_px / 2
    middle = width / 2 + rng.uniform(-3, 3, 2)
    seen = square * (1 + rng.uniform(-TILT, TILT, (4, 1))) + middle
    H = cv2.getPerspectiveTransform(drawn, ((seen + 0.5) * finer - 0.5).astype(np.float32))
    corners = (cv2.perspectiveTransform(drawn[None].astype(np.float64), H)[0] + 0.5) / finer - 0.5
    large = cv2.warpPerspective(page, H, (width * finer, width * finer), flags=cv2.INTER_LINEAR, borderValue=255)
    light = cv2.resize(large.astype(np.float32), (width, width), interpolation=cv2.INTER_AREA) / 255
    light = 0.05 + 0.75 * cv2.GaussianBlur(light, (0, 0), blur_px)
    codes = 255 * np.clip(light, 0, 1) ** (1 / 2.2) + rng.normal(0, noise, light.shape)
    return np.repeat(np.clip(codes, 0, 255).astype(np.uint8)[:, :, None], 3, axis=2), corners


def error_px(found: np.ndarray, true: np.ndarray) -> float:
    """Error of corners, from whichever corner on and whichever way around."""
    orders = [np.roll(order, turn, axis=0) for order in (found, found[::-1]) for turn in range(4)]
    return float(min(np.sqrt(((order - true) ** 2).sum(axis=1).mean()) for order in orders))


def main() -> None:
    """Print a row per size and reader."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--images", type=int, default=12)
    parser.add_argument("--first", type=int, default=20, help="first seed")
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    options = DetectOptions(families_named("tag36h11"))
    readers = {
        "lmkit": lambda image: [(d.code, d.corners) for d in detect_landmarks(image, options)],
        "AprilTag 3": READERS["AprilTag 3"].make(),
    }
    print("| side, px | reader | read | corner error, px: median | 90 % | largest |")
    print("|---|---|---|---|---|---|")
    for side in SIDES_PX:
        errors: dict[str, list[float]] = {name: [] for name in readers}
        for blur, noise in LOOKS:
            for seed in range(arguments.first, arguments.first + arguments.images):
                image, true = photograph(side, blur, noise, np.random.default_rng([side, seed]))
                for name, read in readers.items():
                    errors[name] += [error_px(np.asarray(c), true) for code, c in read(image) if code == 5][:1]
        for name, some in errors.items():
            numbers = " | ".join(f"{value:.3f}" for value in np.percentile(some, [50, 90, 100]))
            print(f"| {side} | {name} | {len(some)} of {len(LOOKS) * arguments.images} | {numbers} |", flush=True)


if __name__ == "__main__":
    main()
