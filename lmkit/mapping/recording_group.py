"""Recordings that are joined into one map, with the association of their landmarks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from lmkit.arrays import FloatArray, IntArray
from lmkit.geometry.rig import AnyRig
from lmkit.mapping.map_joining import Placement, SingleMap, place_map
from lmkit.mapping.solved_recording import SolvedRecording
from lmkit.mapping.survey_results import Survey
from lmkit.model.landmark_id import LandmarkId

ALWAYS = 10.0  # m, rad: standard deviations of undetermined components
Member = tuple[int, int]  # recording, and row among its landmarks


@dataclass(frozen=True, eq=False)
class SingleSurvey:
    """Survey of a single recording.

    Attributes:
        name: name of the recording.
        rig: rig of the recording.
        solved: its bundle adjustment.
        survey: results of the bundle adjustment.
        anchored: whether known landmarks were seen, so that the survey is in the map's frame.
        released: known landmarks that were seen at other places.
    """

    name: str
    rig: AnyRig
    solved: SolvedRecording
    survey: Survey
    anchored: bool
    released: frozenset[LandmarkId] = frozenset()

    def single_map(self) -> tuple[SingleMap, IntArray]:
        """Its reliable landmarks, and their rows in the bundle adjustment."""
        problem = self.solved.problem
        number = {id_: row for row, id_ in enumerate(problem.landmark_ids)}
        mapped = list(self.survey.bundle.landmarks)
        rows = np.array([number[m.id] for m in mapped], dtype=np.int64)
        C = np.array([np.zeros((6, 6)) if m.covariance is None else m.covariance for m in mapped])
        values, axes = np.linalg.eigh(C)
        C = (axes * np.clip(values, 0.0, ALWAYS**2)[:, None]) @ axes.transpose(0, 2, 1)
        ambiguous = np.array([row in self.solved.undecided for row in rows.tolist()], dtype=bool)
        ids = tuple(m.id for m in mapped)
        return SingleMap(ids, problem.lm_R[rows], problem.lm_p[rows], C, ambiguous), rows


@dataclass(eq=False)
class Version:
    """A landmark of the joint map: one code at one place, for some time.

    Attributes:
        id: family and code; several versions may have the same.
        members: the recordings that saw it there.
        R, p: its pose.
    """

    id: LandmarkId
    members: list[Member]
    R: FloatArray
    p: FloatArray

    @property
    def recordings(self) -> list[int]:
        """Numbers of the recordings that saw it."""
        return sorted(recording for recording, _ in self.members)


@dataclass(eq=False)
class RecordingGroup:
    """Recordings aligned in one frame, and the landmarks that they share.

    Attributes:
        surveys: one per recording.
        versions: the landmarks of the joint map.
        turned: numbers of versions that recordings see at one place with different rotations.
        left_out: names of recordings that do not fit, and why.
    """

    surveys: list[SingleSurvey]
    versions: list[Version]
    turned: set[int] = field(default_factory=set)
    left_out: dict[str, str] = field(default_factory=dict)

    def rows(self) -> list[IntArray]:
        """(L,) of every recording: the versions that its landmarks are."""
        rows = [np.full(len(survey.solved.problem.mapped), -1) for survey in self.surveys]
        for number, version in enumerate(self.versions):
            for recording, row in version.members:
                rows[recording][row] = number
        return rows


def join_recordings(surveys: Sequence[SingleSurvey]) -> RecordingGroup:
    """Align recordings in the frame of one of them, so that most of them fit.

    Recordings in the frame of known landmarks come first.  The poses and landmarks of the others' bundle
    adjustments are transformed.
    """
    anchored = [k for k, one in enumerate(surveys) if one.anchored]
    best: tuple[dict[int, _Alignment], dict[int, str]] | None = None
    for first in [anchored] if anchored else [[k] for k in range(len(surveys))]:
        aligned, reasons = _grow(surveys, first)
        if best is None or len(aligned) > len(best[0]):
            best = aligned, reasons
        if 2 * len(aligned) > len(surveys):
            break
    assert best is not None
    return _grouped(surveys, *best)


@dataclass(frozen=True, eq=False)
class _Alignment:
    """Alignment of a recording, and the association of its landmarks."""

    R: FloatArray
    t: FloatArray
    same: Mapping[int, int]
    turned: tuple[int, ...]


def _grow(surveys: Sequence[SingleSurvey], first: Sequence[int]) -> tuple[dict[int, _Alignment], dict[int, str]]:
    """Recordings aligned one after another, the best connected first, and reasons for those that are not."""
    maps = [one.single_map()[0] for one in surveys]
    together, none = _subset(maps[first[0]], []), np.zeros((6, 6))
    aligned: dict[int, _Alignment] = {}
    todo = list(range(len(surveys)))

    def add(
        k: int, R: FloatArray, t: FloatArray, covariance: FloatArray, same: dict[int, int], turned: list[int]
    ) -> None:
        nonlocal together
        new = [row for row in range(len(maps[k].ids)) if row not in same]
        count = len(together.ids)
        together = together.with_more(maps[k].transformed(R, t, covariance), new)
        aligned[k] = _Alignment(R, t, {**same, **{row: count + i for i, row in enumerate(new)}}, tuple(turned))
        todo.remove(k)

    for k in first:
        answer = place_map(together, maps[k]) if aligned else None
        same, turned = _same(answer) if isinstance(answer, Placement) else ({}, [])
        add(k, np.eye(3), np.zeros(3), none, same, turned)
    answers: dict[int, Placement | str] = {}
    while todo:
        answers = {k: place_map(together, maps[k]) for k in todo}
        joined = {k: answer for k, answer in answers.items() if isinstance(answer, Placement)}
        if not joined:
            break
        k = max(joined, key=lambda k: joined[k].agreeing)
        add(k, joined[k].R, joined[k].t, joined[k].covariance, *_same(joined[k]))
    return aligned, {k: str(answers[k]) for k in todo}


def _same(placement: Placement) -> tuple[dict[int, int], list[int]]:
    """Row in the fixed map by row in the aligned one, and rows in the fixed one of rotated landmarks."""
    same = {int(b): int(a) for (a, b), fits in zip(placement.pairs, placement.fits, strict=True) if fits}
    return same, [int(a) for (a, _), turned in zip(placement.pairs, placement.turned, strict=True) if turned]


def _subset(whole: SingleMap, rows: list[int]) -> SingleMap:
    ids = tuple(whole.ids[k] for k in rows)
    index = np.array(rows, dtype=np.int64)
    return SingleMap(ids, whole.R[index], whole.p[index], whole.covariances[index], whole.ambiguous[index])


def _grouped(
    surveys: Sequence[SingleSurvey], aligned: Mapping[int, _Alignment], reasons: Mapping[int, str]
) -> RecordingGroup:
    kept = sorted(aligned)
    number = {k: new for new, k in enumerate(kept)}
    versions: dict[int, Version] = {}
    turned: set[int] = set()
    for k in aligned:  # in the order of alignment: the first one gives the initial pose of a landmark
        problem = surveys[k].solved.problem
        problem.transform(aligned[k].R, aligned[k].t)
        _, rows = surveys[k].single_map()
        for own, where in aligned[k].same.items():
            row = int(rows[own])
            if where not in versions:
                versions[where] = Version(problem.mapped[row].id, [], problem.lm_R[row], problem.lm_p[row])
            versions[where].members.append((number[k], row))
        turned |= set(aligned[k].turned)
    order = list(versions)
    group = RecordingGroup([surveys[k] for k in kept], [versions[where] for where in order])
    group.turned = {order.index(where) for where in turned}
    group.left_out = {surveys[k].name: reason for k, reason in reasons.items()}
    _place_the_rest(group)
    return group


def _place_the_rest(group: RecordingGroup) -> None:
    """Associate the unreliable landmarks of recordings with those of the others, or add them as new ones."""
    for recording, rows in enumerate(group.rows()):
        problem = group.surveys[recording].solved.problem
        for row in np.flatnonzero(rows < 0).tolist():
            id_ = problem.mapped[row].id
            same = [version for version in group.versions if version.id == id_]
            if not same:
                same = [Version(id_, [], problem.lm_R[row], problem.lm_p[row])]
                group.versions += same
            same[-1].members.append((recording, row))
