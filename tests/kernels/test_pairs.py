"""Compiled kernels compute what their numpy definitions say."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest
from kernel_pairs import LENSES, PAIRS, PRIOR, Pair, arrays, corners_in_view, small_rotations

from lmkit.kernels import load
from lmkit.kernels.lens import corners_through_lens, corners_through_lens_numpy
from lmkit.kernels.reprojection import (
    NO_PRIOR,
    corner_chi2,
    pose_equations,
    pose_equations_numpy,
    refine_poses,
    refine_poses_numpy,
    turns,
)
from lmkit.kernels.square_pose import square_poses, square_poses_numpy

needs_library = pytest.mark.skipif(load.library() is None, reason=load.describe())


def doubled(argument: Any) -> Any:
    """Wrappers convert single precision, definitions take double precision."""
    single = isinstance(argument, np.ndarray) and argument.dtype == np.float32
    return argument.astype(np.float64) if single else argument


@needs_library
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("pair", PAIRS, ids=lambda pair: pair.name)
def test_compiled_equals_numpy(pair: Pair, seed: int):
    for arguments in pair.arguments(np.random.default_rng(seed)):
        with np.errstate(all="ignore"):
            # Kernels whose results must agree in every bit compute in single precision.
            given = arguments if pair.tolerance == 0 else tuple(map(doubled, arguments))
            ours, defined = arrays(pair.compiled(*arguments)), arrays(pair.numpy(*given))
        assert len(ours) == len(defined)
        for mine, theirs in zip(ours, defined, strict=True):
            assert mine.shape == theirs.shape
            finite = theirs[np.isfinite(theirs)]
            scale = float(np.abs(finite).max()) if finite.size else 1.0
            np.testing.assert_allclose(mine, theirs, rtol=0, atol=pair.tolerance * max(scale, 1.0))


@needs_library
@pytest.mark.parametrize("pair", PAIRS, ids=lambda pair: pair.name)
def test_compiled_gives_the_same_bits_twice(pair: Pair):
    for arguments in pair.arguments(np.random.default_rng(0)):
        with np.errstate(all="ignore"):
            first, second = arrays(pair.compiled(*arguments)), arrays(pair.compiled(*arguments))
        for one, other in zip(first, second, strict=True):
            assert one.tobytes() == other.tobytes()


@pytest.mark.parametrize("equations", [pose_equations, pose_equations_numpy])
@pytest.mark.parametrize("uncertain", [False, True])
@pytest.mark.parametrize("prior", [NO_PRIOR, PRIOR])
def test_gradients_are_those_of_differences(equations, uncertain, prior):
    rng = np.random.default_rng(5)
    corners, R, p = corners_in_view(rng, 3, uncertain), small_rotations(rng, 1, 0.1), np.full((1, 3), 0.05)
    used = np.ones((1, 3), dtype=bool)
    _, gradient, _ = equations(corners, prior, R, p, used)
    step = 1e-6
    for k in range(6):
        move = np.zeros((1, 6))
        move[0, k] = step
        ahead, behind = (
            equations(corners, prior, turns(sign * move[:, 3:]) @ R, p + sign * move[:, :3], used)[2]
            for sign in (1, -1)
        )
        slope = -(ahead - behind) / (4 * step)
        # The landmark's own derivative also changes with the pose, which is of second order in the residuals.
        tolerance = 1e-5 if not uncertain else 0.02
        np.testing.assert_allclose(slope, gradient[:, k], atol=tolerance * np.abs(gradient).max())


@pytest.mark.parametrize("refine", [refine_poses, refine_poses_numpy])
def test_refined_poses_agree_from_everywhere(refine):
    rng = np.random.default_rng(6)
    corners = corners_in_view(rng, 4, False)
    R, p = small_rotations(rng, 5, 0.03), 0.1 * rng.normal(size=(5, 3))
    R, p = refine(corners, NO_PRIOR, R, p, np.ones((5, 4), dtype=bool), 20, 1e-6, 1e6)
    np.testing.assert_allclose(R, np.tile(R[0], (5, 1, 1)), atol=1e-6)
    np.testing.assert_allclose(p, np.tile(p[0], (5, 1)), atol=1e-6)
    np.testing.assert_allclose(R[0] @ R[0].T, np.eye(3), atol=1e-12)


@pytest.mark.parametrize("through", [corners_through_lens, corners_through_lens_numpy])
@pytest.mark.parametrize("lens", LENSES, ids=lambda lens: f"{len(lens.distortion)}{'f' if lens.fisheye else ''}")
def test_lenses_are_those_of_opencv(through, lens):
    rng = np.random.default_rng(2)
    true = rng.uniform(-0.4, 0.4, (6, 4, 2))
    points = np.concatenate([true, np.ones((6, 4, 1))], axis=2).reshape(-1, 1, 3)
    project = cv2.fisheye.projectPoints if lens.fisheye else cv2.projectPoints
    pixels, J = project(points, np.zeros(3), np.zeros(3), lens.K, lens.distortion)
    rays, by_ray, whitener, reached = through(lens, pixels.reshape(6, 4, 2), None, 0.1, 0.5)
    assert reached.all()
    np.testing.assert_allclose(rays, true, atol=1e-9)
    shift = 11 if lens.fisheye else 3
    theirs = J.reshape(6, 4, 2, -1)[..., shift : shift + 2]
    np.testing.assert_allclose(by_ray, theirs, atol=1e-6 * np.abs(theirs).max())
    np.testing.assert_allclose(whitener[:, :2, :2], by_ray[:, 0] / 0.1, atol=1e-9 * np.abs(by_ray).max())


def test_covariances_whiten():
    rng = np.random.default_rng(3)
    A = rng.normal(size=(1, 8, 8))
    C = A @ A.transpose(0, 2, 1)
    _, by_ray, whitener, _ = corners_through_lens(LENSES[2], rng.uniform(100, 300, (1, 4, 2)), C, 0.1, 0.5)
    J = np.zeros((8, 8))
    for c in range(4):
        J[2 * c : 2 * c + 2, 2 * c : 2 * c + 2] = by_ray[0, c]
    W = whitener[0] @ np.linalg.inv(J)
    np.testing.assert_allclose(W @ (C[0] + 0.01 * np.eye(8)) @ W.T, np.eye(8), atol=1e-9)
    with pytest.raises(np.linalg.LinAlgError):
        corners_through_lens(LENSES[2], np.ones((1, 4, 2)), -np.eye(8)[None], 0.1, 0.5)


@pytest.mark.parametrize("both", [square_poses, square_poses_numpy])
def test_one_of_both_poses_of_a_square_is_the_true_one(both):
    rng = np.random.default_rng(4)
    square = 0.09 * np.array([[-1, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]])
    for turn in [*small_rotations(rng, 20, 0.6), np.eye(3)]:
        R, t = turn @ np.diag([1.0, -1, -1]), rng.normal(size=3) * [0.4, 0.4, 0.2] + np.array([0, 0, 2])
        seen = square @ R.T + t
        found, shifts, errors = both((seen[:, :2] / seen[:, 2:])[None], np.array([0.18]))
        assert errors[0, 0] < 1e-9 and errors[0, 0] <= errors[0, 1]
        np.testing.assert_allclose(found[0, 0], R, atol=1e-7)
        np.testing.assert_allclose(shifts[0, 0], t, atol=1e-7)
        np.testing.assert_allclose(np.linalg.det(found[0]), 1, atol=1e-9)


def test_other_shapes_are_refused():
    corners = corners_in_view(np.random.default_rng(0), 2, True)
    with pytest.raises(ValueError, match="shape"):
        corner_chi2(corners, np.eye(3), np.zeros((1, 3)))
    with pytest.raises(ValueError, match="shape"):
        pose_equations(corners, NO_PRIOR, np.eye(3)[None], np.zeros((1, 3)), np.ones((1, 3), dtype=bool))
    with pytest.raises(ValueError, match="arms"):
        replace(corners, arms=None)
    with pytest.raises(ValueError, match="shape"):
        replace(corners, rays=corners.rays[:1])
