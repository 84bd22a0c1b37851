"""Sparse border of a chain: blocks for the few of many shared unknowns that are linked with each state."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from lmkit.arrays import FloatArray, IntArray
from lmkit.kernels.block_chain import put_blocks


@dataclass(frozen=True, eq=False)
class BlockPattern:
    """Groups of shared unknowns linked with each state.

    Attributes:
        states, groups: (B,) of every block, by state and then by group.
        count: number of states.
        first, size: first unknown of group 0, and unknowns of a group.
    """

    states: IntArray
    groups: IntArray
    count: int
    first: int
    size: int
    _starts: IntArray = field(init=False, repr=False)
    _columns: dict[tuple[int, int], tuple[IntArray, IntArray]] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_starts", np.searchsorted(self.states, np.arange(self.count + 1)))
        object.__setattr__(self, "_columns", {})

    @classmethod
    def of_pairs(
        cls, states: IntArray, groups: IntArray, count: int, first: int, size: int
    ) -> tuple[BlockPattern, IntArray]:
        """The pattern of pairs (S,) of a state and a group, and the block (S,) of every pair."""
        wide = int(groups.max(initial=0)) + 1
        keys, place = np.unique(states * wide + groups, return_inverse=True)
        return cls(keys // wide, keys % wide, count, first, size), np.ascontiguousarray(place.ravel())

    def blocks_of(self, start: int, end: int) -> slice:
        """Blocks of states ``start`` to ``end``."""
        return slice(int(self._starts[start]), int(self._starts[end]))

    def columns_of(self, start: int, end: int) -> tuple[IntArray, IntArray]:
        """Unknowns (c,) of the groups linked with states ``start`` to ``end``, and each block's index among them."""
        if (start, end) not in self._columns:
            groups, place = np.unique(self.groups[self.blocks_of(start, end)], return_inverse=True)
            columns = self.first + (self.size * groups[:, None] + np.arange(self.size)).ravel()
            self._columns[start, end] = columns, place.ravel()
        return self._columns[start, end]


@dataclass(frozen=True, eq=False)
class BorderBlocks:
    """Normal equations between states and groups of shared unknowns.

    Attributes:
        values: (B,d,size) of every block.
        pattern: state and group of every block.
    """

    values: FloatArray
    pattern: BlockPattern

    @classmethod
    def zeros(cls, pattern: BlockPattern, size: int) -> BorderBlocks:
        """Blocks without information, for states of ``size`` numbers."""
        return cls(np.zeros((len(pattern.states), size, pattern.size)), pattern)

    def put(self, start: int, end: int, into: FloatArray) -> None:
        """Write the blocks of states ``start`` to ``end`` into the zero columns (n d,c) of their groups."""
        blocks = self.pattern.blocks_of(start, end)
        place = self.pattern.columns_of(start, end)[1]
        put_blocks(self.values[blocks], self.pattern.states[blocks] - start, place, into)

    def rows(self, states: IntArray, shared: int) -> FloatArray:
        """(K,d,shared) dense border of some states."""
        pattern, size = self.pattern, self.values.shape[1]
        number = np.full(pattern.count, -1)
        number[states] = np.arange(len(states))
        at = number[pattern.states]
        kept = np.flatnonzero(at >= 0)
        whole = np.zeros((len(states) * size, shared))
        put_blocks(self.values[kept], at[kept], pattern.groups[kept], whole[:, pattern.first :])
        return whole.reshape(len(states), size, shared)
