"""Islands of drawn floor plans: text, furniture and pillars that are not connected with the outer walls."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from scipy.ndimage import binary_fill_holes

from lmkit.arrays import BoolArray, FloatArray, IntArray
from lmkit.errors import InputError
from lmkit.io.dxf_lines import ALL_LAYERS, LayerRules
from lmkit.model.floor_plan import FloorPlan, Island, Wall

SMALL_M = 2.5  # islands that are longer in x or y are walls by default
MOST_LISTED = 6
PART_M2 = 2.0  # smaller areas of free floor are not counted as parts
USES = {"obstacle": "obstacle", "obstacles": "obstacle", "ignore": "ignore", "wall": "wall", "walls": "wall"}
_RULE = re.compile(r"(obstacles?|ignore|walls?)(?::(\d+)(?:-(\d+))?)?")
HINT = "give obstacles, ignore or walls, for all or by numbers of the plan: ignore:1-4,walls:5"


@dataclass(frozen=True)
class DrawingOptions:
    """How drawings (images, SVG and DXF) become floor plans.

    Attributes:
        small: use of small islands: ``obstacle``, ``ignore`` or ``wall``.
        by_number: use of single islands.
        thin_m: thinner lines in images are ignored; 0: none.
        curves: False ignores curves in SVG and DXF, such as door arcs.
        layers: walls among the layers of a DXF drawing.
    """

    small: str = "obstacle"
    by_number: Mapping[int, str] = field(default_factory=dict)
    thin_m: float = 0.0
    curves: bool = True
    layers: LayerRules = ALL_LAYERS

    def use_of(self, number: int, is_small: bool) -> str:
        """Use of an island."""
        return self.by_number.get(number, self.small if is_small else "wall")


PLAIN_DRAWING = DrawingOptions()


def parse_island_rules(text: str) -> tuple[str, dict[int, str]]:
    """Use of small islands, and of single islands by number, from the option ``--islands``.

    >>> parse_island_rules("ignore,walls:5")
    ('ignore', {5: 'wall'})
    """
    small, by_number = "obstacle", dict[int, str]()
    for part in filter(None, (part.strip() for part in text.split(","))):
        found = _RULE.fullmatch(part)
        if not found:
            raise InputError("bad_islands", f"--islands {part!r} is not valid", HINT)
        use, first, last = USES[found[1]], found[2], found[3]
        if first is None:
            small = use
        else:
            by_number |= dict.fromkeys(range(int(first), int(last or first) + 1), use)
    return small, by_number


def find_islands(
    free: BoolArray, cell_m: float, origin: tuple[float, float], options: DrawingOptions
) -> tuple[list[Island], IntArray]:
    """Islands from top to bottom, and the number of the island at each cell, 0 elsewhere.

    Args:
        free: (rows, columns), row 0 at the lowest y; the outside is not free.

    Raises:
        InputError: an island's number does not exist.
    """
    solid = np.pad(~free, 1, constant_values=True).astype(np.uint8)
    _, parts, stats, _ = cv2.connectedComponentsWithStats(solid, connectivity=8)
    labels = [k for k in range(1, len(stats)) if k != parts[0, 0]]
    # Rows grow with y, so the top row comes last.
    labels.sort(
        key=lambda k: (-(stats[k, cv2.CC_STAT_TOP] + stats[k, cv2.CC_STAT_HEIGHT]), stats[k, cv2.CC_STAT_LEFT])
    )
    cells = np.zeros(free.shape, dtype=np.int64)
    islands = []
    for number, k in enumerate(labels, start=1):
        left, top, width, height = (int(v) for v in stats[k, :4])
        low = np.array(origin) + np.array([left - 1, top - 1]) * cell_m
        size = np.array([width, height]) * cell_m
        use = options.use_of(number, bool((size < SMALL_M).all()))
        islands.append(Island(number, low, low + size, use))
        crop = np.s_[top - 1 : top - 1 + height, left - 1 : left - 1 + width]
        own = parts[1:-1, 1:-1][crop] == k
        # The inside of a drawn table is not floor.
        cells[crop][own if use == "wall" else binary_fill_holes(own)] = number
    unknown = sorted(set(options.by_number) - {island.number for island in islands})
    if unknown:
        raise InputError(
            "unknown_island", f"--islands: the plan has no island {unknown[0]}", f"it has {len(islands)} islands"
        )
    return islands, cells


def with_islands(floor: FloorPlan, drawing: DrawingOptions) -> FloorPlan:
    """The floor with its islands: ignored islands become free, obstacles are filled."""
    islands, numbers = find_islands(floor.free, floor.cell_m, floor.origin, drawing)
    if not islands:
        return floor
    ignored, blocked = (
        np.isin(numbers, [island.number for island in islands if island.use == use]) for use in ("ignore", "obstacle")
    )
    return replace(floor, free=(floor.free | ignored) & ~blocked, islands=islands, island_cells=numbers)


def island_use(floor: FloorPlan, place: FloatArray) -> str:
    """Use of the island at a place; ``wall`` beside islands."""
    row, column = (int(v) for v in floor.cells(place))
    height, width = floor.free.shape
    if floor.island_cells is None or not (0 <= row < height and 0 <= column < width):
        return "wall"
    number = int(floor.island_cells[row, column])
    return floor.islands[number - 1].use if number else "wall"


def use_behind(floor: FloorPlan, wall: Wall) -> str:
    """Use of the island behind a wall on an outline, also across gaps between islands; ``wall`` without one."""
    out = np.array([np.cos(wall.facing_rad), np.sin(wall.facing_rad)])
    steps = np.linspace(0.0, 1.0, 1 + int(np.ceil(wall.length_m / floor.cell_m)))[:, None]
    behind = wall.left + steps * (wall.right - wall.left) - 0.4 * floor.cell_m * out
    uses = Counter(use for use in (island_use(floor, place) for place in behind) if use != "wall")
    drawn = sum(not floor.is_free(place) for place in behind)
    return uses.most_common(1)[0][0] if uses and 2 * uses.total() > drawn else "wall"


def drawing_warnings(islands: Sequence[Island], free: BoolArray, cell_m: float) -> list[str]:
    """Sentences about islands, and about parts of the floor that no opening connects."""
    effects = {
        "obstacle": "block the robot and carry no landmarks",
        "ignore": "are left out",
        "wall": "are used as walls",
    }
    lines = []
    for use, effect in effects.items():
        some = sorted((i for i in islands if i.use == use), key=lambda i: -float((i.high - i.low).max()))
        if some:
            names = ", ".join(map(str, some[:MOST_LISTED]))
            more = f" and {len(some) - MOST_LISTED} more" if len(some) > MOST_LISTED else ""
            lines.append(f"islands of the drawing that {effect}: {names}{more}")
    if lines:
        lines[-1] += "; change with --islands, such as ignore:1-4,walls:5 (numbers as in the plan)"
    count, _, stats, _ = cv2.connectedComponentsWithStats(free.astype(np.uint8), connectivity=4)
    areas = sorted((float(stats[k, cv2.CC_STAT_AREA]) * cell_m**2 for k in range(1, count)), reverse=True)
    areas = [area for area in areas if area >= PART_M2]
    if len(areas) > 1:
        sizes = ", ".join(f"{area:.0f}" for area in areas[:MOST_LISTED])
        lines.append(
            f"{len(areas)} parts of the floor ({sizes} m2) have no opening between them; where door arcs or lines "
            "close doors, leave them out with --thin-lines 6cm (images) or --no-curves (SVG, DXF)"
        )
    return lines


def without_thin_lines(dark: BoolArray, thin_m: float, pixel_m: float) -> BoolArray:
    """Dark areas of an image without lines thinner than ``thin_m``.

    Raises:
        InputError: thinner than two pixels, which the image does not show.
    """
    width = int(np.ceil(thin_m / pixel_m))
    if width < 2:
        raise InputError(
            "thin_lines",
            f"--thin-lines {100 * thin_m:g} cm is less than 2 pixels of {100 * pixel_m:g} cm",
            "give more",
        )
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (width, width))
    # The outside counts as dark, so that walls at the border keep their thickness.
    padded = np.pad(dark.astype(np.uint8), width, mode="edge")
    opened = cv2.morphologyEx(padded, cv2.MORPH_OPEN, kernel)
    return np.asarray(opened[width:-width, width:-width] > 0)
