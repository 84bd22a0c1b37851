"""Every kernel beside its numpy definition, with seeded random and hostile arguments.

Run as a program, it calls every kernel with all of its arguments and prints digests of what they return: to compare
libraries, and for those with sanitizers.
"""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from pattern_kernel_pairs import PATTERN_CALLS
from planning_kernel_pairs import PLANNING_CALLS

from lmkit.kernels import load
from lmkit.kernels.block_chain import (
    Cuts,
    backward_chain,
    backward_chain_numpy,
    factor_chain,
    factor_chain_numpy,
    forward_chain,
    forward_chain_numpy,
    put_blocks,
    put_blocks_numpy,
    subtract_piece,
    subtract_piece_numpy,
    take_columns,
    take_columns_numpy,
    used_columns,
    used_columns_numpy,
)
from lmkit.kernels.face_swelling import (
    SIZE,
    FaceSums,
    add_face_equations,
    add_face_equations_numpy,
    outward,
    outward_numpy,
)
from lmkit.kernels.frame_search import search_frames, search_frames_numpy
from lmkit.kernels.landmark_bundle import (
    Bundle,
    Sums,
    add_bundle_equations,
    add_bundle_equations_numpy,
    bundle_chi2,
    bundle_chi2_numpy,
)
from lmkit.kernels.lasting_errors import Image, Shared, lasting_errors, lasting_errors_numpy
from lmkit.kernels.lens import Lens, corners_through_lens, corners_through_lens_numpy
from lmkit.kernels.pose_search import (
    Search,
    pose_covariance,
    pose_covariance_numpy,
    search_poses,
    search_poses_numpy,
)
from lmkit.kernels.pose_update import Update, update_planar, update_planar_numpy, update_space, update_space_numpy
from lmkit.kernels.reprojection import (
    NO_PRIOR,
    Corners,
    corner_chi2,
    corner_chi2_numpy,
    pose_equations,
    pose_equations_numpy,
    refine_poses,
    refine_poses_numpy,
)
from lmkit.kernels.square_pose import square_poses, square_poses_numpy
from lmkit.kernels.wheel_motion import (
    Moves,
    WheelRows,
    wheel_motions,
    wheel_motions_numpy,
    wheel_steps,
    wheel_steps_numpy,
)
from lmkit.optim.border_blocks import BlockPattern


@dataclass(frozen=True)
class Pair:
    """A kernel's wrapper, the numpy function that defines it, and argument lists for both.

    ``tolerance`` is relative to the largest value of an array: 1e-12 in double, 1e-5 in single precision.
    """

    compiled: Callable[..., Any]
    numpy: Callable[..., Any]
    arguments: Callable[[np.random.Generator], Iterator[tuple[Any, ...]]]
    tolerance: float = 1e-12

    @property
    def name(self) -> str:
        return self.compiled.__name__


def rotations(rng: np.random.Generator, count: int) -> np.ndarray:
    if count == 0:
        return np.zeros((0, 3, 3))
    q, _ = np.linalg.qr(rng.normal(size=(count, 3, 3)))
    return q * np.linalg.det(q)[:, None, None]


def small_rotations(rng: np.random.Generator, count: int, size: float) -> np.ndarray:
    return np.array([cv2.Rodrigues(size * rng.normal(size=3))[0] for _ in range(count)]).reshape(-1, 3, 3)


PRIOR = (0.3, 0.1, 0.1, 0.05, 0.1, 0.99, 0.1, 0.02)


def corners_in_view(rng: np.random.Generator, count: int, uncertain: bool, noise: float = 1e-3) -> Corners:
    """Landmarks a few meters in front of a rig near the origin that looks along z, as its cameras see them."""
    center = rng.normal(size=(count, 1, 3)) * [1, 0.5, 0.5] + np.array([0, 0, 4])
    arms = 0.1 * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) @ small_rotations(rng, count, 0.5)
    R, t = small_rotations(rng, count, 0.01), 0.05 * rng.normal(size=(count, 3))
    seen = np.einsum("sij,scj->sci", R, center + arms) + t[:, None]
    rays = seen[..., :2] / seen[..., 2:] + noise * rng.normal(size=(count, 4, 2))
    roots = 0.001 * rng.normal(size=(count, 6, 6)) if uncertain else None
    return Corners(
        center + arms, rays, 400 * small_rotations(rng, 4 * count, 0.1)[:, :2, :2].reshape(count, 4, 2, 2),
        2000 * (np.eye(8) + 0.1 * rng.normal(size=(count, 8, 8))), R, t, arms, roots,
        np.arange(count) // 2 - 1,
    )  # fmt: skip


