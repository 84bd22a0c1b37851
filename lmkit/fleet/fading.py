"""Fading: landmarks that are read worse than before, found as significant steps in time.

Two quantities are used: the share of images that should show a landmark in which it is read, and the evidence of its
readings, log(margin / side^2), which falls with the contrast of the print long before readings are lost.  Both are
compared between recordings only in views of one kind (`views.py`).  Effects common to all landmarks of a recording,
such as light, are removed.  The size of a step comes from a regression with a level for every kind of
view; its standard deviation comes from the scatter between recordings, of this landmark or of all
landmarks, whichever is larger.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from lmkit.arrays import BoolArray, FloatArray, IntArray
from lmkit.fleet.views import Count, Kind
from lmkit.model.landmark_id import LandmarkId

FADED_SIGMA = 5.0
LEAST_SHARE, LEAST_EVIDENCE = 0.2, float(np.log(1 / 0.8))  # smaller decreases are not reported
LEAST_RECORDINGS = 2  # least number before and after a step
ENOUGH = 5  # views of one kind in one recording; more give no new information
# Least number of images, and least share of read ones in the best recording, of a used kind of view: an object
# may hide the landmark in other kinds.
LEAST_EXPECTED, USUALLY_READ = 3, 0.5
ROUNDS = 10  # iterations of levels and recordings' effects
LEAST_LANDMARKS = 3  # of a recording whose effect is estimated
LEAST_SCATTER, MAD_SIGMA = 0.05, 1.4826  # of one landmark between recordings
NOTHING = 1e-9


@dataclass(frozen=True)
class Step:
    """The most significant decrease of one quantity.

    Attributes:
        before: its mean in earlier recordings.
        change, sigma: after minus before, and its standard deviation.
        first: number of the first recording after it.
    """

    before: float
    change: float
    sigma: float
    first: int

    def is_fall(self, least: float) -> bool:
        """Whether it is a significant decrease, by at least this amount."""
        return self.change <= -least and self.change <= -FADED_SIGMA * self.sigma


@dataclass(frozen=True)
class Reading:
    """Reading quality of one landmark.

    Attributes:
        id: family and code.
        expected, read: images that should show it, and those in which it was read, over all recordings.
        share, evidence: the most significant decrease of each; None with too few recordings.
    """

    id: LandmarkId
    expected: int
    read: int
    share: Step | None
    evidence: Step | None

    @property
    def fallen(self) -> tuple[Step | None, Step | None]:
        """Significant decreases of the share and of the evidence."""
        share = self.share if self.share and self.share.is_fall(LEAST_SHARE) else None
        evidence = self.evidence if self.evidence and self.evidence.is_fall(LEAST_EVIDENCE) else None
        return share, evidence


@dataclass(frozen=True)
class SiteReadings:
    """Reading quality of the landmarks of a site.

    Attributes:
        names, days: of its recordings in the order of time.
        readings: of each landmark.
    """

    names: tuple[str, ...]
    days: tuple[str, ...]
    readings: tuple[Reading, ...]


@dataclass(frozen=True, eq=False)
class _Rows:
    """One quantity by kind of view and recording: (N,) arrays; kinds are numbered across landmarks."""

    landmark: IntArray
    recording: IntArray
    kind: IntArray
    value: FloatArray
    weight: FloatArray

    def only(self, kept: BoolArray) -> _Rows:
        return _Rows(*(getattr(self, name)[kept] for name in self.__dataclass_fields__))

    def levels(self) -> FloatArray:
        """(N,) weighted mean of the row's kind of view."""
        return _means(self.kind, self.value, self.weight)[self.kind]


def readings_of(recordings: Sequence[Mapping[Kind, Count]]) -> list[Reading]:
    """Reading quality of each landmark of a site, with decreases, from its recordings in the order of time."""
    ids = sorted({id_ for counts in recordings for id_, _, _ in counts})
    shares, evidence = _share_rows(recordings, ids), _evidence_rows(recordings, ids)
    falls = [_falls(rows, len(ids), len(recordings)) for rows in (shares, evidence)]
    found = []
    for number, id_ in enumerate(ids):
        mine = [count for counts in recordings for kind, count in counts.items() if kind[0] == id_]
        total = sum(count.expected for count in mine), sum(count.read for count in mine)
        found.append(Reading(LandmarkId.parse(id_), *total, falls[0][number], falls[1][number]))
    return found


def _share_rows(recordings: Sequence[Mapping[Kind, Count]], ids: Sequence[str]) -> _Rows:
    best: dict[Kind, float] = {}
    for counts in recordings:
        for kind, count in counts.items():
            if count.expected >= LEAST_EXPECTED:
                best[kind] = max(best.get(kind, 0.0), count.read / count.expected)
    return _rows(
        [
            (r, kind, count.read / count.expected, count.expected)
            for r, counts in enumerate(recordings)
            for kind, count in counts.items()
            if best.get(kind, 0.0) >= USUALLY_READ
        ],
        ids,
    )


def _evidence_rows(recordings: Sequence[Mapping[Kind, Count]], ids: Sequence[str]) -> _Rows:
    """Evidence by direction, with all sizes combined: its dependence on size is the same for all landmarks."""
    seen = [
        (recording, kind, count)
        for recording, counts in enumerate(recordings)
        for kind, count in counts.items()
        if count.weighed
    ]
    curve = _size_curve(seen)
    sums: dict[tuple[int, Kind], tuple[float, int]] = {}
    for recording, (id_, size, direction), count in seen:
        key = recording, (id_, 0, direction)
        total, weighed = sums.get(key, (0.0, 0))
        sums[key] = total + count.evidence - count.weighed * curve[size], weighed + count.weighed
    return _rows([(r, kind, total / weighed, weighed) for (r, kind), (total, weighed) in sums.items()], ids)


