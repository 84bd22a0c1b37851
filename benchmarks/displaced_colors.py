"""Cost of red and blue images that a camera displaces against green, and how much of it the fit corrects.

    uv run --extra benchmark python benchmarks/displaced_colors.py [--images 20] [--first 96001]

Simulated scenes of flat landmarks of 15 to 80 px before even gray, by six kinds of cameras, each exposed with
several displacements in the same light: red and blue by so many px to opposite sides of green, in any direction, or
red larger and blue smaller than green about the middle.  Every image is read without a shift of colors in the fit,
with it, and without it where the true displacement was undone in the image before.  Changes are means of the
logarithm of a landmark's corner error against the first line, over the landmarks that all lines read, with their
standard error.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np
from camera_scenes import Shown, draw_photograph
from planar import SIZE, camera
from scipy.stats import chi2

from lmkit.arrays import ByteArray, FloatArray
from lmkit.detection import fit_steps, registration
from lmkit.detection.config import DetectOptions
from lmkit.detection.detector import detect_landmarks
from lmkit.simulation.cameras import DASHCAM, DOORBELL, INDUSTRIAL, PHONE, THREE_CHIP, WEBCAM, CameraKind
from lmkit.simulation.photograph import Lens

KINDS = (INDUSTRIAL, THREE_CHIP, WEBCAM, PHONE, DASHCAM, DOORBELL)
NONE = 1e-6  # px; a shift too small to matter, in a lens or in the fit; a kind without one draws fewer numbers
TODAY_PX = registration.COLOR_SHIFT_PRIOR
SHIFTS_PX, LATERALS = (0.1, 0.2), (5e-4, 1e-3, 2e-3)
SIDES_PX, ANOTHER_PX = (15.0, 80.0), 3.0


@dataclass(frozen=True)
class Read:
    """Error (px, rms of the corners' distances) and squared normalized error of a landmark's eight coordinates."""

    error_px: float
    nees: float


def moved_back(image: ByteArray, lens: Lens) -> ByteArray:
    """The image with red and blue where green is."""
    middle, shift = (np.array(SIZE) - 1) / 2, np.array(lens.color_shift_px)
    channels = []
    for channel, sign in zip(cv2.split(image), (-1, 0, 1), strict=True):
        scale = 1 + sign * lens.lateral_color
        warp = np.column_stack([scale * np.eye(2), (1 - scale) * middle + sign * shift])
        how = cv2.INTER_LANCZOS4 | cv2.WARP_INVERSE_MAP
        channels.append(cv2.warpAffine(channel, warp, SIZE, flags=how, borderMode=cv2.BORDER_REPLICATE))
    return np.asarray(cv2.merge(channels), dtype=np.uint8)


def read(image: ByteArray, shown: list[Shown], prior_px: float) -> dict[int, Read]:
    """Landmarks that are read, by their place in `shown`."""
    found: dict[int, Read] = {}
    registration.COLOR_SHIFT_PRIOR = fit_steps.COLOR_SHIFT_PRIOR = prior_px
    fit_steps._task.cache_clear()
    for d in detect_landmarks(image, DetectOptions(camera=camera())):
        for k, one in enumerate(shown):
            error: FloatArray = d.corners - one.corners
            if one.code == d.code and np.abs(error).max() < ANOTHER_PX:
                nees = error.ravel() @ np.linalg.solve(d.covariance, error.ravel())
                found[k] = Read(float(np.sqrt(np.mean(np.sum(error**2, axis=1)))), float(nees))
    return found


def displaced(kind: CameraKind) -> Iterator[tuple[str, CameraKind]]:
    still = replace(kind, lateral_color=(0.0, 0.0), color_shift_px=(NONE, NONE))
    yield "none", still
    for shift in SHIFTS_PX:
        yield f"{shift:g} px", replace(still, color_shift_px=(shift, shift))
    for lateral in LATERALS:
        yield f"lateral, {1000 * lateral:g} of 1,000", replace(still, lateral_color=(lateral, lateral))


def scene(kind: CameraKind, seed: int) -> list[dict[str, Read]]:
    """Landmarks that all lines read."""
    lines: dict[str, dict[int, Read]] = {}
    gray = np.full((SIZE[1], SIZE[0], 3), 0.3, dtype=np.float32)
    for name, one in displaced(kind):
        image, shown, chain = draw_photograph([seed], gray, [one], SIDES_PX, look_alikes=0.0, hidden=0.0, bowed=0.0)
        lines[name] = read(image, shown, NONE)
        lines[f"{name}, shift in the fit"] = read(image, shown, TODAY_PX)
        if name != "none":
            lines[f"{name}, undone"] = read(moved_back(image, chain.lens), shown, NONE)
    everywhere = set.intersection(*(set(found) for found in lines.values()))
    return [{name: found[k] for name, found in lines.items()} for k in sorted(everywhere)]


def print_table(title: str, rows: list[dict[str, Read]]) -> None:
    print(
        f"\n| {title}, {len(rows)} landmarks | median error, px | change, % | NEES / 8, mean | median | inside, % |"
    )
    print("|---|---|---|---|---|---|")
    for name in rows[0]:
        errors, nees = (np.array([getattr(row[name], key) for row in rows]) for key in ("error_px", "nees"))
        change = np.log(errors / [row["none"].error_px for row in rows])
        spread = 100 * change.std() / np.sqrt(len(rows))
        inside = 100 * np.mean(nees < chi2.ppf(0.95, 8))
        print(
            f"| {name} | {np.median(errors):.3f} | {100 * change.mean():+.1f} ({spread:.1f}) "
            f"| {nees.mean() / 8:.2f} | {np.median(nees) / 8:.2f} | {inside:.0f} |"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--images", type=int, default=20, help="by each kind of camera")
    parser.add_argument("--first", type=int, default=96001, help="seed")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    seeds = range(options.first, options.first + options.images)
    by_kind = {kind.name: [row for seed in seeds for row in scene(kind, seed)] for kind in KINDS}
    print_table("all", [row for rows in by_kind.values() for row in rows])
    for name, rows in by_kind.items():
        print_table(name, rows)


if __name__ == "__main__":
    main()