def hostile_corners(rng: np.random.Generator, count: int) -> Corners:
    """Landmarks all around, behind and inside the camera; no observation fits a pose."""
    return Corners(
        rng.normal(size=(count, 4, 3)), rng.normal(size=(count, 4, 2)), rng.normal(size=(count, 4, 2, 2)),
        rng.normal(size=(count, 8, 8)), rotations(rng, count), rng.normal(size=(count, 3)),
        rng.normal(size=(count, 4, 3)), 1e-4 * rng.normal(size=(count, 6, 6)), rng.integers(-1, 3, count),
    )  # fmt: skip


def _chi2_calls(rng: np.random.Generator) -> Iterator[tuple[Any, ...]]:
    for poses, observations in [(1, 1), (7, 3), (5, 8), (0, 3), (3, 0), (0, 0)]:
        R, p = small_rotations(rng, poses, 0.02), 0.1 * rng.normal(size=(poses, 3))
        for uncertain in (False, True):
            corners = corners_in_view(rng, observations, uncertain)
            yield corners, R, p
            yield corners, np.full_like(R, np.nan), p
            # Fortran's order, single precision, every other row of a larger array.
            yield corners, np.asfortranarray(R), np.repeat(p, 2, axis=0)[::2]
            yield corners, R.astype(np.float32), p
        yield hostile_corners(rng, observations), rotations(rng, poses), p


def _equation_calls(rng: np.random.Generator) -> Iterator[tuple[Any, ...]]:
    for corners, R, p in _chi2_calls(rng):
        used = rng.uniform(size=(len(R), len(corners))) < 0.8
        for prior in (NO_PRIOR, PRIOR, (*PRIOR[:4], *NO_PRIOR[4:])):
            yield corners, prior, R, p, used


def _refine_calls(rng: np.random.Generator) -> Iterator[tuple[Any, ...]]:
    for poses, observations in [(1, 3), (7, 3), (5, 8), (0, 3)]:
        R, p = small_rotations(rng, poses, 0.02), 0.1 * rng.normal(size=(poses, 3))
        used = np.ones((poses, observations), dtype=bool)
        used[:, ::4] = False
        for uncertain in (False, True):
            for prior in (NO_PRIOR, PRIOR):
                yield corners_in_view(rng, observations, uncertain), prior, R, p, used, 5, 1e-2, 1e6
    # No observation, or NaN: the pose stays.
    R, p = small_rotations(rng, 2, 0.02), np.zeros((2, 3))
    yield corners_in_view(rng, 0, False), NO_PRIOR, R, p, np.ones((2, 0), dtype=bool), 5, 1e-2, 1e6
    yield corners_in_view(rng, 2, True), PRIOR, np.full_like(R, np.nan), p, np.ones((2, 2), dtype=bool), 9, 1e-2, 1e6


SEARCH = Search(0.25, 8 * 4.5**2, 25.0, np.deg2rad(2.0), 0.05, 2, 8)


def landmarks_in_view(rng: np.random.Generator, count: int, uncertain: bool, noise: float) -> Corners:
    """Upright squares as both cameras of a rig see them, each twice."""
    at, into = rng.normal(size=(count, 1, 3)) * [1, 0.5, 0.5] + np.array([0, 0, 3]), np.diag([1.0, -1, -1])
    square = 0.09 * np.array([[-1, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]])
    points = np.tile(square @ (small_rotations(rng, count, 0.4) @ into).transpose(0, 2, 1) + at, (2, 1, 1))
    t = np.repeat([[0.0, 0, 0], [-0.12, 0, 0]], count, axis=0)
    seen = points + t[:, None]
    rays = seen[..., :2] / seen[..., 2:] + noise * rng.normal(size=(2 * count, 4, 2))
    roots = 0.001 * rng.normal(size=(2 * count, 6, 6)) if uncertain else None
    by_ray = np.broadcast_to(400 * np.eye(2), (2 * count, 4, 2, 2))
    arms = points - points.mean(axis=1, keepdims=True)
    return Corners(
        points, rays, by_ray, np.broadcast_to(2000 * np.eye(8), (2 * count, 8, 8)),
        np.broadcast_to(np.eye(3), (2 * count, 3, 3)), t, arms, roots, np.tile(np.arange(count), 2),
    )  # fmt: skip


