"""Arguments for the kernels of planning and simulation: sights, coverage, rays that meet panels."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from lmkit.kernels.landmark_sights import (
    Camera,
    Pairs,
    add_information,
    add_information_numpy,
    faced_landmarks,
    faced_landmarks_numpy,
    seen_sides,
    seen_sides_numpy,
)
from lmkit.kernels.lens import Lens
from lmkit.kernels.line_of_sight import clear_lines, clear_lines_numpy
from lmkit.kernels.pose_coverage import (
    Coverage,
    change_coverage,
    change_coverage_numpy,
    planar_covariances,
    planar_covariances_numpy,
)
from lmkit.kernels.ray_panels import (
    box_mean,
    box_mean_numpy,
    meet_panel,
    meet_panel_numpy,
    paint_panel,
    paint_panel_numpy,
)

Calls = Iterator[tuple[Any, ...]]
LENS = Lens(np.array([[460.0, 0, 322], [0, 458, 239], [0, 0, 1]]), np.array([-0.2, 0.05, 7e-4, -4e-4, 0.0]), False)


def line_calls(rng: np.random.Generator) -> Calls:
    for shape in [(1, 1), (20, 30), (7, 200)]:
        free = rng.uniform(size=shape) < 0.97
        extent = np.array(shape[::-1]) * 0.05
        start, end = (rng.uniform(-0.1, 1.1, (200, 2)) * extent - 1.0 for _ in range(2))
        start[:5] = end[:5]
        start[5, 0] = np.nan
        end[6, 1] = np.inf
        yield free, 0.05, (-1.0, -1.0), 0.075, start, end
        yield np.asfortranarray(free), 0.05, (-1.0, -1.0), 0.075, start[:0], end[:0]


def looking_along_x(rng: np.random.Generator, count: int) -> np.ndarray:
    """(N,3,3) cameras on a floor that look about along x."""
    ahead = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    angle = rng.normal(size=count) * 0.4
    turned = np.zeros((count, 3, 3))
    turned[:, 0, 0] = turned[:, 1, 1] = np.cos(angle)
    turned[:, 1, 0], turned[:, 0, 1], turned[:, 2, 2] = np.sin(angle), -np.sin(angle), 1.0
    return turned @ ahead


def _landmarks(rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Centers and corners of squares on a wall a few meters away."""
    centers = np.column_stack([rng.uniform(2, 5, count), rng.normal(size=count), rng.uniform(0.5, 1.5, count)])
    square = 0.09 * np.array([[0, 1, 1], [0, -1, 1], [0, -1, -1], [0, 1, -1]])
    return centers, centers[:, None] + square


def facing_calls(rng: np.random.Generator) -> Calls:
    for poses, landmarks in [(1, 1), (30, 20), (0, 3), (3, 0)]:
        centers, _ = _landmarks(rng, landmarks)
        normals = np.tile([-1.0, 0.0, 0.0], (landmarks, 1)) + 0.3 * rng.normal(size=(landmarks, 3))
        p = rng.normal(size=(poses, 3))
        reach = rng.uniform(2, 6, landmarks)
        yield looking_along_x(rng, poses), p, centers, normals, reach, (0.1, 0.3, 0.6)


def _sight_pairs(rng: np.random.Generator) -> Iterator[tuple[Camera, Pairs]]:
    for count in (0, 1, 60):
        _, corners = _landmarks(rng, 9)
        p = rng.normal(size=(7, 3)) * [1, 1, 0.3] + np.array([0, 0, 1])
        pairs = Pairs(rng.integers(7, size=count), rng.integers(9, size=count), looking_along_x(rng, 7), p, corners)
        yield Camera(LENS, np.eye(3), np.array([-0.12, 0.0, 0.0]), (640, 480), 0.75, 0.15), pairs


def side_calls(rng: np.random.Generator) -> Calls:
    yield from _sight_pairs(rng)


def information_calls(rng: np.random.Generator) -> Calls:
    for camera, pairs in _sight_pairs(rng):
        yield camera, pairs, rng.uniform(-0.2, 1, len(pairs.at)), rng.normal(size=(len(pairs.at), 6, 6))


def changed_information(add: Callable[..., None]) -> Callable[..., Any]:
    def run(camera: Camera, pairs: Pairs, weights: np.ndarray, information: np.ndarray) -> np.ndarray:
        after = information.copy()
        add(camera, pairs, weights, after)
        return after

    run.__name__ = "add_information"
    return run


def _information(rng: np.random.Generator, count: int) -> np.ndarray:
    A = rng.normal(size=(count, 6, 6)) * 10
    return A @ A.transpose(0, 2, 1)


