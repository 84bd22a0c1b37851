"""False positives of square markers on photographs that hold none, calibrated on some and reported on others.

    uv run --extra benchmark python benchmarks/tag_false_positives.py ../shared/data/photos [--calibrate]

With `--calibrate`, every second photograph: how many squares of 4x4 cells are as clear as each of `CLEARNESSES` asks,
whatever their cells show, so long as three cells or more are black and three white.  Without it, the other
photographs and those that scikit-image ships: what every family reads there, what AprilTag 3 and OpenCV read, and
upper 95 % limits of the rates (Clopper and Pearson 1934).  Every photograph comes in `KINDS`; those of one photograph
are alike, so the limit by photographs counts each once.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import skimage
from planar import backgrounds
from scipy.stats import beta
from tags import with_apriltag, with_aruco

from lmkit.detection import tag_registration
from lmkit.detection.config import DetectOptions
from lmkit.detection.linear_image import LinearImage
from lmkit.detection.tag_decoding import TagDecoding, decode_tag
from lmkit.detection.tag_detector import tag_candidates_of
from lmkit.model.square_marker import SQUARE_FAMILIES

SHIPPED = (
    "astronaut.png",
    "brick.png",
    "camera.png",
    "chelsea.png",
    "coffee.png",
    "coins.png",
    "page.png",
    "rocket.jpg",
)
FAMILIES = ("tag36h11", "tag36h10", "tag25h9", "tag16h5", "aruco4x4_50", "aruco4x4_250", "aruco4x4_1000")
FAMILIES += ("aruco5x5_1000", "aruco6x6_1000", "aruco7x7_1000", "aruco_original", "aruco_mip_36h12")
SQUARE_CELLS, LEAST_OF_A_COLOR = 4, 3
LARGEST_PX = 640


def enlarged(image: np.ndarray, times: float) -> np.ndarray:
    return cv2.resize(image, None, fx=times, fy=times, interpolation=cv2.INTER_CUBIC)


def cropped(image: np.ndarray, right: int, lower: int) -> np.ndarray:
    """A quarter of the image, enlarged three times."""
    height, width = (length // 2 for length in image.shape[:2])
    return enlarged(image[lower * height : (lower + 1) * height, right * width : (right + 1) * width], 3)


def sharpened(image: np.ndarray) -> np.ndarray:
    return cv2.addWeighted(image, 2.0, cv2.GaussianBlur(image, (0, 0), 1.5), -1.0, 0)


def dim(image: np.ndarray) -> np.ndarray:
    noise = np.random.default_rng(image.shape[0] + int(image[0, 0, 0])).normal(0, 2, image.shape)
    return np.clip(0.15 * image.astype(np.float64) + noise, 0, 255).astype(np.uint8)


def squeezed(image: np.ndarray) -> np.ndarray:
    """The image after a JPEG file of quality 30."""
    return cv2.imdecode(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 30])[1], cv2.IMREAD_COLOR)


KINDS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "as it is": lambda image: image,
    "mirrored": lambda image: np.ascontiguousarray(image[:, ::-1]),
    "sharpened": sharpened,
    "dim": dim,
    "JPEG 30": squeezed,
    "enlarged twice": lambda image: enlarged(image, 2),
    "enlarged, sharpened": lambda image: sharpened(enlarged(image, 2)),
    "smaller": lambda image: enlarged(image, 0.7),
    "upper left quarter x 3": lambda image: cropped(image, 0, 0),
    "lower right quarter x 3": lambda image: cropped(image, 1, 1),
}


def versions(paths: list[Path]) -> Iterator[tuple[int, str, np.ndarray]]:
    """Number of the photograph, kind, and (H,W,3) BGR."""
    for number, path in enumerate(paths):
        image = cv2.imread(str(path))
        if max(image.shape) > LARGEST_PX:
            image = enlarged(image, LARGEST_PX / max(image.shape))
        for kind, change in KINDS.items():
            yield number, kind, change(image)


def upper_limit(hits: int, n: int) -> float:
    """Upper 95 % limit of a rate."""
    return float(beta.ppf(0.95, hits + 1, n - hits)) if hits < n else 1.0


def calibrate(paths: list[Path]) -> None:
    tag_registration.decode_tag = decode_anything
    family = SQUARE_FAMILIES["tag16h5"]
    options = DetectOptions((family,))
    found, images = np.zeros(len(tag_registration.CLEARNESSES)), 0
    for _, _, image in versions(paths):
        images += 1
        squares: list[np.ndarray] = []
        candidates = tag_candidates_of(LinearImage.of(image), (family,), options, False)
        for candidate in sorted(candidates, key=lambda c: c.decoding.cell_error):
            white = int(candidate.decoding.expected.sum())
            middle = candidate.corners.mean(axis=0)
            again = any(np.linalg.norm(middle - other) < 0.5 * candidate.side_px for other in squares)
            if again or not LEAST_OF_A_COLOR <= white <= SQUARE_CELLS**2 - LEAST_OF_A_COLOR:
                continue
            squares.append(middle)
            errors = candidate.decoding.cell_error, candidate.border_error
            found += [errors[0] <= c.cell_error and errors[1] <= c.border_error for c in tag_registration.CLEARNESSES]
    print(f"{images} images of {len(paths)} photographs\n")
    print("| cell error | border error | squares an image |\n|---|---|---|")
    for clearness, count in zip(tag_registration.CLEARNESSES, found, strict=True):
        print(f"| {clearness.cell_error:g} | {clearness.border_error:g} | {count / images:.3f} |")


def decode_anything(*arguments: object) -> TagDecoding | None:
    """The decoding whose code is what the cells look like."""
    found = decode_tag(*arguments)
    return None if found is None else replace(found, margin=math.inf, expected=found.cells > 0.5, quarter=0)


def report(paths: list[Path]) -> None:
    peers = {"AprilTag 3, tag36h11": with_apriltag(), "OpenCV, 4x4_250": with_aruco(cv2.aruco.DICT_4X4_250, 0)}
    found: dict[str, list[int]] = {name: [] for name in (*FAMILIES, *peers)}
    images = 0
    for number, kind, image in versions(paths):
        images += 1
        linear = LinearImage.of(image)
        for name in FAMILIES:
            family = SQUARE_FAMILIES[name]
            candidates = tag_candidates_of(linear, (family,), DetectOptions((family,)), False)
            read = [c for c in candidates if c.rejected is None]
            found[name] += [number] * len(read)
            for c in read:
                print(f"{name} {c.decoding.code}: {kind}, {paths[number].name}, {c.corners.mean(axis=0).round()}")
        for name, detect in peers.items():
            found[name] += [number] * len(detect(image))
    print(f"\n{images} images of {len(paths)} photographs\n")
    print("| | false positives | at most, of 1000 images | photographs with any | at most, % of photographs |")
    print("|---|---|---|---|---|")
    for name, numbers in found.items():
        some = len(set(numbers))
        limits = 1000 * upper_limit(len(numbers), images), 100 * upper_limit(some, len(paths))
        print(f"| {name} | {len(numbers)} | {limits[0]:.1f} | {some} | {limits[1]:.1f} |")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("photos", type=Path)
    parser.add_argument("--calibrate", action="store_true")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    photos = backgrounds(options.photos)
    if options.calibrate:
        calibrate(photos[::2])
    else:
        shipped = Path(skimage.__file__).parent / "data"
        report(photos[1::2] + [shipped / name for name in SHIPPED if (shipped / name).exists()])


if __name__ == "__main__":
    main()