def _search_calls(rng: np.random.Generator) -> Iterator[tuple[Any, ...]]:
    for count in (1, 2, 5, 0):
        of = np.tile(np.arange(count), 2)
        for uncertain in (False, True):
            for prior in (NO_PRIOR, PRIOR):
                # None, one and all of the landmarks at their places in the map.
                corners = landmarks_in_view(rng, count, uncertain, 5e-4)
                if count > 2:
                    corners.rays[[0, count]] += 0.05
                yield corners, of, rng.uniform(20, 40, 2 * count), prior, SEARCH
    lost = landmarks_in_view(rng, 2, False, 1e-3)
    lost.rays[:] = np.nan
    yield lost, np.array([0, 1, 0, 1]), np.full(4, 30.0), NO_PRIOR, SEARCH


def _frame_calls(rng: np.random.Generator) -> Iterator[tuple[Any, ...]]:
    """Frames of 0, 1, 2 and 5 landmarks, and one whose corners are not numbers."""
    counts = (0, 1, 5, 0, 2, 1)
    frames = [landmarks_in_view(rng, count, False, 5e-4) for count in counts]
    frames[2].rays[[0, 5]] += 0.05
    frames[-1].rays[:] = np.nan
    names = ("points", "rays", "by_ray", "whitener", "R_camera", "t_camera")
    corners = Corners(*(np.concatenate([getattr(frame, name) for frame in frames]) for name in names))
    starts = np.cumsum([0, *(2 * count for count in counts)])
    of = np.concatenate([np.tile(np.arange(count), 2) for count in counts])
    for most in (1, 4):
        yield corners, starts, of, rng.uniform(20, 40, len(of)), SEARCH, most
    yield landmarks_in_view(rng, 0, False, 0.0), np.zeros(1, dtype=np.int64), of[:0], np.zeros(0), SEARCH


def _found(search: Any) -> Any:
    """The arrays of found poses."""

    def run(*arguments: Any) -> tuple[np.ndarray, ...]:
        found = search(*arguments)
        values = found.count, found.R, found.p, found.cost, found.chi2, found.covariance
        return tuple(np.nan_to_num(value.astype(np.float64), nan=-7.0, posinf=-9.0) for value in values)

    run.__name__ = search.__name__
    return run


def _covariance_calls(rng: np.random.Generator) -> Iterator[tuple[Any, ...]]:
    for count in (1, 4):
        for uncertain in (False, True):
            for prior in (NO_PRIOR, PRIOR):
                corners, used = landmarks_in_view(rng, count, uncertain, 5e-4), np.ones(2 * count, dtype=bool)
                yield corners, prior, small_rotations(rng, 1, 0.01)[0], 0.01 * rng.normal(size=3), used