def covariance_calls(rng: np.random.Generator) -> Calls:
    known = np.array([1e-4, 1e-4, 4e4, 3.6e4, 3.6e4, 1e-4])
    for count in (0, 1, 20):
        yield _information(rng, count), rng.normal(size=(count, 3)), known
    yield np.zeros((2, 6, 6)), rng.normal(size=(2, 3)), known


def change_calls(rng: np.random.Generator) -> Calls:
    for places, headings, enough, asked in [(1, 1, 1, 0), (6, 8, 2, 2), (4, 24, 24, 1)]:
        count = places * headings
        for rows in (np.arange(count), np.arange(0, count, 3), np.zeros(0, dtype=int)):
            answer = _information(rng, len(rows))
            shown = rng.uniform(size=len(rows)) < 0.5
            start = (
                _information(rng, count) * rng.uniform(0, 100, (count, 1, 1)), rng.integers(0, 3, count),
                rng.normal(size=(count, 3)), np.array([1e-4, 1e-4, 4e4, 3.6e4, 3.6e4, 1e-4]), headings, enough, asked,
                0.01, 0.005, 10.0,
            )  # fmt: skip
            for apply in (False, True):
                yield start, rows, answer, shown, 1, apply


def changed_coverage(change: Callable[..., Any]) -> Callable[..., Any]:
    """Gain of a change, and all arrays afterwards; the change is made and undone."""

    def run(start: tuple[Any, ...], rows: np.ndarray, answer: np.ndarray, shown: np.ndarray, sign: int, apply: bool):
        coverage = Coverage(start[0].copy(), start[1].copy(), *start[2:])
        gains = change(coverage, rows, answer, shown, sign, apply)
        after = [getattr(coverage, name).copy() for name in ("information", "in_view", "scores", "held")]
        if apply:
            change(coverage, rows, answer, shown, -sign, apply)
        return (*gains, *after, coverage.held)

    run.__name__ = "change_coverage"
    return run


def panel_calls(rng: np.random.Generator) -> Calls:
    rays = rng.uniform(-0.6, 0.6, (37, 53, 2)).astype(np.float32)
    rays[3, 3] = np.nan
    depth = rng.uniform(0.5, 5, (37, 53)).astype(np.float32)
    depth[::2] = np.inf
    for window in ((slice(0, 37), slice(0, 53)), (slice(4, 20), slice(9, 60)), (slice(5, 5), slice(0, 3))):
        for distortion in (0.0, 0.05):
            R = looking_along_x(rng, 1)[0].T
            yield rays, depth, window, R, np.array([0.3, -0.2, -2.0]), (1.5, 0.8), distortion
            yield rays, depth, window, np.eye(3), np.array([0.1, 0.1, 0.0]), (1.5, 0.8), distortion


def paint_calls(rng: np.random.Generator) -> Calls:
    for window in ((slice(0, 9), slice(0, 8)), (slice(2, 5), slice(3, 8))):
        shape = (window[0].stop - window[0].start, window[1].stop - window[1].start)
        image, depth = rng.random((9, 8, 3), dtype=np.float32), rng.random((9, 8), dtype=np.float32)
        color, far = rng.random((*shape, 3), dtype=np.float32), rng.random(shape, dtype=np.float32)
        yield image, depth, window, rng.uniform(size=shape) < 0.5, color, far


def painted(paint: Callable[..., None]) -> Callable[..., Any]:
    def run(image: np.ndarray, depth: np.ndarray, *arguments: Any) -> tuple[np.ndarray, np.ndarray]:
        image, depth = image.copy(), depth.copy()
        paint(image, depth, *arguments)
        return image, depth

    run.__name__ = "paint_panel"
    return run


def mean_calls(rng: np.random.Generator) -> Calls:
    for height, width, size in [(1, 1, 1), (4, 5, 3), (12, 11, 2), (0, 3, 3)]:
        yield rng.random((height * size, width * size, 3), dtype=np.float32), size


PLANNING_CALLS = [
    (meet_panel, meet_panel_numpy, panel_calls, 0.0),
    (painted(paint_panel), painted(paint_panel_numpy), paint_calls, 0.0),
    (box_mean, box_mean_numpy, mean_calls, 0.0),
    (clear_lines, clear_lines_numpy, line_calls, 0.0),
    (faced_landmarks, faced_landmarks_numpy, facing_calls, 0.0),
    (seen_sides, seen_sides_numpy, side_calls, 1e-12),
    (changed_information(add_information), changed_information(add_information_numpy), information_calls, 1e-11),
    (planar_covariances, planar_covariances_numpy, covariance_calls, 1e-9),
    (changed_coverage(change_coverage), changed_coverage(change_coverage_numpy), change_calls, 1e-9),
]
