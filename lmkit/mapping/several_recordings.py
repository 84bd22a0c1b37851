"""`survey_recordings`: one map from several recordings of one place.

1. Each recording is surveyed alone (`survey.py`), and aligned with the others by shared landmarks
   (`recording_group.py`).
2. Joint adjustment of all, with landmarks that were moved split in two (`joint_solver.py`).
3. A recording in which most shared landmarks are elsewhere does not fit: it is left out, and all is done again.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from lmkit.errors import InputError
from lmkit.geometry.rig import AnyRig
from lmkit.mapping.bundle_adjustment import Anchor
from lmkit.mapping.joint_solver import JointSolver
from lmkit.mapping.joint_survey import JointSurvey
from lmkit.mapping.known_survey import solve_by_known
from lmkit.mapping.recording_group import SingleSurvey, join_recordings
from lmkit.mapping.survey import solve_recording, survey_of
from lmkit.mapping.wall_constraints import LandmarkConstraint
from lmkit.model.landmark_id import LandmarkId, ids_text
from lmkit.model.recording import RigFrame
from lmkit.odometry.motion_model import Motion
from lmkit.parallel import map_sharing

NAMED = 4  # landmarks in an error message


@dataclass(frozen=True, eq=False)
class NamedRecording:
    """A recording to survey with others.

    Attributes:
        name: its name in messages.
        frames: in the order of time.
        rig: that took them.
        motion: its odometry, if any.
    """

    name: str
    frames: tuple[RigFrame, ...]
    rig: AnyRig
    motion: Motion | None = None


@dataclass(frozen=True, eq=False)
class _Beforehand:
    """Prior knowledge: sizes, known landmarks, walls."""

    sizes_m: Mapping[LandmarkId, float]
    anchors: Mapping[LandmarkId, Anchor]
    constraints: Sequence[LandmarkConstraint]


def survey_recordings(
    recordings: Sequence[NamedRecording],
    sizes_m: Mapping[LandmarkId, float],
    anchors: Mapping[LandmarkId, Anchor],
    constraints: Sequence[LandmarkConstraint] = (),
    in_processes: bool = False,
    keep_doubtful: bool = False,
) -> JointSurvey:
    """Survey several recordings of one place into one map.

    Args:
        recordings: in any order; where their clocks overlap, from the earliest to the latest.
        sizes_m, anchors, constraints: see `survey_frames`.
        in_processes: survey single recordings in worker processes.
        keep_doubtful: as of `survey_frames`, by all recordings together.

    Raises:
        InputError: no recording can be surveyed.
    """
    known = _Beforehand(sizes_m, anchors, constraints)
    again = repeated_recordings(recordings)
    once = [recording for recording in recordings if recording.name not in again]
    alone = map_sharing(_survey_alone, known, once)
    answers = list(alone if in_processes else (_survey_alone(known, recording) for recording in once))
    found = {recording.name: answer for recording, answer in zip(once, answers, strict=True)}
    named = {r.name: again.get(r.name) or found[r.name] for r in recordings}
    return join_surveys(named, anchors, constraints, keep_doubtful)


def repeated_recordings(recordings: Sequence[NamedRecording]) -> dict[str, str]:
    """Names of recordings that equal an earlier one to the last bit, and a clause for each.

    If the same images were counted twice, covariances would be too small.
    """
    first: dict[bytes, str] = {}
    again = {}
    for recording in recordings:
        digest = hashlib.sha256()
        for frame in recording.frames:
            for seen in frame.seen:
                digest.update(f"{len(seen)}".encode())
                for detection in seen:
                    digest.update(f"{detection.id}".encode() + np.ascontiguousarray(detection.corners).tobytes())
        same = first.setdefault(digest.digest(), recording.name)
        if same != recording.name and any(frame.detections for frame in recording.frames):
            again[recording.name] = f"it shows the same as '{same}', in every frame"
    return again


def _survey_alone(known: _Beforehand, recording: NamedRecording) -> SingleSurvey | str:
    return survey_alone(recording, known.sizes_m, known.anchors, known.constraints)


def survey_alone(
    recording: NamedRecording,
    sizes_m: Mapping[LandmarkId, float],
    anchors: Mapping[LandmarkId, Anchor],
    constraints: Sequence[LandmarkConstraint] = (),
) -> SingleSurvey | str:
    """Survey of one recording, to be joined with others; or the reason why it cannot be surveyed.

    Args:
        sizes_m, anchors, constraints: see `survey_frames`.
    """
    seen = {o.id for frame in recording.frames for o in frame.detections}
    mine = {id_: anchor for id_, anchor in anchors.items() if id_ in seen}
    frames, rig, motion = recording.frames, recording.rig, recording.motion
    solve = partial(solve_recording, frames, rig, sizes_m, motion=motion, constraints=constraints)
    try:
        known = solve_by_known(solve, mine)
    except InputError as error:
        return str(error)
    known.solved.problem.forget_frames()
    survey = survey_of(known.solved, known.anchors, constraints)
    return SingleSurvey(recording.name, rig, known.solved, survey, bool(mine), known.released)


def join_surveys(
    answers: Mapping[str, SingleSurvey | str],
    anchors: Mapping[LandmarkId, Anchor],
    constraints: Sequence[LandmarkConstraint] = (),
    keep_doubtful: bool = False,
) -> JointSurvey:
    """One map from surveys of single recordings.

    Args:
        answers: results of `survey_alone`, by the recording's name, in the order of the recordings.
        anchors, constraints, keep_doubtful: see `survey_frames`.

    Raises:
        InputError: no recording could be surveyed, or none saw a known landmark.
    """
    surveys = [answer for answer in answers.values() if isinstance(answer, SingleSurvey)]
    left_out = {name: answer for name, answer in answers.items() if isinstance(answer, str)}
    if not surveys:
        name, reason = next(iter(left_out.items()))
        raise InputError(
            "nothing_surveyed", f"no recording can be surveyed; {name}: {reason}", "check each one alone"
        )
    if anchors and not any(one.anchored for one in surveys):
        raise InputError(
            "nothing_known",
            f"no recording that can be surveyed saw a known landmark ({ids_text(sorted(anchors)[:NAMED])})",
            "give the map of this place, or leave out --known (known=)",
        )
    while True:
        group = join_recordings(surveys)
        left_out |= group.left_out
        joint = JointSolver(group, anchors, constraints)
        joint.solve()
        contradicted = joint.contradicted_recordings()
        if not contradicted:
            return joint.results(left_out, keep_doubtful)
        joint.restore_anchors()
        left_out |= contradicted
        surveys = [one for one in group.surveys if one.name not in contradicted]
