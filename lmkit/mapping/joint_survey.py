"""JointSurvey: the result of surveying several recordings of one place, as JSON and in words."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from lmkit.arrays import FloatArray
from lmkit.mapping.landmark_support import KeptOut
from lmkit.mapping.moved_landmark import MovedLandmark
from lmkit.mapping.survey_results import Survey, disputed_text, landmark_dict
from lmkit.mapping.wall_constraints import LandmarkConstraint
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_information import LandmarkInformation
from lmkit.model.landmark_map import LandmarkMap
from lmkit.units import counted

OF_RECORDING = ("frames", "located", "dropped", "reprojection_error_px", "jumps", "odometry")


@dataclass(frozen=True, eq=False)
class JointSurvey:
    """Several surveyed recordings.

    Attributes:
        landmarks: the map; `past` has landmarks as they were before they were moved.
        joint: (6L,6L) covariance of all landmarks valid now, in the map's order.
        names, surveys: of the recordings that fit, with poses and landmarks of the joint adjustment.
        left_out: names of recordings that do not fit or cannot be surveyed, and why.
        moved: landmarks that were moved between recordings.
        information: of each recording that fits, on its landmarks.
        poorly_determined, unplaced, ambiguous, off_constraint: as in `Survey`, for all recordings.
        warnings: what a user should check, in words.
        kept_out: codes that were read but are doubtful in all recordings together.
        disputed: as in `Survey`, for all recordings.
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
    kept_out: tuple[KeptOut, ...] = ()
    disputed: tuple[LandmarkId, ...] = ()

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
            "disputed": [str(id_) for id_ in self.disputed],
            "kept_out": [one.to_dict() for one in self.kept_out],
        }


def joint_warnings(result: JointSurvey) -> tuple[str, ...]:
    """Warnings about what a user should check, one sentence each."""
    texts = [str(moved) for moved in result.moved]
    texts += [str(one) for one in result.kept_out]
    if result.disputed:
        texts.append(disputed_text(result.disputed))
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
