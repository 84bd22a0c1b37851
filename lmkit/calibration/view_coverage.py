"""Coverage of the views of a board - position, size, tilt - and the view to show next."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from lmkit.arrays import BoolArray, FloatArray
from lmkit.model.observation import PairView

Size = tuple[int, int]
CELLS = 5
TILTED_DEG = 20.0
LEAST_TILTED = 2  # views tilted each way
LEAST_NEARER = 1.5  # farthest over nearest view
ENOUGH_CELLS = 0.8
LEAST_VIEWS = 10
_ROWS = ("top", "upper middle", "middle", "lower middle", "bottom")
_COLUMNS = ("left", "middle left", "middle", "middle right", "right")


@dataclass(frozen=True)
class ViewCoverage:
    """Coverage of the views so far.

    Attributes:
        cells: (5,5) of the left image and (5,5) of the right, True where corners were seen.
        distances_m: of every view, from the left camera.
        tilts_deg: (P,2) of every view: about the image's upright and about its level axis; positive
            where the board's right edge, or its lower edge, is nearer.
        advice: views to take next, the most wanted first.
    """

    cells: tuple[BoolArray, BoolArray]
    distances_m: FloatArray
    tilts_deg: FloatArray
    advice: tuple[str, ...]

    def filled(self, side: int) -> float:
        """Share of the cells of one camera (0 left, 1 right) in which corners were seen."""
        return float(self.cells[side].mean())


def coverage_of(
    views: Sequence[PairView], rotations: FloatArray, translations: FloatArray, left_size: Size, right_size: Size
) -> ViewCoverage:
    """ViewCoverage of the pairs, with the board's poses (P,3,3), (P,3) in the left camera; sizes: (width, height)."""
    cells = tuple(
        filled_cells(np.concatenate([np.zeros((0, 2)), *(getattr(view, side) for view in views)]), size)
        for side, size in (("left", left_size), ("right", right_size))
    )
    distances = np.linalg.norm(translations, axis=1)
    # The board's normal, turned so that it looks away from the camera.
    normals = rotations[:, :, 2] * np.sign(rotations[:, 2, 2])[:, None]
    tilts = np.rad2deg(np.arctan2(normals[:, :2], normals[:, 2:]))
    both = (cells[0], cells[1])
    return ViewCoverage(
        both, distances, tilts, tuple(_advice(dict(zip(("left ", "right "), both, strict=True)), distances, tilts))
    )


def filled_cells(points: FloatArray, image_size: tuple[int, int]) -> BoolArray:
    """(5,5) True where at least one of (N,2) points lies."""
    column, row = np.floor((points + 0.5) / np.array(image_size) * CELLS).clip(0, CELLS - 1).astype(int).T
    cells = np.zeros((CELLS, CELLS), dtype=bool)
    cells[row, column] = True
    return cells


def _advice(cells: Mapping[str, BoolArray], distances: FloatArray, tilts: FloatArray) -> list[str]:
    advice = []
    for name, axis, toward in (("left", 0, -1), ("right", 0, 1), ("upper", 1, -1), ("lower", 1, 1)):
        count = int((toward * tilts[:, axis] > TILTED_DEG).sum())
        if count < LEAST_TILTED:
            advice.append(f"the board tilted by 30 to 45 deg, its {name} edge nearer")
    for camera, seen in cells.items():
        if seen.mean() < ENOUGH_CELLS:
            advice.append(f"the board in the {_emptiest(seen)} of the {camera}image")
    if len(distances) and distances.max() < LEAST_NEARER * distances.min():
        advice.append("the board nearer, so that it fills the image, and twice as far")
    if len(distances) < LEAST_VIEWS:
        advice.append(f"{LEAST_VIEWS - len(distances)} more views")
    return advice


def camera_coverage(
    points: Sequence[FloatArray], rotations: FloatArray, translations: FloatArray, image_size: tuple[int, int]
) -> tuple[BoolArray, tuple[str, ...]]:
    """(5,5) cells of one camera's image in which corners were seen, and the views to take next.

    Args:
        points: corners of every view, pixels.
        rotations, translations: (P,3,3), (P,3) of the board in the camera.
    """
    cells = filled_cells(np.concatenate([np.zeros((0, 2)), *points]), image_size)
    normals = rotations[:, :, 2] * np.sign(rotations[:, 2, 2])[:, None]
    tilts = np.rad2deg(np.arctan2(normals[:, :2], normals[:, 2:]))
    return cells, tuple(_advice({"": cells}, np.linalg.norm(translations, axis=1), tilts))


def _emptiest(seen: BoolArray) -> str:
    """The 2 x 2 cells, of the image's four corners and its middle, with the fewest seen."""
    places = {
        f"{_ROWS[r]} {_COLUMNS[c]} corner": seen[rows, columns].mean()
        for r, rows in ((0, slice(0, 2)), (4, slice(3, 5)))
        for c, columns in ((0, slice(0, 2)), (4, slice(3, 5)))
    }
    places["middle"] = seen[1:4, 1:4].mean()
    return min(places, key=lambda name: places[name])
