"""Small floors for the tests of planning and driving."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from ids import lm8

from lmkit.io.floor_plan import read_floor
from lmkit.model.floor_plan import FloorPlan, Wall
from lmkit.model.landmark_map import LandmarkMap, MappedLandmark, wall_pose
from lmkit.simulation.recording import T_BASE_LEFT
from lmkit.simulation.scene import make_rig

RIG = replace(make_rig(), T_base_left=T_BASE_LEFT)

TWO_ROOMS = """format: lmkit-floor/1
walls:
  - {from: [0, 0], to: [6, 0]}
  - {from: [6, 0], to: [6, 4]}
  - {from: [6, 4], to: [0, 4], name: glass, landmarks: false}
  - {from: [0, 4], to: [0, 0]}
  - {from: [3, 0], to: [3, 2.6]}
places:
  dock: {position: [1, 1], heading_deg: 90}
"""


def two_rooms(folder: Path) -> FloorPlan:
    path = folder / "floor.yaml"
    path.write_text(TWO_ROOMS)
    return read_floor(path)


def mounted_every(floor: FloorPlan, spacing_m: float, first_code: int = 0) -> LandmarkMap:
    """Landmarks along all walls."""
    mounted: list[MappedLandmark] = []
    for wall in floor.walls:
        for along in np.arange(0.4, wall.length_m - 0.3, spacing_m):
            mounted.append(on_wall(wall, float(along), first_code + len(mounted)))
    return LandmarkMap(mounted)


def on_wall(wall: Wall, along_m: float, code: int, height_m: float = 1.1) -> MappedLandmark:
    place = wall.left + along_m * wall.along
    return MappedLandmark(lm8(code), 0.18, wall_pose([*place, height_m], wall.facing_rad))
