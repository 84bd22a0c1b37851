"""Compiled kernels compute what their numpy definitions say."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from kernel_pairs import PAIRS, PRIOR, Pair, corners_in_view, small_rotations

from lmkit.kernels import load
from lmkit.kernels.reprojection import (
    NO_PRIOR,
    corner_misfits,
    pose_equations,
    pose_equations_numpy,
    refine_poses,
    refine_poses_numpy,
    turns,
)

needs_library = pytest.mark.skipif(load.library() is None, reason=load.describe())


def arrays(result: Any) -> list[np.ndarray]:
    return [np.asarray(part) for part in (result if isinstance(result, tuple) else (result,)) if part is not None]


def doubled(argument: Any) -> Any:
    """Wrappers convert single precision, definitions take doubles."""
    single = isinstance(argument, np.ndarray) and argument.dtype == np.float32
    return argument.astype(np.float64) if single else argument


@needs_library
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("pair", PAIRS, ids=lambda pair: pair.name)
def test_compiled_equals_numpy(pair: Pair, seed: int):
    for arguments in pair.arguments(np.random.default_rng(seed)):
        with np.errstate(all="ignore"):
            ours, defined = arrays(pair.compiled(*arguments)), arrays(pair.numpy(*map(doubled, arguments)))
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
        # The landmark's own derivative moves with the pose, too; that is of second order in what does not fit.
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


def test_other_shapes_are_refused():
    corners = corners_in_view(np.random.default_rng(0), 2, True)
    with pytest.raises(ValueError, match="shape"):
        corner_misfits(corners, np.eye(3), np.zeros((1, 3)))
    with pytest.raises(ValueError, match="shape"):
        pose_equations(corners, NO_PRIOR, np.eye(3)[None], np.zeros((1, 3)), np.ones((1, 3), dtype=bool))
    with pytest.raises(ValueError, match="arms"):
        replace(corners, arms=None)
    with pytest.raises(ValueError, match="shape"):
        replace(corners, rays=corners.rays[:1])
