"""Compiled kernels compute what their numpy definitions say."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from kernel_pairs import PAIRS, Pair, _corners

from lmkit.kernels import load
from lmkit.kernels.reprojection import Corners, reprojection_errors, reprojection_errors_numpy

needs_library = pytest.mark.skipif(load.library() is None, reason=load.describe())


def arrays(result: Any) -> list[np.ndarray]:
    return [np.asarray(part) for part in (result if isinstance(result, tuple) else (result,)) if part is not None]


@needs_library
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("pair", PAIRS, ids=lambda pair: pair.name)
def test_compiled_equals_numpy(pair: Pair, seed: int):
    for arguments in pair.arguments(np.random.default_rng(seed)):
        with np.errstate(all="ignore"):
            ours, defined = arrays(pair.compiled(*arguments)), arrays(pair.numpy(*arguments))
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


@pytest.mark.parametrize("errors", [reprojection_errors, reprojection_errors_numpy])
def test_reprojection_derivatives_are_those_of_differences(errors):
    rng = np.random.default_rng(5)
    corners, R, p = _corners(rng, 3, 4.0), np.eye(3)[None], np.zeros((1, 3))
    here = errors(corners, R, p, True, True)
    step = 1e-6
    for k in range(6):
        move = np.zeros(6)
        move[k] = step
        turn = np.eye(3) + np.cross(np.eye(3), move[3:])
        rig = errors(corners, turn @ R, p + move[:3], False, False).residuals
        centre = corners.points - corners.arms
        moved = corners._replace(points=centre + move[:3] + corners.arms @ turn.T)
        landmark = errors(moved, R, p, False, False).residuals
        scale = np.abs(here.by_pose).max()
        np.testing.assert_allclose((here.residuals - rig) / step, here.by_pose[..., k], atol=1e-4 * scale)
        np.testing.assert_allclose((here.residuals - landmark) / step, here.by_landmark[..., k], atol=1e-4 * scale)


def test_reprojection_refuses_other_shapes():
    corners = _corners(np.random.default_rng(0), 2, 4.0)
    with pytest.raises(ValueError, match="shape"):
        reprojection_errors(corners, np.eye(3), np.zeros((1, 3)), False, False)
    with pytest.raises(ValueError, match="arms"):
        reprojection_errors(corners._replace(arms=np.zeros((0, 4, 3))), np.eye(3)[None], np.zeros((1, 3)), True, True)
    with pytest.raises(ValueError, match="shape"):
        Corners.of(np.zeros((2, 4, 3)), np.zeros((1, 4, 2)), *corners[2:])
