"""The chain solver against dense matrices."""

from dataclasses import replace

import numpy as np
import pytest

from lmkit.optim.block_chain import ChainEquations
from lmkit.optim.border_blocks import BlockPattern, BorderBlocks


def random_problem(count, size, shared, seed):
    """Equations as a chain and as a dense matrix."""
    rng = np.random.default_rng(seed)
    total = count * size + shared
    chain = ChainEquations.zeros(count, size, shared)
    chain.diagonal += 0.1 * np.eye(size)
    chain.corner += 0.1 * np.eye(shared)
    H, g = 0.1 * np.eye(total), np.zeros(total)
    states = rng.integers(0, count, 3 * count)
    J, r = rng.normal(size=(len(states), 2, size)), rng.normal(size=(len(states), 2))
    columns = np.array([rng.choice(shared, 2, replace=False) for _ in states])
    K = rng.normal(size=(len(states), 2, 2))
    chain.add_to_states(states, J, r)
    chain.add_shared(states, J, columns, K, r)
    for k, state in enumerate(states):
        row = np.zeros((2, total))
        row[:, state * size : (state + 1) * size] = J[k]
        row[:, count * size + columns[k]] += K[k]
        H, g = H + row.T @ row, g + row.T @ r[k]
    before, after = rng.normal(size=(2, count - 1, size, size))
    between = rng.normal(size=(count - 1, size))
    chain.add_between(before, after, between)
    for k in range(count - 1):
        row = np.zeros((size, total))
        row[:, k * size : (k + 1) * size], row[:, (k + 1) * size : (k + 2) * size] = before[k], after[k]
        H, g = H + row.T @ row, g + row.T @ between[k]
    return chain, H, g


@pytest.mark.parametrize(
    ("count", "size", "shared"), [(1, 3, 2), (2, 6, 4), (9, 3, 7), (21, 2, 3), (22, 3, 2), (23, 2, 5), (70, 2, 9)]
)
def test_steps_and_covariances_are_those_of_the_dense_matrix(count, size, shared):
    chain, H, g = random_problem(count, size, shared, seed=count)
    states, rest = chain.solve()
    assert np.concatenate([states.ravel(), rest]) == pytest.approx(np.linalg.solve(H, g), abs=1e-10)
    C = np.linalg.inv(H)
    own, across, corner = chain.covariances()
    assert corner == pytest.approx(C[count * size :, count * size :], abs=1e-10)
    blocks = C[: count * size, : count * size].reshape(count, size, count, size)
    for k in range(count):
        assert own[k] == pytest.approx(blocks[k, :, k], abs=1e-10)
    for k in range(count - 1):
        assert across[k] == pytest.approx(blocks[k, :, k + 1], abs=1e-10)


@pytest.mark.parametrize(("count", "groups"), [(1, 1), (9, 4), (22, 2), (50, 7)])
def test_blocks_are_the_border_without_its_zeros(count, groups):
    first, size = 2, 3
    chain, _, _ = random_problem(count, 2, first + size * groups, seed=count)
    rng = np.random.default_rng(count)
    pattern, place = BlockPattern.of_pairs(
        rng.integers(0, count, 4 * count), rng.integers(0, groups, 4 * count), count, first, size
    )
    assert (np.diff(pattern.states) >= 0).all()
    assert place.max() == len(pattern.states) - 1
    touched = np.zeros((count, groups, size), dtype=bool)
    touched[pattern.states, pattern.groups] = True
    dense = replace(chain, border=chain.border.copy(), corner=chain.corner + 50 * np.eye(len(chain.corner)))
    dense.border[:, :, first:] *= touched.reshape(count, 1, -1)
    values = dense.border[:, :, first:].reshape(count, 2, groups, size)[pattern.states, :, pattern.groups]
    sparse = replace(dense, border=dense.border[:, :, :first], blocks=BorderBlocks(values, pattern))
    assert (sparse.dense_border() == dense.border).all()
    for a, b in [(sparse.solve(), dense.solve()), (sparse.covariances(), dense.covariances())]:
        assert all(x == pytest.approx(y, abs=1e-11) for x, y in zip(a, b, strict=True))
    assert sparse.eliminate(1).information == pytest.approx(dense.eliminate(1).information, abs=1e-9)


@pytest.mark.parametrize("count", [1, 2, 21, 22, 23, 60])
def test_a_chain_without_shared_unknowns(count):
    rng = np.random.default_rng(count)
    chain = ChainEquations.zeros(count, 3, 0)
    chain.diagonal += np.eye(3)
    H, g = np.eye(3 * count), np.zeros(3 * count)
    before, after, r = (
        rng.normal(size=(count - 1, 3, 3)),
        rng.normal(size=(count - 1, 3, 3)),
        rng.normal(size=(count - 1, 3)),
    )
    chain.add_between(before, after, r)
    for k in range(count - 1):
        row = np.zeros((3, 3 * count))
        row[:, 3 * k : 3 * k + 3], row[:, 3 * k + 3 : 3 * k + 6] = before[k], after[k]
        H, g = H + row.T @ row, g + row.T @ r[k]
    states, shared = chain.solve()
    assert np.allclose(states.ravel(), np.linalg.solve(H, g), rtol=0, atol=1e-9)
    assert shared.shape == (0,)
    own, across, rest = chain.covariances()
    inverse = np.linalg.inv(H)
    for k in range(count):
        assert np.allclose(own[k], inverse[3 * k : 3 * k + 3, 3 * k : 3 * k + 3], atol=1e-9)
    for k in range(count - 1):
        assert np.allclose(across[k], inverse[3 * k : 3 * k + 3, 3 * k + 3 : 3 * k + 6], atol=1e-9)
    assert rest.shape == (0, 0)
