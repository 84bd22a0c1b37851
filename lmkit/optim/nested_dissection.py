"""Large sparse normal equations by nested dissection (George 1973) and dense fronts (Duff and Reid 1983).

Unknowns are grouped in nodes of equal size, such as landmarks.  A separator is a set of nodes whose removal splits
the graph; it is eliminated after both parts, which are split in turn.  Each separator gives one dense matrix, its
front, with the later eliminated nodes that share equations with it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.linalg import cholesky, solve_triangular
from scipy.sparse.csgraph import breadth_first_order, connected_components

from lmkit.arrays import BoolArray, FloatArray, IntArray

LEAF = 32  # parts of up to this many nodes are not split
BALANCE = 0.25  # each part of a cut has at least this share of the nodes, if possible


@dataclass(frozen=True, eq=False)
class Front:
    """One step of the elimination.

    Attributes:
        own: (O,) nodes eliminated in this step.
        boundary: (B,) nodes that share equations with them and are eliminated later, in the order of the nodes.
        children: numbers of the fronts whose Schur complements are added.
    """

    own: IntArray
    boundary: IntArray
    children: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class FrontFactor:
    """Lower Cholesky factor (dO,dO) of the own unknowns, and its inverse times their equations with the boundary."""

    own: IntArray
    boundary: IntArray
    lower: FloatArray
    across: FloatArray


def solve_by_dissection(
    count: int, size: int, pairs: tuple[IntArray, IntArray], blocks: FloatArray, right: FloatArray
) -> FloatArray:
    """Solve H x = right for a symmetric positive definite H given by blocks.

    Args:
        count: number of nodes.
        size: unknowns of a node, d.
        pairs: (N,), (N,) rows and columns of the blocks, rows at most columns, each pair once.
        blocks: (N,d,d).
        right: (d count,).

    Returns:
        (d count,) x.

    Raises:
        numpy.linalg.LinAlgError: H is not positive definite.
    """
    rows, columns = pairs
    link = sparse.coo_matrix((np.ones(len(rows), dtype=bool), (rows, columns)), shape=(count, count))
    fronts = dissect((link + link.T).tocsr())
    factors = _factorize(fronts, count, size, pairs, blocks)
    x = right.copy()
    for front in factors:
        x[front.own] = solve_triangular(front.lower, x[front.own], lower=True, check_finite=False)
        x[front.boundary] -= front.across.T @ x[front.own]
    for front in reversed(factors):
        rest = x[front.own] - front.across @ x[front.boundary]
        x[front.own] = solve_triangular(front.lower, rest, lower=True, trans="T", check_finite=False)
    return x


def dissect(graph: sparse.csr_matrix) -> list[Front]:
    """Fronts of a graph of nodes, in the order of elimination: children before their parents."""
    steps: list[tuple[IntArray, tuple[int, ...]]] = []
    _separate(graph, np.arange(graph.shape[0]), steps)
    turn = np.zeros(graph.shape[0], dtype=np.int64)
    for number, (own, _) in enumerate(steps):
        turn[own] = number
    fronts: list[Front] = []
    for number, (own, children) in enumerate(steps):
        near = np.concatenate([graph[own].indices, *(fronts[k].boundary for k in children)])
        boundary = np.unique(near[turn[near] > number])
        fronts.append(Front(own, boundary.astype(np.int64), children))
    return fronts


def _separate(graph: sparse.csr_matrix, nodes: IntArray, steps: list[tuple[IntArray, tuple[int, ...]]]) -> int:
    """Add the steps that eliminate ``nodes``; returns the number of the last step."""
    if len(nodes) <= LEAF:
        return _added(steps, nodes, ())
    part = graph[nodes][:, nodes]
    pieces, of_piece = connected_components(part, directed=False)
    if pieces > 1:
        children = [_separate(graph, nodes[of_piece == k], steps) for k in range(pieces)]
        return _added(steps, nodes[:0], children)
    separator, before, after = _cut(part)
    if not (before.any() and after.any()):
        return _added(steps, nodes, ())
    children = [_separate(graph, nodes[side], steps) for side in (before, after)]
    return _added(steps, nodes[separator], children)


def _added(steps: list[tuple[IntArray, tuple[int, ...]]], own: IntArray, children: Sequence[int]) -> int:
    steps.append((own, tuple(children)))
    return len(steps) - 1


def _cut(graph: sparse.csr_matrix) -> tuple[BoolArray, BoolArray, BoolArray]:
    """Separator of a connected graph, and the two sides, as masks: a level of the distances from one end."""
    far = breadth_first_order(graph, 0, directed=False, return_predecessors=False)[-1]
    order, before = breadth_first_order(graph, far, directed=False)
    level = np.zeros(graph.shape[0], dtype=np.int64)
    for node in order[1:]:
        level[node] = level[before[node]] + 1
    counts = np.bincount(level)
    below = np.cumsum(counts) - counts
    above = len(level) - below - counts
    balanced = np.minimum(below, above) >= BALANCE * (len(level) - counts)
    candidates = np.flatnonzero(balanced) if balanced.any() else np.array([np.minimum(below, above).argmax()])
    chosen = candidates[counts[candidates].argmin()]
    # Only nodes of the level with neighbors on the other side are in the separator.
    touches = np.asarray(graph[:, level > chosen].sum(axis=1)).ravel() > 0
    separator = (level == chosen) & touches
    return separator, (level <= chosen) & ~separator, level > chosen


def _factorize(
    fronts: Sequence[Front], count: int, size: int, pairs: tuple[IntArray, IntArray], blocks: FloatArray
) -> list[FrontFactor]:
    turn = np.zeros(count, dtype=np.int64)
    for number, front in enumerate(fronts):
        turn[front.own] = number
    enters = np.minimum(turn[pairs[0]], turn[pairs[1]])
    order = np.argsort(enters, kind="stable")
    ends = np.searchsorted(enters[order], np.arange(len(fronts) + 1))
    place = np.zeros(count, dtype=np.int64)  # of a node in the current front
    remainders: dict[int, FloatArray] = {}
    factors = []
    for number, front in enumerate(fronts):
        nodes = np.concatenate([front.own, front.boundary])
        place[nodes] = np.arange(len(nodes))
        matrix = np.zeros((size * len(nodes), size * len(nodes)))
        mine = order[ends[number] : ends[number + 1]]
        row, column = place[pairs[0][mine]], place[pairs[1][mine]]
        by_node = matrix.reshape(len(nodes), size, len(nodes), size)
        by_node[row, :, column, :] = blocks[mine]
        by_node[column, :, row, :] = blocks[mine].transpose(0, 2, 1)
        for child in front.children:
            there = _unknowns(place[fronts[child].boundary], size)
            matrix[there[:, None], there] += remainders.pop(child)
        own = size * len(front.own)
        lower = cholesky(matrix[:own, :own], lower=True, check_finite=False)
        across = solve_triangular(lower, matrix[:own, own:], lower=True, check_finite=False)
        remainders[number] = matrix[own:, own:] - across.T @ across
        factors.append(FrontFactor(_unknowns(front.own, size), _unknowns(front.boundary, size), lower, across))
    return factors


def _unknowns(nodes: IntArray, size: int) -> IntArray:
    return np.asarray((size * nodes[:, None] + np.arange(size)).ravel())
