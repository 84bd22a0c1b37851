"""Landmarks that alone connect parts of a recording: if such a code is mounted twice, the map is folded there.

Both prints are taken for one landmark, so that the two places coincide, and nothing in the images contradicts that.
The rig betrays it where it goes from one place to the other: there it jumps.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from lmkit.arrays import IntArray
from lmkit.mapping.bundle_results import Bundle
from lmkit.model.landmark_id import LandmarkId

HINGED_FRAMES = 5  # smaller groups of frames connected by one landmark are not named

Jump = tuple[float, float, float]


@dataclass(frozen=True)
class Hinge:
    """A landmark that is the only connection of some frames to the others.

    Attributes:
        frames: number of frames in the smaller part.
        from_s, to_s: first and last time of these.
        jump: (from_s, to_s, meters) of the rig where it goes from one part to another; None if it does not jump.
    """

    id: LandmarkId
    frames: int
    from_s: float
    to_s: float
    jump: Jump | None = None

    def __str__(self) -> str:
        connected = f"{self.frames} frames from {self.from_s:.2f} to {self.to_s:.2f} s are connected to the others by"
        if self.jump is None:
            return (
                f"{connected} {self.id} alone: if its code is mounted twice, the map is folded there; record "
                "odometry, or check that it is mounted once"
            )
        from_s, to_s, meters = self.jump
        return (
            f"the map is probably folded at {self.id}: {connected} it alone, and between {from_s:.2f} and {to_s:.2f} "
            f"s, where these parts meet, the rig jumps by {meters:.2f} m. Either its code is mounted twice, or it or "
            "the rig was moved in between. If the code is mounted twice, give one of the two another code, or record "
            "odometry, and survey again"
        )


def hinges_of(bundle: Bundle) -> list[Hinge]:
    """Landmarks without which a part of the frames shares no landmark with the rest."""
    count = len(bundle.times_s)
    hinges = []
    for number, id_ in enumerate(bundle.ids):
        kept = bundle.of != number
        links = (np.ones(kept.sum()), (bundle.frames[kept], count + bundle.of[kept]))
        graph = coo_matrix(links, shape=(count + len(bundle.ids),) * 2)
        _, part = connected_components(graph, directed=False)
        # Frames that saw no other landmark are single nodes, not a part.
        sizes = np.bincount(part[:count])
        large = np.flatnonzero(sizes >= HINGED_FRAMES)
        if len(large) > 1:
            own = part[:count]
            smaller = bundle.times_s[own == large[sizes[large].argmin()]]
            jump = _jump_between(bundle, np.flatnonzero(np.isin(own, large)), own)
            hinges.append(Hinge(id_, len(smaller), float(smaller.min()), float(smaller.max()), jump))
    return hinges


def folds_of(bundle: Bundle) -> list[Hinge]:
    """Hinges with a jump of the rig between the parts that they connect."""
    return [] if not bundle.jumps else [hinge for hinge in hinges_of(bundle) if hinge.jump is not None]


def _jump_between(bundle: Bundle, rows: IntArray, part: IntArray) -> Jump | None:
    """The largest jump between frames (some rows) of different parts (N,)."""
    times = bundle.times_s[rows]
    between = []
    for jump in bundle.jumps:
        before, after = rows[times <= jump[0]], rows[times >= jump[1]]
        if len(before) and len(after) and part[before[-1]] != part[after[0]]:
            between.append(jump)
    return max(between, key=lambda jump: jump[2], default=None)
