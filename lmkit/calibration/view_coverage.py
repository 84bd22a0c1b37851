"""Coverage of the views of a board - position, size, tilt - and the view to show next."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from lmkit.arrays import BoolArray, FloatArray
from lmkit.geometry.camera import CameraModel
from lmkit.model.observation import PairView

Size = tuple[int, int]
CELLS = 5
TILTED_DEG = 20.0
LEAST_TILTED = 2  # views tilted each way
LEAST_NEARER = 1.5  # farthest over nearest view
ENOUGH_CELLS = 0.8
LEAST_VIEWS = 10
ALL_CELLS: BoolArray = np.ones((CELLS, CELLS), dtype=bool)
_ROWS = ("top", "upper middle", "middle", "lower middle", "bottom")
_COLUMNS = ("left", "middle left", "middle", "middle right", "right")


TILT_WANTED_DEG = 35.0
TALLEST = 0.85  # largest share of the image's height that a wanted view fills


@dataclass(frozen=True)
class WantedView:
    """A view of the board to take next.

    Attributes:
        side: camera, 0 left, 1 right.
        center: of the board, (x, y) as shares of the image's width and height.
        fills: share of the image's width.
        tilt_deg: about the image's upright and about its level axis, as `ViewCoverage.tilts_deg`.
    """

    side: int = 0
    center: tuple[float, float] = (0.5, 0.5)
    fills: float = 0.5
    tilt_deg: tuple[float, float] = (0.0, 0.0)

    def pose(self, object_points: FloatArray, camera: CameraModel) -> tuple[FloatArray, FloatArray]:
        """Rotation (3,3) and translation (3,), m, of the board in the camera, for this view."""
        low, high = object_points.min(axis=0), object_points.max(axis=0)
        (width, height), K = camera.image_size, camera.K
        depth = max(K[0, 0] * (high - low)[0] / (self.fills * width), K[1, 1] * (high - low)[1] / (TALLEST * height))
        (c, s), (d, e) = ((np.cos(a), np.sin(a)) for a in np.deg2rad(self.tilt_deg))
        R = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]) @ np.array([[1, 0, 0], [0, d, e], [0, -e, d]])
        pixel = np.array([self.center[0] * width, self.center[1] * height, 1.0])
        return R, depth * np.linalg.solve(K, pixel) - R @ ((low + high) / 2)

    def outline(self, object_points: FloatArray, camera: CameraModel) -> FloatArray:
        """(4,2) corners of the board's pattern in the image, pixels, without the lens's distortion."""
        R, t = self.pose(object_points, camera)
        (x0, y0), (x1, y1) = object_points.min(axis=0)[:2], object_points.max(axis=0)[:2]
        corners = np.array([[x0, y0, 0], [x1, y0, 0], [x1, y1, 0], [x0, y1, 0]]) @ R.T + t
        pixels = corners @ camera.K.T
        return np.asarray(pixels[:, :2] / pixels[:, 2:])


@dataclass(frozen=True)
class ViewCoverage:
    """Coverage of the views so far.

    Attributes:
        cells: (5,5) of the left image and (5,5) of the right, True where corners were seen.
        distances_m: of every view, from the left camera.
        tilts_deg: (P,2) of every view: about the image's upright and about its level axis; positive
            where the board's right edge, or its lower edge, is nearer.
        advice: views to take next, the most wanted first.
        wanted: the first of them; None if no view is missing.
        visible: (5,5) cells of the left image and of the right that can show a board.
    """

    cells: tuple[BoolArray, BoolArray]
    distances_m: FloatArray
    tilts_deg: FloatArray
    advice: tuple[str, ...]
    wanted: WantedView | None = None
    visible: tuple[BoolArray, BoolArray] = (ALL_CELLS, ALL_CELLS)

    def filled(self, side: int) -> float:
        """Share of cells with corners among the cells of one camera (0 left, 1 right) that can show a board."""
        return _share(self.cells[side], self.visible[side])


def coverage_of(
    views: Sequence[PairView],
    rotations: FloatArray,
    translations: FloatArray,
    left_size: Size,
    right_size: Size,
    visible: tuple[BoolArray, BoolArray] = (ALL_CELLS, ALL_CELLS),
) -> ViewCoverage:
    """ViewCoverage of the pairs, with the board's poses (P,3,3), (P,3) in the left camera; sizes: (width, height).

    Args:
        visible: cells of the images that can show a board, once the lenses are known; see :func:`visible_cells`.
    """
    cells = tuple(
        filled_cells(np.concatenate([np.zeros((0, 2)), *(getattr(view, side) for view in views)]), size)
        for side, size in (("left", left_size), ("right", right_size))
    )
    distances = np.linalg.norm(translations, axis=1)
    # The board's normal, turned so that it looks away from the camera.
    normals = rotations[:, :, 2] * np.sign(rotations[:, 2, 2])[:, None]
    tilts = np.rad2deg(np.arctan2(normals[:, :2], normals[:, 2:]))
    both = (cells[0], cells[1])
    wanted = _wanted(dict(zip(("left ", "right "), zip(both, visible, strict=True), strict=True)), distances, tilts)
    advice = tuple(words for words, _ in wanted)
    return ViewCoverage(both, distances, tilts, advice, wanted[0][1] if wanted else None, visible)


def filled_cells(points: FloatArray, image_size: tuple[int, int]) -> BoolArray:
    """(5,5) True where at least one of (N,2) points lies."""
    column, row = np.floor((points + 0.5) / np.array(image_size) * CELLS).clip(0, CELLS - 1).astype(int).T
    cells = np.zeros((CELLS, CELLS), dtype=bool)
    cells[row, column] = True
    return cells


def visible_cells(camera: CameraModel) -> BoolArray:
    """(5,5) False for cells outside the image circle of a wide fisheye lens, or beyond 90 deg off its axis."""
    width, height = camera.image_size
    x, y = np.meshgrid(
        (np.arange(CELLS) + 0.5) / CELLS * width - 0.5, (np.arange(CELLS) + 0.5) / CELLS * height - 0.5
    )
    return camera.is_ahead(np.column_stack([x.ravel(), y.ravel()])).reshape(CELLS, CELLS)


def covered_share(cells: BoolArray, camera: CameraModel) -> float:
    """Share of cells with corners among the (5,5) cells that can show a board."""
    return _share(cells, visible_cells(camera))


def _share(seen: BoolArray, visible: BoolArray) -> float:
    return float(seen[visible].mean()) if visible.any() else 0.0


def _wanted(
    cells: Mapping[str, tuple[BoolArray, BoolArray]], distances: FloatArray, tilts: FloatArray
) -> list[tuple[str, WantedView]]:
    """Views to take next, in words and as places in the image; from the cells with corners and the visible cells."""
    wanted = []
    for name, axis, toward in (("left", 0, -1), ("right", 0, 1), ("upper", 1, -1), ("lower", 1, 1)):
        count = int((toward * tilts[:, axis] > TILTED_DEG).sum())
        if count < LEAST_TILTED:
            tilt = toward * TILT_WANTED_DEG
            view = WantedView(tilt_deg=(tilt, 0.0) if axis == 0 else (0.0, tilt))
            wanted.append((f"the board tilted by 30 to 45 deg, its {name} edge nearer", view))
    for side, (camera, (seen, visible)) in enumerate(cells.items()):
        if _share(seen, visible) < ENOUGH_CELLS:
            place, center = _emptiest(seen, visible)
            view = WantedView(side, center, 0.55 if place == "middle" else 0.4)
            wanted.append((f"the board in the {place} of the {camera}image", view))
    if len(distances) and distances.max() < LEAST_NEARER * distances.min():
        wanted.append(("the board nearer, so that it fills the image, and twice as far", WantedView(fills=0.85)))
    if len(distances) < LEAST_VIEWS:
        wanted.append((f"{LEAST_VIEWS - len(distances)} more views", WantedView(tilt_deg=(15.0, 15.0))))
    return wanted


def camera_coverage(
    points: Sequence[FloatArray], rotations: FloatArray, translations: FloatArray, camera: CameraModel
) -> tuple[BoolArray, tuple[str, ...]]:
    """(5,5) cells of one camera's image in which corners were seen, and the views to take next.

    Args:
        points: corners of every view, pixels.
        rotations, translations: (P,3,3), (P,3) of the board in the camera.
    """
    cells = filled_cells(np.concatenate([np.zeros((0, 2)), *points]), camera.image_size)
    normals = rotations[:, :, 2] * np.sign(rotations[:, 2, 2])[:, None]
    tilts = np.rad2deg(np.arctan2(normals[:, :2], normals[:, 2:]))
    wanted = _wanted({"": (cells, visible_cells(camera))}, np.linalg.norm(translations, axis=1), tilts)
    return cells, tuple(words for words, _ in wanted)


def _emptiest(seen: BoolArray, visible: BoolArray) -> tuple[str, tuple[float, float]]:
    """Name and center of the block of 2 x 2 cells (image corners and middle) with the fewest detected corners."""

    def share(*block: slice) -> float:
        return _share(seen[block], visible[block]) if visible[block].any() else 1.0

    near, far = 1 / CELLS, 1 - 1 / CELLS
    places = {
        (f"{_ROWS[r]} {_COLUMNS[c]} corner", (near if c == 0 else far, near if r == 0 else far)): share(rows, columns)
        for r, rows in ((0, slice(0, 2)), (4, slice(3, 5)))
        for c, columns in ((0, slice(0, 2)), (4, slice(3, 5)))
    }
    places["middle", (0.5, 0.5)] = share(slice(1, 4), slice(1, 4))
    return min(places, key=lambda place: places[place])
