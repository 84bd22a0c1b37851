"""JointSurvey: the result of surveying several recordings of one place, as JSON and in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.geometry.rotations import rotation_log
from lmkit.mapping.survey_results import Survey, landmark_dict
from lmkit.mapping.wall_constraints import LandmarkConstraint
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_information import LandmarkInformation
from lmkit.model.landmark_map import CALENDAR_S, LandmarkMap, MappedLandmark, day_of
from lmkit.units import counted

OF_RECORDING = ("frames", "located", "dropped", "reprojection_error_px", "jumps", "odometry")


@dataclass(frozen=True, eq=False)
class MovedLandmark:
    """A landmark that was moved between recordings.

    Attributes:
        before, after: as it was mounted; `valid_to_s` and `valid_from_s` where the recordings' clocks tell.
        seen_before, seen_after: names of recordings.
    """

    before: MappedLandmark
    after: MappedLandmark
    seen_before: tuple[str, ...]
    seen_after: tuple[str, ...]

    @property
    def meters(self) -> float:
        """How far its middle was moved."""
        return float(np.linalg.norm(self.after.T_map_landmark.t - self.before.T_map_landmark.t))

    @property
    def radians(self) -> float:
        """How far it was turned."""
        return float(np.linalg.norm(rotation_log(self.after.T_map_landmark.R @ self.before.T_map_landmark.R.T)))

    def __str__(self) -> str:
        text = (
            f"{self.before.id} was moved by {self.meters:.2f} m and {np.rad2deg(self.radians):.0f} deg between "
            f"{_some(self.seen_before)} and {_some(self.seen_after)}"
        )
        last, first = self.before.valid_to_s, self.after.valid_from_s
        if last is None:
            text += "; their clocks overlap, so that the map has its pose in the recording given last"
        elif first is not None and last > CALENDAR_S:
            text += f" (last seen there {day_of(last)}, seen elsewhere from {day_of(first)})"
        return text

    def to_dict(self) -> dict[str, Any]:
        """JSON of a moved landmark in ``lmkit survey`` and ``lmkit fleet survey``."""
        return {
            "id": str(self.before.id),
            "metres": self.meters,
            "radians": self.radians,
            "before": list(self.seen_before),
            "after": list(self.seen_after),
            "valid_to_s": self.before.valid_to_s,
            "valid_from_s": self.after.valid_from_s,
            "sentence": str(self),
        }


def _some(names: Sequence[str]) -> str:
    """Names in a sentence; of many, the first and the last."""
    return ", ".join(names) if len(names) <= 4 else f"{names[0]} ... {names[-1]} ({len(names)} recordings)"


@dataclass(frozen=True, eq=False)
class JointSurvey:
    """Several surveyed recordings.

    Attributes:
        landmarks: the map; `past` has landmarks as they were before they were moved.
        joint: (6L,6L) covariance of all landmarks valid now, in the map's order.
        names, surveys: of the recordings that fit: poses and landmarks as all recordings together have them.
        left_out: names of recordings that do not fit or cannot be surveyed, and why.
        moved: landmarks that were moved between recordings.
        information: what each recording that fits tells of its landmarks.
        poorly_determined, unplaced, ambiguous, off_constraint: as of a `Survey`, by all recordings.
        warnings: what a user should check, in words.
    """

    landmarks: LandmarkMap
    joint: FloatArray
    names: tuple[str, ...]
    surveys: tuple[Survey, ...]
    left_out: Mapping[str, str]
    moved: tuple[MovedLandmark, ...]
    information: tuple[LandmarkInformation, ...]
    poorly_determined: tuple[tuple[LandmarkId, float, float], ...] = ()
    unplaced: tuple[LandmarkId, ...] = ()
    ambiguous: tuple[LandmarkId, ...] = ()
    off_constraint: tuple[tuple[LandmarkId, LandmarkConstraint, float], ...] = ()
    warnings: tuple[str, ...] = ()

    def __repr__(self) -> str:
        return (
            f"JointSurvey({len(self.landmarks)} landmarks, {counted(len(self.names), 'recording')}, "
            f"{len(self.left_out)} left out, {counted(len(self.warnings), 'warning')})"
        )

    def to_dict(self) -> dict[str, Any]:
        """JSON of ``lmkit survey`` with several recordings (docs/formats.md), without the file written."""
        return {
            "recordings": [
                {"name": name, **{key: value for key, value in survey.to_dict().items() if key in OF_RECORDING}}
                for name, survey in zip(self.names, self.surveys, strict=True)
            ],
            "left_out": dict(self.left_out),
            "landmarks": [{**landmark_dict(m), "valid_from_s": m.valid_from_s} for m in self.landmarks],
            "moved": [one.to_dict() for one in self.moved],
            "poorly_determined": [str(id_) for id_, _, _ in self.poorly_determined],
            "unplaced": [str(id_) for id_ in self.unplaced],
            "ambiguous": [str(id_) for id_ in self.ambiguous],
            "warnings": list(self.warnings),
        }


def joint_warnings(result: JointSurvey) -> tuple[str, ...]:
    """Warnings about what a user should check, one sentence each."""
    texts = [str(moved) for moved in result.moved]
    texts += [f"recording '{name}' is left out: {reason}" for name, reason in result.left_out.items()]
    texts += [
        f"recording '{name}': {contradicted}"
        for name, survey in zip(result.names, result.surveys, strict=True)
        for contradicted in survey.contradicted
    ]
    texts += [f"{id_} has an ambiguous pose; look from another side" for id_ in result.ambiguous]
    texts += [
        f"{id_} is {1000 * meters:.0f} mm off the {constraint} of its constraint; check it in the room"
        for id_, constraint, meters in result.off_constraint
    ]
    texts += [f"{id_} is not placed: its observations are too few, or do not agree" for id_ in result.unplaced]
    return tuple(texts)


def joint_lines(result: JointSurvey) -> list[str]:
    """One line per recording."""
    return [
        f"{name}: {len(survey.rows)} of {survey.frames} frames located, {len(survey.bundle.landmarks)} landmarks, "
        f"{survey.bundle.rms_px:.2f} px"
        for name, survey in zip(result.names, result.surveys, strict=True)
    ]
