"""JointSolver: joint adjustment of several recordings; landmarks are released, split and merged by tests on the cost.

A landmark that two poses explain better than one, by more than chance (`moved_landmarks.py`), was moved between
recordings, or since the known map (`moved_known_landmarks.py`): it is split in two.  Two that are at one place,
according to the joint covariance, are merged.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from lmkit.arrays import FloatArray, IntArray
from lmkit.geometry.pose import Pose
from lmkit.geometry.pose_array import PoseArray
from lmkit.geometry.rotations import orthonormal, rotation_log
from lmkit.mapping.bundle_adjustment import Anchor, BundleProblem
from lmkit.mapping.joint_adjustment import JointProblem, recording_information
from lmkit.mapping.joint_survey import JointSurvey
from lmkit.mapping.landmark_support import KeptOut, doubtful_landmarks
from lmkit.mapping.moved_known_landmarks import (
    KnownView,
    find_moved,
    is_at_known_place,
    moved_threshold,
    unmoved_covariance,
)
from lmkit.mapping.moved_landmark import MovedLandmark
from lmkit.mapping.moved_landmarks import split_tests
from lmkit.mapping.observation_noise import noise_factor
from lmkit.mapping.reading_rate import LocatedFrames
from lmkit.mapping.recording_group import RecordingGroup, Version
from lmkit.mapping.survey import (
    OUTLIER_SIGMA,
    STEPS,
    landmarks_off_constraint,
    poorly_determined_landmarks,
    survey_of,
)
from lmkit.mapping.wall_constraints import LandmarkConstraint
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import CALENDAR_S, LandmarkMap, MappedLandmark
from lmkit.optim.information_sum import InformationSum, unknowns_of

ROUNDS = 4  # of leaving out observations that do not fit
MOST_MERGES = 2  # times that a recording's view of a landmark is merged again; then it stays split
CHANGES = 12  # rounds of splitting and merging landmarks, one at a time


class JointSolver:
    """The joint adjustment of a group, with landmarks split and merged by its tests."""

    def __init__(
        self,
        group: RecordingGroup,
        known: Mapping[LandmarkId, Anchor],
        constraints: Sequence[LandmarkConstraint],
    ) -> None:
        self.group, self.known, self.constraints = group, known, constraints
        self.problems = [one.solved.problem for one in group.surveys]
        self.single_used = [problem.used.copy() for problem in self.problems]
        self.single_poses = [(problem.lm_R.copy(), problem.lm_p.copy()) for problem in self.problems]
        self.anchors = dict(known) or dict(self.problems[0].anchors)
        self.threshold = moved_threshold(sum(len(problem.mapped) for problem in self.problems))
        self.noise = 1.0
        self.released = self._released_by_all()  # known landmarks that were moved since
        self.held: set[LandmarkId] = set()  # are not released again
        self.disputed: tuple[LandmarkId, ...] = ()  # known landmarks that contradict each other
        self.anchors = {id_: anchor for id_, anchor in self.anchors.items() if id_ not in self.released}
        self.merged_back: Counter[tuple[int, int]] = Counter()
        self.own_knowledge = [(problem.anchors, problem.constraints) for problem in self.problems]
        for problem in self.problems:
            problem.anchors, problem.constraints = {}, ()

    def restore_anchors(self) -> None:
        """Give every recording the anchors of its own frame again, so that it can be joined with others."""
        for problem, (anchors, constraints) in zip(self.problems, self.own_knowledge, strict=True):
            problem.anchors, problem.constraints = anchors, constraints

    def solve(self) -> None:
        """Adjust, split and merge until nothing changes."""
        self._choose_starts()
        self._adjust()
        for _ in range(CHANGES):
            if not (self._release() or self._split() | self._merge() or self._take_back()):
                break
            self._adjust()
        self._find_swelling()
        self._adjust()

    def contradicted_recordings(self) -> dict[str, str]:
        """Names of recordings in which most shared landmarks are elsewhere, and a clause for each."""
        contradicted = {}
        for recording, one in enumerate(self.group.surveys):
            mine = [v for v in self.group.versions if recording in v.recordings]
            others = {v.id for v in self.group.versions if set(v.recordings) - {recording}}
            shared = [v for v in mine if v.id in others]
            alone = sum(v.recordings == [recording] for v in shared)
            if not one.anchored and len(self.problems) > 2 and 2 * alone > len(shared):
                contradicted[one.name] = (
                    f"{alone} of its {len(shared)} shared landmarks are at other places than in the other recordings"
                )
        return contradicted

    def _choose_starts(self) -> None:
        """For landmarks that recordings see with different rotations, choose the one that explains all best."""
        for number in self.group.turned:
            version = self.group.versions[number]
            candidates = [(self.single_poses[r][0][row], self.single_poses[r][1][row]) for r, row in version.members]
            costs = [self._cost(version, R, p) for R, p in candidates]
            version.R, version.p = candidates[int(np.argmin(costs))]

    def _cost(self, version: Version, R: FloatArray, p: FloatArray) -> float:
        cost = 0.0
        for recording, row in version.members:
            problem = self.problems[recording]
            before = problem.state()
            problem.put(row, R, p)
            cost += float(problem.landmark_costs()[row])
            problem.restore(before)
        return cost

    def _adjust(self) -> None:
        """Joint adjustment without outlier observations."""
        versions = self.group.versions
        R, p = np.array([v.R for v in versions]), np.array([v.p for v in versions])
        rows = [*self.group.rows(), np.arange(len(versions))]
        self.knowledge = self._knowledge(R, p)
        self.joint = JointProblem([*self.problems, self.knowledge], rows, R, p)
        for problem, used in zip(self.problems, self.single_used, strict=True):
            problem.used = used.copy()
        dropped = -1
        for _ in range(ROUNDS):
            self.joint.optimize(STEPS)
            now = sum(problem.drop_outliers(OUTLIER_SIGMA) for problem in self.problems)
            if now == dropped:
                break
            dropped = now
        for version, R_now, p_now in zip(versions, self.joint.R, self.joint.p, strict=True):
            version.R, version.p = R_now, p_now

    def _knowledge(self, R: FloatArray, p: FloatArray) -> BundleProblem:
        """The priors, as a recording without frames that contains all landmarks.

        If a landmark has several versions, the known map belongs to the nearest, and a declared wall to the last.
        """
        last = self._last_versions()
        mapped = []
        for number, version in enumerate(self.group.versions):
            anchor = self.anchors.get(version.id)
            if anchor is None:
                named = last[version.id] == number
            else:
                t = anchor.landmark.T_map_landmark.t
                same = [v for v in self.group.versions if v.id == version.id]
                named = min(same, key=lambda v: float(np.linalg.norm(v.p - t))) is version
            id_ = version.id if named else LandmarkId("", number)
            T = Pose("map", "landmark", orthonormal(R[number]), p[number])
            mapped.append(MappedLandmark(id_, 1.0, T))
        nowhere = PoseArray("map", "left", np.zeros((0, 3, 3)), np.zeros((0, 3)))
        rig = self.group.surveys[0].rig
        return BundleProblem((), rig, nowhere, LandmarkMap(mapped), self.anchors, constraints=self.constraints)

    def _last_versions(self) -> dict[LandmarkId, int]:
        """Current version of each landmark."""
        last: dict[LandmarkId, int] = {}
        for number, version in enumerate(self.group.versions):
            best = last.get(version.id)
            if best is None or self._when(version) > self._when(self.group.versions[best]):
                last[version.id] = number
        return last

    def _when(self, version: Version) -> tuple[float, int]:
        """Order in time: by the clocks if they are comparable, else by the order of the recordings."""
        return (self.span(version)[1] if self.dated([version]) else 0.0), version.recordings[-1]

    def dated(self, versions: Sequence[Version]) -> bool:
        """Whether the clocks determine which of these came first."""
        spans = sorted((problem.times[0], problem.times[-1]) for problem in self.problems)
        if all(before[1] <= after[0] for before, after in pairwise(spans)):
            return True
        seen = sorted(self.span(version) for version in versions)
        return spans[0][0] > CALENDAR_S and all(before[1] <= after[0] for before, after in pairwise(seen))

    def span(self, version: Version) -> tuple[float, float]:
        """First and last time of observations that agree with this version."""
        times = []
        for recording, row in version.members:
            problem = self.problems[recording]
            at = problem.seen.at[(problem.seen.of == row) & problem.used]
            times += problem.times[at].tolist()
        return (min(times), max(times)) if times else (0.0, 0.0)

    def _release(self) -> bool:
        """The known landmark farthest from its known place, if significantly: it was moved."""
        if not self.known:
            return False
        views = {
            v.id: KnownView(k, v.members)
            for k, v in enumerate(self.group.versions)
            if self.knowledge.landmark_ids[k] == v.id and v.id in self.anchors and v.id not in self.held
        }
        test = find_moved(self.joint, self.problems, views, self.anchors, noise_factor(self.problems))
        self.disputed = () if test is None else test.disputed
        if test is None or test.disputed:
            return False
        self.anchors = {id_: anchor for id_, anchor in self.anchors.items() if id_ != test.worst}
        self.released.add(test.worst)
        return True

    def _released_by_all(self) -> set[LandmarkId]:
        """Known landmarks that every recording which saw them has at another place."""
        saw = [(one.released, set(one.solved.problem.landmark_ids)) for one in self.group.surveys]
        some = {id_ for released, _ in saw for id_ in released}
        return {id_ for id_ in some if all(id_ in released for released, seen in saw if id_ in seen)}

    def _take_back(self) -> bool:
        """Released landmarks that are at their known places after all: another landmark had pulled them."""
        if not self.released:
            return False
        C, noise = self.joint.covariance(), noise_factor(self.problems)
        back = set()
        for number, version in enumerate(self.group.versions):
            rows = unknowns_of([number], 6)
            if version.id in self.released and is_at_known_place(
                self.known[version.id], version.R, version.p, noise * C[np.ix_(rows, rows)], len(self.known)
            ):
                back.add(version.id)
        self.released -= back
        self.held |= back
        self.anchors |= {id_: self.known[id_] for id_ in back}
        return bool(back)

    def _split(self) -> bool:
        """The landmark that two poses explain most significantly better than one, if any (`moved_landmarks.py`).

        One at a time: a moved landmark pulls its recording, and with it landmarks that nobody moved.  Known places
        that contradict each other do so too, so motions of those landmarks are not reported.
        """
        self.noise = noise_factor(self.problems)
        tests = split_tests(self.joint, self.problems, self.group.versions, self.single_used, self.noise)
        self.threshold = moved_threshold(len(tests))
        over = [
            t
            for t in tests
            if t.chi2 > self.threshold
            and self.merged_back[t.member] < MOST_MERGES
            and self.group.versions[t.version].id not in self.disputed
        ]
        if not over:
            return False
        version = self.group.versions[max(over, key=lambda t: t.chi2).version]
        off = [t.member for t in over if t.member in version.members]
        if len(off) == len(version.members):
            off = off[1:]
        for recording, row in off:
            version.members.remove((recording, row))
            R, p = (poses[row] for poses in self.single_poses[recording])
            self.group.versions.append(Version(version.id, [(recording, row)], R, p))
        return True

    def _merge(self) -> bool:
        """Merge versions of a landmark that are at one place, according to the joint covariance."""
        numbers: dict[LandmarkId, list[int]] = {}
        for number, version in enumerate(self.group.versions[: len(self.joint.p)]):
            numbers.setdefault(version.id, []).append(number)
        several = [same for same in numbers.values() if len(same) > 1]
        if not several:
            return False
        C = self.joint.covariance()
        gone: set[int] = set()
        for same in several:
            for i, a in enumerate(same):
                for b in same[i + 1 :]:
                    if a in gone or b in gone or self._apart_chi2(a, b, C) > self.threshold:
                        continue
                    self.merged_back.update(self.group.versions[b].members)
                    self.group.versions[a].members += self.group.versions[b].members
                    gone.add(b)
        self.group.versions = [v for k, v in enumerate(self.group.versions) if k not in gone]
        return bool(gone)

    def _apart_chi2(self, a: int, b: int, C: FloatArray) -> float:
        """Squared distance of two versions in standard deviations."""
        va, vb = self.group.versions[a], self.group.versions[b]
        if set(va.recordings) & set(vb.recordings):
            return np.inf
        d = np.concatenate([va.p - vb.p, rotation_log(va.R @ vb.R.T)])
        ra, rb = unknowns_of([a], 6), unknowns_of([b], 6)
        both = C[np.ix_(ra, ra)] + C[np.ix_(rb, rb)] - C[np.ix_(ra, rb)] - C[np.ix_(rb, ra)]
        return float(d @ np.linalg.solve(self.noise * both + unmoved_covariance(), d))

    def results(self, left_out: Mapping[str, str], keep_doubtful: bool = False) -> JointSurvey:
        """Map, recordings and warnings; covariances include the noise factors of the observations."""
        noise = [noise_factor([problem]) for problem in self.problems]
        C, spreads = self._covariance(noise), self._spreads()
        surveys, information = [], []
        for one, rows, factor in zip(self.group.surveys, self.group.rows(), noise, strict=True):
            problem = one.solved.problem
            own = recording_information(problem, problem.stated_equations(factor))
            known = _elsewhere(C, unknowns_of(rows, 6), own.H)
            undecided = {k: spreads[v] for k, v in enumerate(rows.tolist()) if v in spreads}
            surveys.append(survey_of(replace(one.solved, undecided=undecided), {}, (), known))
            information.append(own)
        for number, spread in spreads.items():
            rows = unknowns_of([number], 6)
            C[np.ix_(rows, rows)] += spread
        current, moved, order = self._mapped(C)
        kept_out = () if keep_doubtful else self._doubtful(current, order)
        out = {one.id for one in kept_out}
        order = [number for m, number in zip(current, order, strict=True) if m.id not in out]
        current = [m for m in current if m.id not in out]
        moved = [one for one in moved if one.after.id not in out]
        unseen = [
            replace(anchor.landmark, covariance=anchor.covariance)
            for id_, anchor in self.known.items()
            if all(m.id != id_ for m in current)
        ]
        past = [m.before for m in moved if m.before.valid_to_s is not None]
        landmarks = LandmarkMap([*current, *unseen, *past])
        columns = unknowns_of(order, 6)
        return JointSurvey(
            landmarks,
            C[np.ix_(columns, columns)],
            tuple(one.name for one in self.group.surveys),
            tuple(surveys),
            dict(left_out),
            tuple(moved),
            tuple(information),
            poorly_determined_landmarks(LandmarkMap(current)),
            tuple(sorted({id_ for survey in surveys for id_ in survey.unplaced if id_ not in landmarks} - out)),
            tuple(sorted({v.id for k, v in enumerate(self.group.versions) if k in spreads and k in order})),
            landmarks_off_constraint(self.constraints, LandmarkMap(current), C[np.ix_(columns, columns)]),
            kept_out=kept_out,
            disputed=self.disputed,
        )

    def _doubtful(self, current: Sequence[MappedLandmark], order: Sequence[int]) -> tuple[KeptOut, ...]:
        """Landmarks that too few frames of all recordings support."""
        recordings = [LocatedFrames.of(one.solved.problem, one.rig) for one in self.group.surveys]
        # If a landmark has several versions, the current one is tested.
        for m, number in zip(current, order, strict=True):
            members = {recording for recording, _ in self.group.versions[number].members}
            for k, recording in enumerate(recordings):
                if k not in members:
                    recording.read.pop(m.id, None)
        return doubtful_landmarks(current, recordings, {*self.known, *self.anchors})

    def _covariance(self, noise: Sequence[float]) -> FloatArray:
        """Joint covariance of all versions, with a factor of the variances of each recording's observations."""
        return self._stated(noise).covariance()

    def _stated(self, noise: Sequence[float]) -> InformationSum:
        """Equations of all versions, with the swelling of faces as unknown."""
        problems = zip([*self.problems, self.knowledge], [*noise, 1.0], strict=True)
        parts = (problem.stated_equations(factor)[0].eliminate(problem.own) for problem, factor in problems)
        return self.joint.sum_of(parts)

    def _find_swelling(self) -> None:
        """Estimate the swelling of faces in every recording, with the joint landmark poses."""
        noise = [noise_factor([problem]) for problem in self.problems]
        step = self._stated(noise).solve()
        for problem, rows, factor in zip(self.problems, self.group.rows(), noise, strict=True):
            problem.find_swelling(factor, step[unknowns_of(rows, 6)])

    def _mapped(self, C: FloatArray) -> tuple[list[MappedLandmark], list[MovedLandmark], list[int]]:
        """Landmarks that are valid now, those that were moved, and the versions of the valid ones."""
        numbers: dict[LandmarkId, list[int]] = {}
        for number, version in enumerate(self.group.versions):
            if self._supported(version):
                numbers.setdefault(version.id, []).append(number)
        current, moved, order = [], [], []
        for _, same in sorted(numbers.items()):
            same.sort(key=lambda number: self._when(self.group.versions[number]))
            dated = self.dated([self.group.versions[number] for number in same])
            chain = []
            for k, number in enumerate(same):
                since, until = self.span(self.group.versions[number])
                valid_from = since if dated and k > 0 else None
                valid_to = until if dated and k < len(same) - 1 else None
                chain.append(replace(self._landmark(number, C), valid_from_s=valid_from, valid_to_s=valid_to))
            if same and self.group.versions[same[0]].id in self.released:
                moved.append(self._moved_since(same[0], chain))
            for (a, before), (b, after) in pairwise(zip(same, chain, strict=True)):
                moved.append(MovedLandmark(before, after, self._names(a), self._names(b)))
            current.append(chain[-1])
            order.append(same[-1])
        return current, moved, order

    def _moved_since(self, number: int, chain: list[MappedLandmark]) -> MovedLandmark:
        """From the known map to the first of a landmark's places, which gets its date."""
        version = self.group.versions[number]
        since_s = self.span(version)[0]
        moved = MovedLandmark.since_known(self.known[version.id], chain[0], since_s, self._names(number))
        chain[0] = moved.after
        return moved

    def _supported(self, version: Version) -> bool:
        """Whether any observation supports this version, or it is known beforehand."""
        pairs = [(self.problems[recording], row) for recording, row in version.members]
        seen = any(((problem.seen.of == row) & problem.used).any() for problem, row in pairs)
        return seen or version.id in self.anchors

    def _landmark(self, number: int, C: FloatArray) -> MappedLandmark:
        version, rows = self.group.versions[number], unknowns_of([number], 6)
        recording, row = version.members[0]
        T = Pose("map", "landmark", orthonormal(version.R), version.p)
        return replace(self.problems[recording].mapped[row], T_map_landmark=T, covariance=C[np.ix_(rows, rows)])

    def _names(self, number: int) -> tuple[str, ...]:
        return tuple(self.group.surveys[recording].name for recording in self.group.versions[number].recordings)

    def _spreads(self) -> dict[int, FloatArray]:
        """(6,6) by version: landmarks whose pose is ambiguous in every recording that saw them."""
        spreads = {}
        for number, version in enumerate(self.group.versions):
            mine = [self.group.surveys[r].solved.undecided.get(row) for r, row in version.members]
            known = [spread for spread in mine if spread is not None]
            if mine and len(known) == len(mine):
                spreads[number] = min(known, key=np.trace)
        return spreads


def _elsewhere(C: FloatArray, rows: IntArray, own: FloatArray) -> FloatArray:
    """Information on some unknowns from other recordings, from the joint covariance of all."""
    mine = C[np.ix_(rows, rows)]
    # Exactly known landmarks occur together with poorly determined ones.
    scale = 1 / np.sqrt(np.diag(mine))
    return np.asarray(np.linalg.inv(mine * scale[:, None] * scale) * scale[:, None] * scale - own)
