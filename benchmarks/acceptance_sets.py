"""Images to fit acceptance, to set its limit and to report it on: three sets that share no seed and no photograph.

Fitting and setting the limit use kinds of cameras that reporting does not.  Of the photographs in order of their
names, the first 35 % are for fitting, the next 15 % for the limit and the other half for reporting.
Images that are drawn once can be kept in a folder, one file each, so that an interruption loses nothing and other
candidates can be found in them.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from camera_scenes import COLUMNS, LOOK_ALIKES, ROWS, Shown, bar_or_patch, draw_photograph, wide_obstacle
from planar import background, backgrounds

from lmkit.simulation.cameras import HELD_OUT_KINDS, TRAINING_KINDS, CameraKind

Drawn = tuple[np.ndarray, list[Shown]]
MOSTLY_LOOK_ALIKES = 0.97


@dataclass(frozen=True)
class ImageSet:
    """Simulated images, and the photographs that belong to them.

    Attributes:
        name: of the set, also of its files.
        seed: of all its images.
        kinds: of cameras.
        photos: from and up to which share of the photographs.
        hidden: share of the landmarks before which an obstacle stands.
        family: of the landmarks.
        most_px: the largest side; the smallest is 9 px, or 13 px among look-alikes.
        cells: columns and rows of sheets.
        motion_px: least and largest way of every image during its exposure; see `camera_scenes.draw_photograph`.
    """

    name: str
    seed: int
    kinds: tuple[CameraKind, ...]
    photos: tuple[float, float]
    hidden: float
    family: str = "lm8"
    most_px: float = 60.0
    cells: tuple[int, int] = (COLUMNS, ROWS)
    motion_px: tuple[float, float] | None = None

    def photographs(self, folder: Path) -> list[Path]:
        paths = backgrounds(folder)
        first, end = (round(share * len(paths)) for share in self.photos)
        return paths[first:end]

    def scene(self, photos: Sequence[Path], look_alikes: float, keep: Path | None, index: int) -> Drawn:
        """One image and the landmarks in it; of `photos`, the paths of the whole folder, those of this set."""
        least = 9.0 if look_alikes < 0.5 else 13.0

        def draw() -> Drawn:
            # The obstacles of the other benchmarks, too: every second image.
            obstacle = (bar_or_patch, wide_obstacle)[index % 2]
            seed = (self.seed, round(100 * look_alikes), index)
            wall = background(photos[index % len(photos)])
            return draw_photograph(
                seed,
                wall,
                self.kinds,
                (least, self.most_px),
                self.family,
                look_alikes=look_alikes,
                cells=self.cells,
                hidden=self.hidden,
                obstacle=obstacle,
                motion_px=self.motion_px,
            )[:2]

        name = f"{self.name}-{round(100 * look_alikes)}-{index:05d}"
        return draw() if keep is None else kept(keep, name, draw)


FIT = ImageSet("fit", 1101, TRAINING_KINDS, (0.0, 0.35), 0.4)
LIMIT = ImageSet("limit", 2202, TRAINING_KINDS, (0.35, 0.5), 0.3)
REPORT = ImageSet("report", 48117, HELD_OUT_KINDS, (0.5, 1.0), 0.2)
# Many landmarks in little time, to count what is rare.
MANY = ImageSet("many", 48229, HELD_OUT_KINDS, (0.5, 1.0), 0.2, most_px=42.0, cells=(6, 4))
# Every image moves during its exposure, in any direction, by 1 to 20 px: up to the side of landmarks and beyond.
MOVING = ImageSet("moving", 48337, HELD_OUT_KINDS, (0.5, 1.0), 0.2, cells=(5, 4), motion_px=(1.0, 20.0))
USUAL = LOOK_ALIKES


def kept(folder: Path, name: str, draw: Callable[[], Drawn]) -> Drawn:
    """The image that a folder holds under a name; drawn now and kept there where it holds none."""
    image_file, truth_file = folder / f"{name}.png", folder / f"{name}.pickle"
    if truth_file.exists():
        return cv2.imread(str(image_file)), pickle.loads(truth_file.read_bytes())
    folder.mkdir(parents=True, exist_ok=True)
    image, shown = draw()
    cv2.imwrite(str(image_file), image)
    part = truth_file.with_suffix(".part")
    part.write_bytes(pickle.dumps(shown))
    part.replace(truth_file)
    return image, shown
