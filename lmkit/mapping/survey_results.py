"""Survey: the result of a survey, in words, as JSON, as a table, as a trajectory."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from lmkit.geometry.pose import Pose
from lmkit.geometry.rig import AnyRig
from lmkit.mapping.bundle_results import Bundle
from lmkit.mapping.hinges import hinges_of
from lmkit.mapping.landmark_support import KeptOut
from lmkit.mapping.map_doubts import exactness_doubts, overlap_doubts
from lmkit.mapping.moved_landmark import MovedLandmark
from lmkit.mapping.wall_constraints import LandmarkConstraint
from lmkit.model.landmark_id import LandmarkId, ids_text
from lmkit.model.landmark_map import LandmarkMap, MappedLandmark
from lmkit.odometry.motion_model import Motion, describe_odometry
from lmkit.units import counted

LISTED = 3  # more landmarks with large standard deviations are not listed one by one


@dataclass(frozen=True)
class ContradictedLandmark:
    """A landmark that part of its observations contradict.

    Attributes:
        off, observations: number of its outliers, and of all its observations.
        from_s, to_s: first and last time of these.
        place: x, y, z (m) in the map according to the outliers; None if they do not agree.
    """

    id: LandmarkId
    off: int
    observations: int
    from_s: float
    to_s: float
    place: tuple[float, float, float] | None = None

    def __str__(self) -> str:
        where = "" if self.place is None else " and show it at x {:.2f} y {:.2f} z {:.2f} m".format(*self.place)
        return (
            f"{self.off} of {self.observations} observations of {self.id}, "
            f"from {self.from_s:.2f} to {self.to_s:.2f} s, "
            f"contradict its pose{where}: "
            "it was moved, its code appears twice, or it was misread; check it in the room"
        )


@dataclass(frozen=True, eq=False)
class Survey:
    """A surveyed recording.

    Attributes:
        bundle: poses, landmarks seen, parameters.
        landmarks: these, and known ones that the recording did not see, unchanged.
        rows: (N,) which of the frames given have a pose.
        contradicted: landmarks contradicted by part of their observations.
        poorly_determined: landmarks determined to no better than 3 cm or 2 deg, with both deviations (m, rad).
        unplaced: landmarks that were seen but could not be placed.
        dropped: observations left out.
        ambiguous: landmarks whose two poses explain the observations almost equally well.
        off_constraint: landmarks off their constraints, with the constraint and the distance (m).
        warnings: what a user should check, in words.
        frames: number of given frames.
        odometry, odometry_sigmas: errors of the odometry and gyro that were solved for, by name, and their
            standard deviations.
        moved: known landmarks that were moved since; `landmarks.past` has them as they were.
        disputed: known landmarks that contradict each other, with too few in view to determine which was moved.
        kept_out: doubtful codes that were left out of the map.
    """

    bundle: Bundle
    landmarks: LandmarkMap
    rows: tuple[int, ...]
    contradicted: tuple[ContradictedLandmark, ...]
    poorly_determined: tuple[tuple[LandmarkId, float, float], ...]
    unplaced: tuple[LandmarkId, ...]
    dropped: int
    ambiguous: tuple[LandmarkId, ...] = ()
    off_constraint: tuple[tuple[LandmarkId, LandmarkConstraint, float], ...] = ()
    warnings: tuple[str, ...] = ()
    frames: int = 0
    odometry: Mapping[str, float] = field(default_factory=dict)
    odometry_sigmas: Mapping[str, float] = field(default_factory=dict)
    moved: tuple[MovedLandmark, ...] = ()
    disputed: tuple[LandmarkId, ...] = ()
    kept_out: tuple[KeptOut, ...] = ()

    def __repr__(self) -> str:
        return (
            f"Survey({len(self.bundle.landmarks)} landmarks, {len(self.rows)} of {self.frames} frames, "
            f"{self.bundle.rms_px:.2f} px, {counted(len(self.warnings), 'warning')})"
        )

    def to_dict(self) -> dict[str, Any]:
        """JSON of ``lmkit survey`` (docs/formats.md), without the file that the command wrote."""
        bundle = self.bundle
        observations = dict(zip(bundle.ids, np.bincount(bundle.of, minlength=len(bundle.ids)).tolist(), strict=True))
        return {
            "landmarks": [{**landmark_dict(m), "observations": observations[m.id]} for m in bundle.landmarks],
            "frames": self.frames,
            "located": len(self.rows),
            "dropped": self.dropped,
            "reprojection_error_px": bundle.rms_px if math.isfinite(bundle.rms_px) else None,
            "contradicted": [_contradicted_dict(c) for c in self.contradicted],
            "jumps": [{"from_s": a, "to_s": b, "metres": m} for a, b, m in bundle.jumps],
            "poorly_determined": [str(id_) for id_, _, _ in self.poorly_determined],
            "unplaced": [str(id_) for id_ in self.unplaced],
            "warnings": list(self.warnings),
            "ambiguous": [str(id_) for id_ in self.ambiguous],
            "off_constraint": [
                {"id": str(id_), "of": str(constraint), "metres": meters}
                for id_, constraint, meters in self.off_constraint
            ],
            "odometry": dict(self.odometry),
            "odometry_sigma": dict(self.odometry_sigmas),
            "moved": [one.to_dict() for one in self.moved],
            "disputed": [str(id_) for id_ in self.disputed],
            "kept_out": [one.to_dict() for one in self.kept_out],
        }


def landmark_dict(m: MappedLandmark) -> dict[str, Any]:
    """JSON of a surveyed landmark."""
    place, turn = deviations(m)
    return {
        "id": str(m.id),
        "code": m.code,
        "position": m.T_map_landmark.t.tolist(),
        "quaternion": m.T_map_landmark.quaternion_xyzw.tolist(),
        "sigma_m": place,
        "sigma_rad": turn,
    }


def _contradicted_dict(c: ContradictedLandmark) -> dict[str, Any]:
    return {
        "id": str(c.id),
        "code": c.id.code,
        "off": c.off,
        "of": c.observations,
        "from_s": c.from_s,
        "to_s": c.to_s,
        "place": None if c.place is None else list(c.place),
    }


def deviations(landmark: MappedLandmark) -> tuple[float, float]:
    """Standard deviation of a landmark's position (m, all axes together) and largest of its rotation (rad)."""
    C = landmark.covariance
    if C is None:
        return 0.0, 0.0
    # An undetermined variance may be negative by rounding; its size is meaningful.
    return float(np.sqrt(abs(np.trace(C[:3, :3])))), float(np.sqrt(abs(np.linalg.eigvalsh(C[3:, 3:])[-1])))


