"""Nested dissection against the dense solution, on graphs of every kind."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import sparse

from lmkit.optim import information_sum
from lmkit.optim.information_sum import InformationSum, unknowns_of
from lmkit.optim.nested_dissection import dissect, solve_by_dissection


@settings(max_examples=25)
@given(st.integers(0, 2**32 - 1), st.integers(1, 150), st.integers(1, 3), st.integers(2, 12))
def test_it_solves_as_the_dense_equations_do(seed, count, size, width):
    """Landmarks along a corridor; each recording sees some that are near each other, and gaps divide the corridor."""
    rng = np.random.default_rng(seed)
    H, b = np.zeros((size * count, size * count)), np.zeros(size * count)
    keys: dict[tuple[int, int], np.ndarray] = {}
    spans = [np.arange(a, min(a + width, count)) for a in range(0, count, max(width // 2, 1)) if rng.random() < 0.9]
    for rows in [rng.permutation(span) for span in spans] + [np.array([k]) for k in range(count)]:
        A = rng.normal(size=(size * len(rows), size * len(rows)))
        own, at = A @ A.T + np.eye(len(A)), unknowns_of(rows, size)
        H[at[:, None], at] += own
        b[at] += rng.normal(size=len(at))
        for i in rows:
            for j in rows[rows >= i]:
                keys[i, j] = H[size * i : size * i + size, size * j : size * j + size]
    pairs = np.array(list(keys)).T
    found = solve_by_dissection(count, size, (pairs[0], pairs[1]), np.array(list(keys.values())), b)
    np.testing.assert_allclose(found, np.linalg.solve(H, b), rtol=1e-6, atol=1e-9)


def test_many_landmarks_are_summed_and_solved_without_the_dense_matrix(monkeypatch):
    """Sums made in several rounds give the dense solution of the same recordings."""
    rng = np.random.default_rng(3)
    seen = [rng.permutation(np.arange(a, a + 12)) for a in rng.integers(0, 188, 300)]
    parts = [(rows, np.cov(rng.normal(size=(24, 60))), rng.normal(size=24)) for rows in seen]
    parts += [(np.array([k]), np.eye(2), np.zeros(2)) for k in range(200)]
    dense = InformationSum(200, 2)
    monkeypatch.setattr(information_sum, "DENSE_BELOW", 0)
    monkeypatch.setattr(information_sum, "MOST_PENDING", 5000)
    large = InformationSum(200, 2)
    for part in parts:
        dense.add(*part)
        large.add(*part)
    np.testing.assert_allclose(large.solve(), dense.solve(), rtol=1e-9)
    np.testing.assert_allclose(large.covariance(), dense.covariance(), atol=1e-12)


def test_every_node_is_eliminated_once_and_what_follows_is_its_boundary():
    side = 15
    line = sparse.diags([1.0, 1.0, 1.0], [-1, 0, 1], shape=(side, side))
    grid = sparse.kron(line, line).tocsr()
    fronts = dissect(grid)
    assert sorted(np.concatenate([front.own for front in fronts])) == list(range(side**2))
    turn = {int(node): k for k, front in enumerate(fronts) for node in front.own}
    for k, front in enumerate(fronts):
        assert all(turn[int(node)] > k for node in front.boundary)
        later = {int(n) for node in front.own for n in grid[int(node)].indices if turn[int(n)] > k}
        assert later <= set(front.boundary.tolist())
    assert max(len(front.own) for front in fronts) < 3 * side


def test_what_is_not_determined_is_refused():
    pairs = np.array([0, 0, 1]), np.array([0, 1, 1])
    with pytest.raises(np.linalg.LinAlgError):
        solve_by_dissection(2, 1, pairs, np.array([[[1.0]], [[1.0]], [[1.0]]]), np.zeros(2))