def _lasting_calls(rng: np.random.Generator) -> Iterator[tuple[Any, ...]]:
    """Landmarks that were seen before and others, new places, and observations left out."""
    for corners, _, R, p, all_used in _covariance_calls(rng):
        S = len(corners)
        for N, used in ((6, all_used), (9, np.arange(S) % 2 == 0)):
            places = np.where(np.asarray(corners.group) >= 0, np.tile(np.arange(S // 2) + 1, 2), -1)
            seen = rng.uniform(0, 400, (S, 4, 2))
            image = Image(places, np.arange(S)[::-1] - 1, seen, rng.uniform(0, 1, S), S // 2 + 2)
            last = seen[::-1] + 2 * rng.normal(size=(S, 4, 2))
            X = rng.normal(size=(2, N, 6)), rng.normal(size=(S, N, 16))
            left, by_pull = 0.5 * rng.normal(size=(N, N)), 1e-3 * rng.normal(size=(N, 6))
            before = Shared(np.cov(rng.normal(size=(N, 2 * N))), X[0], last, X[1])
            yield corners, R, p, used, left, by_pull, image, (-0.7, -0.01), before
        start = Shared(np.zeros((6, 6)), np.zeros((0, 6, 6)), np.zeros((0, 4, 2)), np.zeros((0, 6, 16)))
        none = Image(np.full(S, -1), np.full(S, -1), seen, np.ones(S), 0)
        yield corners, R, p, all_used, np.eye(6), np.eye(6), none, (-0.7, -0.01), start


def _account(update: Callable[..., Shared]) -> Callable[..., Any]:
    def run(*arguments: Any) -> tuple[np.ndarray, ...]:
        after = update(*arguments)
        return after.excess, after.places, after.pixels, after.corners

    run.__name__ = "lasting_errors"
    return run


def _wheel_calls(rng: np.random.Generator) -> Iterator[tuple[Any, ...]]:
    for count in (2, 3, 40):
        times = np.cumsum(rng.uniform(0.01, 0.2, count))
        rows = WheelRows(times, *(0.1 * rng.normal(size=(2, count))), *rng.uniform(0, 1, (2, count)))
        # Times in order and out of order, at rows, and before and after all rows.
        at = (
            np.linspace(-1, times[-1] + 1, 7),
            rng.uniform(0, times[-1], 6),
            times[[0, -1, 1]],
            times[:1],
            times[:0],
        )
        for asked in at:
            yield rows, asked, np.array([1.0, 1, 0, 0, 0, 0]) + 0.1 * rng.normal(size=(3, 6))
            yield rows, asked, np.array([[1.0, 1, 0, 0, 0, 0]])


def _wheel_step_calls(rng: np.random.Generator) -> Iterator[tuple[Any, ...]]:
    """Wheels with gaps between rows."""
    for rows, at, parameters in _wheel_calls(rng):
        seconds = np.diff(rows.times, prepend=rows.times[:1])
        own = WheelRows(rows.times, rows.forward, rows.turn, seconds, rows.rate)
        yield own, at, parameters[0], Moves((1e-4, 1e-4, 1e-5, 1e-5, 1e-4), 0.2, 0.12)


UPDATE = Update(1e-3, 8 * 4.5**2, 4)
# The camera looks along the base's x axis, which is the landmarks' z axis in `landmarks_in_view`.
BASE = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])


def _update_calls(rng: np.random.Generator) -> Iterator[tuple[Any, ...]]:
    for count in (1, 3, 5):
        for uncertain in (False, True):
            corners = landmarks_in_view(rng, count, uncertain, 2e-4)
            if count > 1:
                corners.rays[[0, count]] += 0.05  # one landmark was moved
            yield corners, np.tile(np.arange(count), 2)


def _space_calls(rng: np.random.Generator) -> Iterator[tuple[Any, ...]]:
    for corners, of in _update_calls(rng):
        before = np.diag(1 / rng.uniform(100, 1000, 6))
        yield corners, of, before, small_rotations(rng, 1, 0.02)[0], 0.02 * rng.normal(size=3), UPDATE


def _planar_calls(rng: np.random.Generator) -> Iterator[tuple[Any, ...]]:
    for corners, of in _update_calls(rng):
        for size in (3, 9):
            A = np.eye(size) + 0.2 * rng.normal(size=(size, size))
            before = A @ np.diag(1 / np.array([300.0, 300, 1000, *rng.uniform(10, 50, size - 3)])) @ A.T
            into = replace(corners, points=corners.points @ BASE.T)
            state = np.concatenate([0.02 * rng.normal(size=3), rng.normal(size=size - 3)])
            yield into, of, before, np.full(3, 1e5), BASE, np.zeros(3), state, UPDATE


LENS_K = np.array([[460.0, 0, 322], [0, 458, 239], [0, 0, 1]])
LENSES = [
    Lens(LENS_K, np.zeros(0), False),
    Lens(LENS_K, np.array([-0.21, 0.055, 0.0007, -0.0004]), False),
    Lens(LENS_K, np.array([-0.21, 0.055, 0.0007, -0.0004, 0.01]), False),
    Lens(LENS_K, np.array([0.4, 0.05, 0.0007, -0.0004, 0.01, 0.6, 0.08, 0.02]), False),
    Lens(LENS_K, np.array([0.4, 0.05, 0.0007, -0.0004, 0.01, 0.6, 0.08, 0.02, 1e-3, 1e-4, -1e-3, 2e-4]), False),
    Lens(
        LENS_K,
        np.array([0.4, 0.05, 0.0007, -0.0004, 0.01, 0.6, 0.08, 0.02, 1e-3, 1e-4, -1e-3, 2e-4, 0.02, -0.01]),
        False,
    ),
    Lens(LENS_K, np.array([0.02, -0.01, 0.003, -0.001]), True),
]


def _lens_calls(rng: np.random.Generator) -> Iterator[tuple[Any, ...]]:
    for lens in LENSES:
        for count in (0, 1, 5):
            A = 0.1 * rng.normal(size=(count, 8, 8))
            corners = rng.uniform(0, [640, 480], (count, 4, 2))
            yield lens, corners, A @ A.transpose(0, 2, 1), 0.06, 0.5
            yield lens, corners, None, 0.06, 0.5
        # The center itself; far outside the image; not a number.
        yield lens, np.broadcast_to([322.0, 239.0], (2, 4, 2)), None, 0.06, 0.5
        yield lens, np.full((1, 4, 2), np.nan), None, 0.06, 0.5


def _square_calls(rng: np.random.Generator) -> Iterator[tuple[Any, ...]]:
    square = np.array([[-0.5, 0.5, 0], [0.5, 0.5, 0], [0.5, -0.5, 0], [-0.5, -0.5, 0]])
    for count in (0, 1, 9):
        sizes = rng.uniform(0.05, 0.5, count)
        facing = np.diag([1.0, -1, -1])
        seen = (sizes[:, None, None] * square) @ (small_rotations(rng, count, 0.5) @ facing).transpose(0, 2, 1)
        seen = seen + rng.normal(size=(count, 1, 3)) * [0.5, 0.5, 0.2] + np.array([0, 0, 2])
        yield seen[..., :2] / seen[..., 2:] + 1e-4 * rng.normal(size=(count, 4, 2)), sizes
    # Head-on, a single point, not a number.
    yield 0.1 * (square @ np.diag([1.0, -1, 1]))[None, :, :2], np.array([0.2])
    yield np.full((1, 4, 2), np.nan), np.array([0.2])


def bundle_in_view(rng: np.random.Generator, poses: int, landmarks: int, observations: int, size: float) -> Bundle:
    """Rig poses near the origin and landmarks a few meters in front of them; large sizes are in any order."""
    return Bundle(
        rng.integers(poses, size=observations), rng.integers(landmarks, size=observations),
        rng.integers(3, size=observations),
        0.3 * rng.normal(size=(observations, 4, 2)), 400 * rng.normal(size=(observations, 4, 2, 2)),
        20 * (np.eye(8) + 0.1 * rng.normal(size=(observations, 8, 8))),
        small_rotations(rng, 3, 0.01 * size),
        0.05 * rng.normal(size=(3, 3)), small_rotations(rng, poses, 0.1 * size),
        size * 0.1 * rng.normal(size=(poses, 3)), small_rotations(rng, landmarks, 0.3 * size),
        size * 0.3 * rng.normal(size=(landmarks, 3)) + np.array([0, 0, 4]),
        0.1 * rng.normal(size=(landmarks, 4, 3)),
    )  # fmt: skip


def _bundle_calls(rng: np.random.Generator) -> Iterator[tuple[Any, ...]]:
    for shape in [(1, 1, 1), (5, 3, 20), (3, 7, 40), (2, 2, 0)]:
        for size in (1.0, 10.0):
            yield (bundle_in_view(rng, *shape, size),)


def _sums(bundle: Bundle, cameras: int, moving: bool) -> tuple[list[np.ndarray], Sums]:
    """Zeros to add to, with ``cameras`` unknown besides the first, between one other unknown and the swelling."""
    own, numbers = 1 + 6 * cameras + SIZE, np.minimum(bundle.mount, cameras)
    N, m = len(bundle.p), own + (6 * len(bundle.p_landmark) if moving else 0)
    pattern, place = BlockPattern.of_pairs(bundle.at, bundle.of, N, own, 6)
    arrays = [np.zeros(shape) for shape in ((N, 6, 6), (N, 6), (N, 6, own), (len(pattern.states), 6, 6), (m, m), m)]
    return arrays, Sums(*arrays, own, place if moving else None, numbers if cameras else None, 1)


def _bundle_sums(add: Callable[..., float]) -> Callable[..., Any]:
    """Result of a function that adds in place, on zeros, as a tuple."""

    def run(bundle: Bundle, used: np.ndarray, cameras: int, moving: bool, noise: float) -> tuple[Any, ...]:
        arrays, sums = _sums(bundle, cameras, moving)
        return (*arrays, add(bundle, used, 2.4, sums, noise))

    run.__name__ = "add_bundle_equations"
    return run


def _face_sums(add: Callable[..., None]) -> Callable[..., Any]:
    """Result of the function that adds the equations of the swelling of faces."""

    def run(bundle: Bundle, used: np.ndarray, cameras: int, moving: bool, noise: float) -> tuple[Any, ...]:
        pattern, place = BlockPattern.of_pairs(bundle.at, bundle.of, len(bundle.p), 0, 6)
        numbers = np.minimum(bundle.mount, cameras)
        faces = FaceSums.zeros(place, numbers, len(pattern.states), len(bundle.p_landmark), cameras)
        add(bundle, used * np.linspace(0.5, noise, len(used)), faces)
        return faces.border, faces.landmarks, faces.cameras, faces.corner, faces.gradient

    run.__name__ = "add_face_equations"
    return run


def _outward_calls(rng: np.random.Generator) -> Iterator[tuple[Any, ...]]:
    yield from _bundle_calls(rng)
    bundle = bundle_in_view(rng, 5, 3, 20, 1.0)
    # A face that is exactly a point; a lens that maps everything to a line.
    rays, by_ray, arms, point = bundle.rays.copy(), bundle.by_ray.copy(), bundle.arms.copy(), bundle.of == 0
    rays[point], by_ray[point], by_ray[~point], arms[0] = 0.0, 400 * np.eye(2), 1.0, 0.0
    yield (replace(bundle, rays=rays, by_ray=by_ray, arms=arms),)


def _subtracted(subtract: Callable[..., None]) -> Callable[..., Any]:
    def run(product: np.ndarray, first: int, between: int, columns: np.ndarray, cuts: Cuts) -> tuple[np.ndarray, ...]:
        after = Cuts(*(array.copy() for array in cuts.arrays))
        subtract(product, first, between, columns, after)
        return after.arrays

    run.__name__ = "subtract_piece"
    return run


def _subtract_calls(rng: np.random.Generator) -> Iterator[tuple[Any, ...]]:
    for count, size, wide, first, between, touched in [
        (1, 1, 1, 0, 1, 1), (3, 6, 7, 1, 2, 3), (2, 3, 40, 1, 1, 40), (0, 6, 5, 0, 0, 2), (2, 2, 0, 0, 2, 0),
    ]:  # fmt: skip
        shapes = (
            (count, size, size),
            (max(count - 1, 0), size, size),
            (count, size),
            (count, size, wide),
            (wide, wide),
        )
        cuts = Cuts(*(rng.normal(size=shape) for shape in (*shapes, (wide,))))
        all_ = size * between + touched + 1
        yield rng.normal(size=(all_, all_)), first, between, rng.permutation(wide)[:touched], cuts


def _chain_calls(rng: np.random.Generator) -> Iterator[tuple[Any, ...]]:
    for count, size in [(1, 1), (1, 6), (4, 6), (9, 3), (3, 2)]:
        A, following = rng.normal(size=(count, size, size)), 0.2 * rng.normal(size=(count - 1, size, size))
        yield A @ A.transpose(0, 2, 1) + 3 * np.eye(size), following


def _substitution_calls(rng: np.random.Generator) -> Iterator[tuple[Any, ...]]:
    for diagonal, following in _chain_calls(rng):
        for wide in (0, 1, 17):
            yield (
                factor_chain_numpy(diagonal, following),
                rng.normal(size=(diagonal.shape[0] * len(diagonal[0]), wide)),
            )


def _in_place(substitute: Callable[..., None]) -> Callable[..., Any]:
    """Result of a function that changes its last argument, on a copy of it."""

    def run(*arguments: np.ndarray) -> np.ndarray:
        after = arguments[-1].copy()
        substitute(*arguments[:-1], after)
        return after

    run.__name__ = substitute.__name__
    return run


def _column_calls(rng: np.random.Generator) -> Iterator[tuple[Any, ...]]:
    for rows, wide in [(1, 1), (12, 30), (0, 4), (3, 0)]:
        yield (rng.normal(size=(rows, wide)) * (rng.uniform(size=wide) < 0.5),)


def _take_calls(rng: np.random.Generator) -> Iterator[tuple[Any, ...]]:
    for (matrix,) in _column_calls(rng):
        columns = rng.permutation(matrix.shape[1])[:5]
        yield matrix, columns, np.zeros((len(matrix), len(columns)))


def _put_calls(rng: np.random.Generator) -> Iterator[tuple[Any, ...]]:
    for blocks, size, wide in [(1, 1, 1), (9, 6, 6), (7, 3, 2), (0, 6, 6)]:
        at = rng.permutation(20)[:blocks]
        yield rng.normal(size=(blocks, size, wide)), at // 5, at % 5, np.zeros((4 * size, 5 * wide))


def _bundle_sum_calls(rng: np.random.Generator) -> Iterator[tuple[Any, ...]]:
    for (bundle,) in _bundle_calls(rng):
        used = rng.uniform(size=len(bundle.at)) < 0.8
        for cameras in (0, 1, 2):
            for moving in (False, True):
                yield bundle, used, cameras, moving, 1.0 + cameras


PAIRS = [
    Pair(_subtracted(subtract_piece), _subtracted(subtract_piece_numpy), _subtract_calls),
    Pair(factor_chain, factor_chain_numpy, _chain_calls, 1e-11),
    Pair(_in_place(forward_chain), _in_place(forward_chain_numpy), _substitution_calls, 1e-11),
    Pair(_in_place(backward_chain), _in_place(backward_chain_numpy), _substitution_calls, 1e-11),
    Pair(used_columns, used_columns_numpy, _column_calls, 0),
    Pair(_in_place(take_columns), _in_place(take_columns_numpy), _take_calls, 0),
    Pair(_in_place(put_blocks), _in_place(put_blocks_numpy), _put_calls, 0),
    Pair(bundle_chi2, bundle_chi2_numpy, _bundle_calls),
    Pair(_bundle_sums(add_bundle_equations), _bundle_sums(add_bundle_equations_numpy), _bundle_sum_calls),
    Pair(outward, outward_numpy, _outward_calls),
    Pair(_face_sums(add_face_equations), _face_sums(add_face_equations_numpy), _bundle_sum_calls),
    Pair(corners_through_lens, corners_through_lens_numpy, _lens_calls, 1e-11),
    Pair(square_poses, square_poses_numpy, _square_calls, 1e-10),
    Pair(corner_chi2, corner_chi2_numpy, _chi2_calls),
    Pair(pose_equations, pose_equations_numpy, _equation_calls),
    Pair(refine_poses, refine_poses_numpy, _refine_calls, 1e-9),
    Pair(search_poses, search_poses_numpy, _search_calls, 1e-8),
    Pair(_found(search_frames), _found(search_frames_numpy), _frame_calls, 1e-8),
    Pair(update_space, update_space_numpy, _space_calls, 1e-8),
    Pair(update_planar, update_planar_numpy, _planar_calls, 1e-8),
    Pair(pose_covariance, pose_covariance_numpy, _covariance_calls, 1e-9),
    Pair(_account(lasting_errors), _account(lasting_errors_numpy), _lasting_calls, 1e-10),
    Pair(wheel_motions, wheel_motions_numpy, _wheel_calls),
    Pair(wheel_steps, wheel_steps_numpy, _wheel_step_calls, 1e-8),
    *[Pair(*call) for call in (*PATTERN_CALLS, *PLANNING_CALLS)],
]


def arrays(result: Any) -> list[np.ndarray]:
    """Results of a kernel, which returns one array or several."""
    return [np.asarray(part) for part in (result if isinstance(result, tuple) else (result,)) if part is not None]


def run_all() -> str:
    """Number of calls made, and one line for each kernel: the digest of all that it returns, with any NaN as one."""
    calls, lines = 0, []
    for pair in PAIRS:
        digest = hashlib.sha256()
        for arguments in pair.arguments(np.random.default_rng(1)):
            calls += 1
            for array in arrays(pair.compiled(*arguments)):
                numbers = np.where(np.isnan(array), np.nan, array) if array.dtype.kind == "f" else array
                digest.update(f"{array.dtype} {array.shape}".encode() + numbers.tobytes())
        lines.append(f"{pair.name} {digest.hexdigest()}")
    return "\n".join([f"{calls} calls", *lines])


if __name__ == "__main__":
    assert load.library() is not None, load.describe()
    with np.errstate(all="ignore"):
        sys.stdout.write(run_all() + "\n")
