"""Detections of one image as a sequence that also gives its values as arrays."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from html import escape
from typing import overload

import numpy as np

from lmkit.arrays import AnyArray, FloatArray
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.observation import Detection


class Detections(Sequence[Detection]):
    """The landmarks found in one image.

    A sequence of `Detection`: iterate over it, index it, filter it with a boolean array.  Values of all
    detections come as arrays.

    Examples:
        >>> import lmkit
        >>> detections = lmkit.detect("left.png")
        >>> detections.corners.shape == (len(detections), 4, 2)
        True
        >>> sure = detections[detections.confidence > 0.99]
        >>> len(sure) <= len(detections)
        True
    """

    def __init__(self, items: Sequence[Detection], image_size: tuple[int, int] | None = None) -> None:
        """Hold ``items``; ``image_size`` is (width, height) of the image they were found in.

        Raises:
            TypeError: something else than detections.
        """
        self._items = tuple(items)
        for item in self._items:
            if not isinstance(item, Detection):
                raise TypeError(f"Detections contains values of type Detection, not {type(item).__name__}")
        self.image_size = image_size

    def __len__(self) -> int:
        return len(self._items)

    def __iter__(self) -> Iterator[Detection]:
        return iter(self._items)

    @overload
    def __getitem__(self, key: int) -> Detection: ...
    @overload
    def __getitem__(self, key: slice | AnyArray | list[int] | list[bool]) -> Detections: ...
    def __getitem__(self, key: int | slice | AnyArray | list[int] | list[bool]) -> Detection | Detections:
        if isinstance(key, int | np.integer):
            return self._items[int(key)]
        if isinstance(key, slice):
            return Detections(self._items[key], self.image_size)
        rows = np.arange(len(self))[np.asarray(key)]
        return Detections([self._items[k] for k in rows], self.image_size)

    @property
    def ids(self) -> list[LandmarkId]:
        """The ids of all detections."""
        return [d.id for d in self._items]

    @property
    def codes(self) -> AnyArray:
        """(N,) the codes."""
        return np.array([d.code for d in self._items], dtype=np.int64)

    @property
    def corners(self) -> FloatArray:
        """(N,4,2) outer corners, pixels; top left of the landmark first, then clockwise."""
        return np.array([d.corners for d in self._items]).reshape(-1, 4, 2)

    @property
    def centers(self) -> FloatArray:
        """(N,2) centers, pixels."""
        return np.array([d.center for d in self._items]).reshape(-1, 2)

    @property
    def confidence(self) -> FloatArray:
        """(N,) probability that the code is right, 0 to 1."""
        return np.array([d.confidence for d in self._items], dtype=np.float64)

    def to_dict(self) -> dict[str, object]:
        """The object of `lmkit detect --json`, without the image's path."""
        width, height = self.image_size or (None, None)
        return {"width": width, "height": height, "detections": [d.to_dict() for d in self._items]}

    def __repr__(self) -> str:
        return f"Detections({', '.join(str(d.id) for d in self._items) or 'none'})"

    def _repr_html_(self) -> str:
        """A table for notebooks."""
        cells = "".join(
            f"<tr><td>{escape(str(d.id))}</td><td>{d.center[0]:.1f}, {d.center[1]:.1f}</td>"
            f"<td>{d.confidence:.4f}</td></tr>"
            for d in self._items
        )
        return f"<table><tr><th>id</th><th>center, px</th><th>confidence</th></tr>{cells}</table>"
