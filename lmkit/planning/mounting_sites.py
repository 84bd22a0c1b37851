"""Sites for landmarks: along the usable walls, at every allowed height."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lmkit.arrays import BoolArray
from lmkit.errors import InputError
from lmkit.geometry.rig import AnyRig
from lmkit.model.floor_plan import FloorPlan, Wall
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import MappedLandmark, wall_pose

APART_M = 0.4  # places along a wall
EDGE_M = 0.08  # of free wall beside a landmark's face


@dataclass(frozen=True)
class MountingOptions:
    """How landmarks may be mounted.

    Attributes:
        family: of all of them.
        sizes_m: to choose from.
        heights_m: of their centers, to choose from; none: slightly above the camera.
        not_on: names of walls without landmarks, in addition to those of the floor plan.
        swap_s: time to search for pairs of landmarks that one landmark can replace.
    """

    family: str
    sizes_m: tuple[float, ...] = (0.18,)
    heights_m: tuple[float, ...] = ()
    not_on: tuple[str, ...] = ()
    swap_s: float = 2.5


@dataclass(frozen=True, eq=False)
class Mount:
    """A landmark to mount: wall, distance from its left end and height, meters to the landmark's center."""

    landmark: MappedLandmark
    wall: Wall
    along_m: float

    def __str__(self) -> str:
        height_m, size_mm = self.landmark.T_map_landmark.t[2], 1000 * self.landmark.size_m
        return (
            f"wall {self.wall.name}, {self.along_m:.3f} m from its left end, {height_m:.3f} m high, {size_mm:.0f} mm"
        )


def crowded(landmarks: Sequence[MappedLandmark], others: Sequence[MappedLandmark]) -> BoolArray:
    """(N,M) whether two sites are too close to each other."""
    here, there = (np.array([m.T_map_landmark.t for m in some]).reshape(-1, 3) for some in (landmarks, others))
    rooms = [np.array([m.size_m + 2 * EDGE_M for m in some]) for some in (landmarks, others)]
    apart = np.linalg.norm(here[:, None] - there[None], axis=2)
    return np.asarray(apart < (rooms[0][:, None] + rooms[1][None]) / 2 - 1e-9)


def possible_mounts(floor: FloorPlan, rig: AnyRig, options: MountingOptions) -> list[Mount]:
    """Sites for landmarks of the largest size that fits on the usable walls, without codes yet.

    Raises:
        InputError: a named wall does not exist.
    """
    known = {wall.name for wall in floor.walls}
    for name in options.not_on:
        if name not in known:
            raise InputError("unknown_wall", f"no wall {name!r}", f"walls: {', '.join(sorted(known))}")
    assert rig.T_base_left is not None
    heights = options.heights_m or (float(rig.T_base_left.t[2]) + 0.25,)
    mounts = []
    for wall in floor.walls:
        fitting = [size for size in options.sizes_m if size + 2 * EDGE_M <= wall.length_m]
        if not wall.usable or wall.name in options.not_on or not fitting:
            continue
        size = max(fitting)
        half = size / 2 + EDGE_M
        step = max(APART_M, 2 * half)
        count = int((wall.length_m - 2 * half) / step) + 1
        rest = wall.length_m - 2 * half - (count - 1) * step
        out = np.array([np.cos(wall.facing_rad), np.sin(wall.facing_rad)])
        for along in half + rest / 2 + step * np.arange(count):
            middle = wall.left + along * wall.along
            beside = middle + np.array([-half, 0.0, half])[:, None] * wall.along + 2 * floor.cell_m * out
            if floor.is_free(beside).all():
                for height in heights:
                    T = wall_pose([*middle, height], wall.facing_rad)
                    mounts.append(Mount(MappedLandmark(LandmarkId(options.family, 0), size, T), wall, float(along)))
    return mounts
