"""Where the landmarks hang: code -> T_map_landmark."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.errors import InputError
from lmkit.geometry.pose import Pose
from lmkit.model.landmark import square_corners


@dataclass(frozen=True, eq=False)
class MappedLandmark:
    """One landmark on its wall.

    Attributes:
        code, family: what is printed on it.
        size_m: outer edge to outer edge of the red border, metres.
        T_map_landmark: its pose.
        covariance: (6,6) of that pose in the map frame (x y z m, rotation x y z rad), if known.
        name: of the place it marks, for `lmkit plan route`.
    """

    code: int
    family: str
    size_m: float
    T_map_landmark: Pose
    covariance: FloatArray | None = None
    name: str | None = None

    @cached_property
    def corners_map(self) -> FloatArray:
        """(4,3) outer corners in the map, metres; top left, then clockwise as the landmark stands."""
        return self.T_map_landmark.apply(square_corners(self.size_m))


class LandmarkMap:
    """An ordered set of landmarks, looked up by family and code.

    Raises:
        InputError: two landmarks share family and code.
    """

    def __init__(self, landmarks: Sequence[MappedLandmark]) -> None:
        self._by_key: dict[tuple[str, int], MappedLandmark] = {}
        for index, landmark in enumerate(landmarks):
            key = (landmark.family, landmark.code)
            if key in self._by_key:
                raise InputError(
                    "duplicate_code",
                    f"landmarks[{index}]: code {landmark.code} of {landmark.family} is in the map twice",
                    "hang each code once, or take one of the two entries out",
                )
            self._by_key[key] = landmark

    def __len__(self) -> int:
        return len(self._by_key)

    def __iter__(self) -> Iterator[MappedLandmark]:
        return iter(self._by_key.values())

    def find(self, code: int, family: str = "lm8") -> MappedLandmark | None:
        """The landmark with this code, or None."""
        return self._by_key.get((family, code))


def wall_pose(position: Sequence[float], facing_rad: float) -> Pose:
    """T_map_landmark of a landmark that hangs upright on a wall.

    Args:
        position: its middle in the map, metres.
        facing_rad: direction in the map's xy plane in which its face looks (towards the viewer).
    """
    c, s = np.cos(facing_rad), np.sin(facing_rad)
    # Columns: the landmark's x (viewer's right), y (up), z (towards the viewer) in the map.
    R = np.array([[-s, 0.0, c], [c, 0.0, s], [0.0, 1.0, 0.0]])
    return Pose("map", "landmark", R, np.asarray(position, dtype=np.float64))