def disputed_text(ids: Sequence[LandmarkId]) -> str:
    """Known landmarks that contradict each other, as a sentence."""
    return (
        f"the known places of {ids_text(ids)} contradict the observations, and too few others are in view to decide "
        "which were moved: drive past more known landmarks, or check that the map is of this place"
    )


def jump_landmarks(bundle: Bundle, from_s: float, to_s: float) -> str:
    """Landmarks seen in the frames before and after a jump, in parentheses."""
    during = (bundle.times_s >= from_s) & (bundle.times_s <= to_s)
    seen = sorted({bundle.ids[k] for k in bundle.of[during[bundle.frames]].tolist()})
    return f" ({ids_text(seen)})" if seen else ""


def kept_out_texts(kept_out: Sequence[KeptOut], frames: int) -> list[str]:
    """Codes that are kept out of the map, one sentence each; for a recording of one frame, one sentence for all."""
    if frames > 1 or not kept_out:
        return [str(one) for one in kept_out]
    return [
        f"the recording has one frame, and landmarks of a single frame are kept out of the map: "
        f"{ids_text([one.id for one in kept_out])}; record from several places, or keep them (--keep-doubtful)"
    ]


def survey_warnings(
    result: Survey, motion: Motion | None, constraints: Sequence[LandmarkConstraint], advice: Mapping[LandmarkId, str]
) -> list[str]:
    """Warnings about what a user should check, one sentence each."""
    mapped_landmarks = result.bundle.landmarks
    hinges = hinges_of(result.bundle) if motion is None else []
    # A fold comes first, since landmarks that overlap follow from it.
    texts = [str(hinge) for hinge in hinges if hinge.jump is not None]
    texts += [str(moved) for moved in result.moved]
    if result.disputed:
        texts.append(disputed_text(result.disputed))
    texts += kept_out_texts(result.kept_out, result.frames)
    texts += exactness_doubts(mapped_landmarks, [c.id for c in result.contradicted])
    texts += [str(contradicted) for contradicted in result.contradicted]
    texts += overlap_doubts(mapped_landmarks)
    doubt = None if motion is None else describe_odometry(motion, result.bundle.parameters)
    if doubt is not None:
        texts.append(doubt)
    folds = {hinge.jump for hinge in hinges}
    for jump in result.bundle.jumps:
        if jump in folds:
            continue
        from_s, to_s, meters = jump
        seen = jump_landmarks(result.bundle, from_s, to_s)
        texts.append(
            f"between {from_s:.2f} and {to_s:.2f} s the rig jumps by {meters:.2f} m: it slid or was carried, or a "
            f"landmark seen there{seen} was moved, or its second pose is the right one; look from another side"
        )
    texts += [str(hinge) for hinge in hinges if hinge.jump is None]
    for code in result.ambiguous:
        texts.append(f"{code} has an ambiguous pose: it was seen from one side, far away; look from another side")
    for code, constraint, meters in result.off_constraint:
        texts.append(f"{code} is {1000 * meters:.0f} mm off the {constraint} of its constraint; check it in the room")
    mapped = {m.id for m in mapped_landmarks}
    for constraint in constraints:
        missing = [id_ for id_ in constraint.ids if id_ not in mapped]
        if missing:
            texts.append(
                f"the constraint '{constraint}' names landmarks that are not in the map: {ids_text(missing)}"
            )
    for code in result.unplaced:
        texts.append(
            f"{code} is not placed: its observations are too few, or do not agree; drive past it again, and nearer"
        )
    return texts + _poorly_known(result, advice)