def _size_curve(seen: Sequence[tuple[int, Kind, Count]]) -> dict[int, float]:
    """Evidence by kind of size, from views of one landmark in one recording, with the same light and print."""
    if not seen:
        return {}
    groups = {key: number for number, key in enumerate(sorted({(r, kind[0]) for r, kind, _ in seen}))}
    sizes = sorted({kind[1] for _, kind, _ in seen})
    group = np.array([groups[r, kind[0]] for r, kind, _ in seen], dtype=np.int64)
    size = np.array([sizes.index(kind[1]) for _, kind, _ in seen], dtype=np.int64)
    value = np.array([count.evidence / count.weighed for _, _, count in seen])
    weight = np.array([min(count.weighed, ENOUGH) for _, _, count in seen], dtype=np.float64)
    columns = [*np.eye(len(sizes))[:, size], value]
    within = np.column_stack([column - _means(group, column, weight)[group] for column in columns])
    within *= np.sqrt(weight)[:, None]
    curve = np.linalg.lstsq(within[:, :-1], within[:, -1], rcond=None)[0]
    return dict(zip(sizes, curve.tolist(), strict=True))


def _rows(rows: Sequence[tuple[int, Kind, float, int]], ids: Sequence[str]) -> _Rows:
    """Rows of kinds of view that occur in at least two recordings."""
    several = {kind for kind in {row[1] for row in rows} if len({r for r, k, _, _ in rows if k == kind}) > 1}
    kept = [row for row in rows if row[1] in several]
    numbers = {kind: number for number, kind in enumerate(sorted(several))}
    landmarks = {id_: number for number, id_ in enumerate(ids)}
    return _Rows(
        np.array([landmarks[kind[0]] for _, kind, _, _ in kept], dtype=np.int64),
        np.array([r for r, _, _, _ in kept], dtype=np.int64),
        np.array([numbers[kind] for _, kind, _, _ in kept], dtype=np.int64),
        np.array([value for _, _, value, _ in kept], dtype=np.float64),
        np.array([min(count, ENOUGH) for _, _, _, count in kept], dtype=np.float64),
    )


def _falls(rows: _Rows, landmarks: int, recordings: int) -> list[Step | None]:
    """The most significant decrease of each landmark."""
    if not len(rows.value):
        return [None] * landmarks
    rows = _without_effects(rows, recordings)
    scatter = _of_recordings(rows, (rows.value - rows.levels()) * _widened(rows.kind))
    pooled = max(LEAST_SCATTER, MAD_SIGMA * float(np.median(np.abs(scatter)))) ** 2
    return [_surest(rows.only(rows.landmark == number), pooled) for number in range(landmarks)]


def _without_effects(rows: _Rows, recordings: int) -> _Rows:
    """Values without the effects common to all landmarks of a recording."""
    effects = np.zeros(recordings)
    for _ in range(ROUNDS):
        levels = replace(rows, value=rows.value - effects[rows.recording]).levels()
        for recording in range(recordings):
            mine = rows.recording == recording
            means = _of_recordings(rows.only(mine), (rows.value - levels)[mine])
            effects[recording] = np.median(means) if len(means) >= LEAST_LANDMARKS else 0.0
    return replace(rows, value=rows.value - effects[rows.recording])


def _surest(rows: _Rows, pooled: float) -> Step | None:
    """The most significant decrease of one landmark, over all possible first recordings."""
    recordings = np.unique(rows.recording)
    firsts = recordings[LEAST_RECORDINGS : len(recordings) - LEAST_RECORDINGS + 1].tolist()
    steps = [step for first in firsts if (step := _step(rows, first, pooled)) is not None]
    return min(steps, key=lambda step: step.change / step.sigma, default=None)


def _step(rows: _Rows, first: int, pooled: float) -> Step | None:
    """Change from a recording on, from kinds of view seen before and after."""
    after = (rows.recording >= first).astype(np.float64)
    within = after - replace(rows, value=after).levels()
    pull = rows.weight * np.abs(within)
    compared = rows.only(pull > NOTHING)
    if len(np.unique(compared.recording)) < 2 * LEAST_RECORDINGS:
        return None
    within, pull, after = within[pull > NOTHING], pull[pull > NOTHING], after[pull > NOTHING]
    off = compared.value - compared.levels()
    total = float(compared.weight @ within**2)
    change = float(compared.weight @ (within * off)) / total
    left = _of_recordings(compared, (off - change * within) * _widened(compared.kind))
    variance = max(pooled, float(left @ left) / (len(left) - 2))
    sums = np.bincount(compared.recording, pull)
    before = float(np.average(compared.value[after == 0], weights=pull[after == 0]))
    return Step(before, change, float(np.sqrt(variance * (sums**2).sum())) / total, first)


def _of_recordings(rows: _Rows, values: FloatArray) -> FloatArray:
    """Weighted mean of one landmark's values in each recording."""
    _, group = np.unique(np.stack([rows.landmark, rows.recording]), axis=1, return_inverse=True)
    return _means(group.ravel(), values, rows.weight)


def _means(group: IntArray, values: FloatArray, weights: FloatArray) -> FloatArray:
    """Weighted means by group; NaN for empty groups."""
    sums = np.bincount(group, weights)
    return np.bincount(group, weights * values) / np.where(sums > 0, sums, np.nan)


def _widened(kind: IntArray) -> FloatArray:
    """(N,) factors that correct the scatter for degrees of freedom of levels from few recordings."""
    count = np.bincount(kind)[kind]
    return np.asarray(np.sqrt(count / np.maximum(count - 1, 1)))
