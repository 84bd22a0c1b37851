"""The landmark map: id -> T_map_landmark."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import cached_property

import numpy as np

from lmkit.arrays import FloatArray, frozen
from lmkit.errors import InputError
from lmkit.geometry.pose import Pose
from lmkit.model.landmark import square_corners
from lmkit.model.landmark_id import LandmarkId

LARGEST_M = 100.0  # of a side, as in map files
ASYMMETRY = 1e-6  # of a covariance, by rounding, as a share of its largest entry
NAMED = 4  # landmarks in an error message
CALENDAR_S = 1e8  # clocks beyond count from 1970, clocks below from when they were started


def day_of(time_s: float) -> str:
    """Date in UTC of seconds since 1970, such as 2026-11-27."""
    return datetime.fromtimestamp(time_s, UTC).strftime("%Y-%m-%d")


@dataclass(frozen=True, eq=False)
class MappedLandmark:
    """One landmark on its wall.

    Attributes:
        id: family and code, as printed.
        size_m: outer edge to outer edge of the border, meters.
        T_map_landmark: its pose.
        covariance: (6,6) of that pose in the map frame (x y z m, rotation x y z rad), if known.
        name: of the place it marks, for `lmkit plan route`.
        valid_from_s, valid_to_s: when it was first seen there after a move, and last seen before a move, seconds
            of the recordings' clock; None: no move is known.

    Raises:
        TypeError: `id` is no LandmarkId, `T_map_landmark` no Pose, or `size_m` no number.
        ValueError: `size_m` is not between 0 and 100, `T_map_landmark` joins other frames, or `covariance` is not a
            symmetric (6,6) array with variances of 0 or more.

    Examples:
        >>> import lmkit
        >>> pose = lmkit.Pose.from_quaternion("map", "landmark", [1.5, 0.0, 1.2], [0, 0.7071068, 0.7071068, 0])
        >>> lmkit.MappedLandmark(lmkit.LandmarkId("lm8", 137), 0.18, pose)
        MappedLandmark(lm8:137, 180 mm, x 1.500 y 0.000 z 1.200 m)
    """

    id: LandmarkId
    size_m: float
    T_map_landmark: Pose
    covariance: FloatArray | None = None
    name: str | None = None
    valid_from_s: float | None = None
    valid_to_s: float | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.id, LandmarkId):
            raise TypeError(f"id must be a LandmarkId, such as LandmarkId('lm8', 137), not {self.id!r}")
        if not isinstance(self.T_map_landmark, Pose):
            kind = type(self.T_map_landmark).__name__
            raise TypeError(f"T_map_landmark of {self.id} must be a Pose, not {kind}; see Pose.from_matrix")
        if not isinstance(self.size_m, (int, float, np.number)):
            raise TypeError(f"size_m of {self.id} must be a number in meters, such as 0.18, not {self.size_m!r}")
        if not 0 < self.size_m <= LARGEST_M:
            raise ValueError(f"size_m of {self.id} is {self.size_m:g}; give meters, such as 0.18 for 180 mm")
        if self.T_map_landmark.from_frame != "landmark" or self.T_map_landmark.to_frame != "map":
            raise ValueError(f"T_map_landmark of {self.id} joins the wrong frames: {self.T_map_landmark!r}")
        if self.covariance is not None:
            C = frozen(self.covariance, (6, 6), f"covariance of {self.id}")
            if np.abs(C - C.T).max() > ASYMMETRY * np.abs(C).max() or C.diagonal().min() < 0:
                raise ValueError(f"covariance of {self.id} is not symmetric, or has a negative variance")
            object.__setattr__(self, "covariance", C)

    def __repr__(self) -> str:
        x, y, z = self.T_map_landmark.t
        return f"MappedLandmark({self.id}, {1000 * self.size_m:g} mm, x {x:z.3f} y {y:z.3f} z {z:z.3f} m)"

    @property
    def code(self) -> int:
        """The code, without the family."""
        return self.id.code

    @property
    def family(self) -> str:
        """Name of the landmark family."""
        return self.id.family

    @cached_property
    def corners_map(self) -> FloatArray:
        """(4,3) outer corners in the map, meters; top left, then clockwise as the landmark stands."""
        return self.T_map_landmark.apply(square_corners(self.size_m))


class LandmarkMap:
    """An ordered set of landmarks, looked up by their id.

    Landmarks with a `valid_to_s` are history: they are kept in `past`, and take no part in anything else.

    Attributes:
        past: landmarks as they were mounted before they were moved or taken away.

    Raises:
        InputError: two landmarks that are valid now have the same id, or something is no MappedLandmark.

    Examples:
        >>> import lmkit
        >>> landmarks = lmkit.read_map("map.yaml")
        >>> first = next(iter(landmarks))
        >>> landmarks.find(first.id) is first, first.id in landmarks
        (True, True)
    """

    def __init__(self, landmarks: Iterable[MappedLandmark]) -> None:
        landmarks = tuple(landmarks) if isinstance(landmarks, Iterable) else (landmarks,)
        if other := next((m for m in landmarks if not isinstance(m, MappedLandmark)), None):
            hint = "give MappedLandmark(LandmarkId('lm8', 137), 0.18, pose)"
            raise InputError("not_a_landmark", f"{other!r} is not a MappedLandmark", hint)
        self._by_id: dict[LandmarkId, MappedLandmark] = {}
        self.past = tuple(landmark for landmark in landmarks if landmark.valid_to_s is not None)
        for index, landmark in enumerate(landmarks):
            if landmark.valid_to_s is not None:
                continue
            if landmark.id in self._by_id:
                raise InputError(
                    "duplicate_code",
                    f"landmarks[{index}]: {landmark.id} is in the map twice",
                    "mount each code once, or remove one of the two entries",
                )
            self._by_id[landmark.id] = landmark

    def __len__(self) -> int:
        return len(self._by_id)

    def __iter__(self) -> Iterator[MappedLandmark]:
        return iter(self._by_id.values())

    def __contains__(self, id_: LandmarkId | str) -> bool:
        return self.find(id_) is not None

    def find(self, id_: LandmarkId | str) -> MappedLandmark | None:
        """The landmark with this id, or None.

        Args:
            id_: the id, or its text, such as ``lm8:137``.

        Raises:
            InputError: another type, or no id; a bare code where the map has several families.
        """
        if isinstance(id_, tuple):
            return self._by_id.get(id_)
        if isinstance(id_, str):
            return self._by_id.get(LandmarkId.parse(id_, self.families))
        hint = "give LandmarkId('lm8', 137), or text such as 'lm8:137'"
        raise InputError("bad_id", f"{id_!r} is not a landmark id", hint)

    def with_history_of(self, earlier: LandmarkMap) -> LandmarkMap:
        """The map with the history of an earlier map of the same place, from which it was surveyed."""

        def dated(m: MappedLandmark) -> MappedLandmark:
            before = earlier.find(m.id)
            since = None if before is None else before.valid_from_s
            # A landmark that was moved again has a later start already.
            known = since is not None and m.valid_from_s is None and since <= _last_valid(m)
            return replace(m, valid_from_s=since) if known else m

        return LandmarkMap([*map(dated, self), *earlier.past, *map(dated, self.past)])

    def at(self, time_s: float) -> LandmarkMap:
        """The map as it was at a time: every landmark where it was mounted then.

        A time of another clock, such as seconds since a recording began where the map has seconds since 1970, gives
        the map as it is now.
        """
        dated = [t for m in (*self, *self.past) for t in (m.valid_from_s, m.valid_to_s) if t is not None]
        if not dated or (min(dated) > CALENDAR_S) != (time_s > CALENDAR_S):
            return self
        then: dict[LandmarkId, MappedLandmark] = {}
        for m in sorted((*self.past, *self), key=_last_valid, reverse=True):
            if time_s <= _last_valid(m):
                then[m.id] = m
        # Between two poses, and before the first, the time of the move is unknown: the nearer in time is used.
        kept = [self._dated(m, time_s) for m in then.values()]
        return LandmarkMap([replace(m, valid_from_s=None, valid_to_s=None) for m in kept])

    def _dated(self, later: MappedLandmark, time_s: float) -> MappedLandmark:
        """The pose that is valid at a time at or before the later one's end."""
        since = later.valid_from_s
        if since is None or time_s >= since:
            return later
        earlier = [m for m in self.past if m.id == later.id and _last_valid(m) < time_s]
        if not earlier:
            return later
        last = max(earlier, key=_last_valid)
        return last if time_s - _last_valid(last) < since - time_s else later

    def require_any(self, ids: Iterable[LandmarkId]) -> None:
        """Refuse observations none of whose landmarks is in the map.

        Raises:
            InputError: ``no_landmarks``, naming some of both.
        """
        seen = sorted(set(ids))
        if any(id_ in self._by_id for id_ in seen):
            return
        if not seen:
            raise InputError("no_landmarks", "no landmark was seen", "check the images, and the landmarks' family")
        raise InputError(
            "no_landmarks",
            f"none of the {len(seen)} landmarks seen ({_some(seen)}) is among the {len(self)} of the map "
            f"({_some(sorted(self._by_id))})",
            "give the map of this place, and check the landmarks' family",
        )

    @property
    def families(self) -> tuple[str, ...]:
        """Names of the families in the map, in the order of their first landmarks."""
        return tuple(dict.fromkeys(landmark.family for landmark in self))

    def __repr__(self) -> str:
        return f"LandmarkMap({len(self)} landmarks: {', '.join(self.families) or 'empty'})"


def _last_valid(landmark: MappedLandmark) -> float:
    return float("inf") if landmark.valid_to_s is None else landmark.valid_to_s


def _some(ids: Sequence[LandmarkId]) -> str:
    return ", ".join([*map(str, ids[:NAMED]), *["..."][: len(ids) > NAMED]])


def wall_pose(position: Sequence[float], facing_rad: float) -> Pose:
    """T_map_landmark of a landmark that is mounted upright on a wall.

    Args:
        position: its middle in the map, meters.
        facing_rad: direction in the map's xy plane in which its face looks (toward the viewer).
    """
    c, s = np.cos(facing_rad), np.sin(facing_rad)
    # Columns: the landmark's x (viewer's right), y (up), z (toward the viewer) in the map.
    R = np.array([[-s, 0.0, c], [c, 0.0, s], [0.0, 1.0, 0.0]])
    return Pose("map", "landmark", R, np.asarray(position, dtype=np.float64))