def _poorly_known(result: Survey, advice: Mapping[LandmarkId, str]) -> list[str]:
    """Landmarks with large standard deviations; those with the same advice in one sentence."""
    by_advice: dict[str, list[tuple[LandmarkId, float, float]]] = {}
    for one in result.poorly_determined:
        by_advice.setdefault(advice.get(one[0], ""), []).append(one)
    known = {text: _deviations_text(some) for text, some in by_advice.items()}
    return [f"{sentence}: {text}" if text else sentence for text, sentence in known.items()]


def _deviations_text(some: Sequence[tuple[LandmarkId, float, float]]) -> str:
    """Standard deviations (m, rad) of landmarks; of many, the largest."""
    if len(some) <= LISTED:
        return ", ".join(
            f"{id_} has standard deviations of {1000 * place:.0f} mm and {math.degrees(turn):.1f} deg"
            for id_, place, turn in some
        )
    place, turn = max(one[1] for one in some), max(one[2] for one in some)
    return (
        f"{len(some)} landmarks have standard deviations of up to {1000 * place:.0f} mm and {math.degrees(turn):.1f} "
        f"deg ({ids_text([one[0] for one in some])})"
    )


def survey_lines(result: Survey, frames: int, output: Path) -> list[str]:
    """A table of the landmarks, and a summary, as lines of text."""
    bundle = result.bundle
    lines = ["landmark   x m      y m      z m      +- mm   +- deg  observations  residual"]
    for m in sorted(bundle.landmarks, key=lambda m: m.id):
        mine = bundle.of == bundle.ids.index(m.id)
        place, turn = deviations(m)
        x, y, z = m.T_map_landmark.t
        residual = float(np.median(bundle.residuals[mine])) if mine.any() else math.nan
        lines.append(
            f"{m.id!s:8} {x:8.3f} {y:8.3f} {z:8.3f} {1000 * place:9.1f} {math.degrees(turn):8.2f} {mine.sum():8d}"
            f" {residual:9.2f}"
        )
    lines.append(
        f"{len(bundle.landmarks)} landmarks, {len(result.rows)} of {frames} frames located, "
        f"{result.dropped} observations rejected, {bundle.rms_px:.2f} px -> {output}"
    )
    return lines


def base_poses(bundle: Bundle, rig: AnyRig) -> Iterator[tuple[float, Pose]]:
    """Times and poses of the robot's base, or of the left camera if the rig has no T_base_left."""
    for time_s, pose in zip(bundle.times_s.tolist(), bundle.left_poses(), strict=True):
        yield time_s, pose if rig.T_base_left is None else pose @ rig.T_base_left.inverse()
