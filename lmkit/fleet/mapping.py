"""`lmkit fleet survey`: the landmark map of every site, from all of its recordings together."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from lmkit.api.recordings import motion_of
from lmkit.errors import InputError
from lmkit.fleet.detection import STAGE as DETECT
from lmkit.fleet.detection import parts_of, read_detected
from lmkit.fleet.engines import run_jobs
from lmkit.fleet.faults import start_of
from lmkit.fleet.jobs import DIED, done_jobs
from lmkit.fleet.parts import READINGS, Part, part_folder
from lmkit.fleet.store import Store
from lmkit.io.landmark_map import map_to_yaml
from lmkit.mapping.bundle_adjustment import Anchor
from lmkit.mapping.recording_group import SingleSurvey
from lmkit.mapping.several_readings import survey_readings_together
from lmkit.mapping.several_recordings import NamedRecording, join_surveys, survey_alone
from lmkit.mapping.survey import anchors_of, landmark_sizes
from lmkit.mapping.survey_results import landmark_dict
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import LandmarkMap, day_of
from lmkit.model.recording import Odometry

STAGE = "survey"


@dataclass(frozen=True, eq=False)
class SiteSurvey:
    """Map of one site.

    Attributes:
        site: its name; empty if the fleet has one site.
        landmarks: the map.
        facts: JSON of ``lmkit fleet survey`` (docs/formats.md), as for ``lmkit survey`` with several recordings.
    """

    site: str
    landmarks: LandmarkMap
    facts: Mapping[str, Any]

    def extending(self, earlier: Mapping[str, Any]) -> SiteSurvey:
        """This survey with the facts of the survey that it extends (`extended_surveys`)."""
        moved = [*earlier["moved"], *self.facts["moved"]]
        return replace(self, facts={**self.facts, "moved": moved, "extends": made_from(earlier)})


@dataclass(frozen=True)
class PartSurvey:
    """Work of one job: survey a single part.

    Attributes:
        store: store of its detections.
        size_m: side of the landmarks, meters; known landmarks have their own.
        anchors: landmarks with known poses.
    """

    store: Store
    size_m: float
    anchors: Mapping[LandmarkId, Anchor]

    def __call__(self, part: Part) -> SingleSurvey | str:
        """Survey of the part, or the reason why there is none."""
        try:
            recording, rig = read_detected(self.store, part)
        except InputError as error:
            return str(error)
        if rig is None:
            return "it has ranges and bearings, and other recordings of the site have images"
        named = NamedRecording(part.name, recording.frames, rig, motion_of(recording))
        return survey_alone(named, landmark_sizes(recording.frames, self.size_m, self.anchors), self.anchors)


def parts_by_site(store: Store, options: Mapping[str, Any], since: str = "") -> dict[str, list[Part]]:
    """Parts of the recordings that were detected with these options and saw a landmark, in the order of time.

    Args:
        since: first day, such as 2026-11-27; empty: all.
    """
    found: dict[str, list[tuple[float, list[Part]]]] = {}
    for recording, key, outcome in done_jobs(store, DETECT, options):
        if outcome.ok and outcome.facts["detections"] and day_of(start_of(recording, outcome)) >= since:
            parts = parts_of(recording, key, outcome)
            found.setdefault(recording.site, []).append((outcome.facts["from_s"], parts))
    return {
        site: [part for _, parts in sorted(some, key=lambda one: one[0]) for part in parts]
        for site, some in sorted(found.items())
    }


def extended_surveys(store: Store, sites: Mapping[str, Sequence[Part]], known: bytes) -> dict[str, dict[str, Any]]:
    """Facts of the stored surveys whose result is the known map, by site.

    Args:
        sites: parts of the recordings that extend the map.
        known: content of the map's file.

    Raises:
        InputError: the map was already made from some of these recordings, which would count twice.
    """
    surveyed = stored_sites(store)
    stored = {site: surveyed[site] for site in sites if site in surveyed}
    extended = {site: facts for site, facts in stored.items() if stored_map(store, site).encode() == known}
    for site, facts in extended.items():
        used = set(made_from(facts))
        twice = [part.name for part in sites[site] if part.name in used]
        if twice:
            raise InputError(
                "counted_twice",
                f"the known map was made from {len(twice)} of these recordings, which would count twice: {twice[0]}",
                "give the first day of the new ones, such as --since 2026-11-27",
            )
    return extended


def made_from(facts: Mapping[str, Any]) -> list[str]:
    """Names of the recordings of a site's map, first those of the map that it extends."""
    return [*facts.get("extends", []), *(recording["name"] for recording in facts["recordings"])]


def share_joined(facts: Mapping[str, Any]) -> str:
    """Number of recordings in a site's map, such as ``8 of 9 recordings``."""
    count = len(made_from(facts))
    return f"{count} of {count + len(facts['left_out'])} recordings"


def survey_site(
    store: Store,
    site: str,
    parts: Sequence[Part],
    size_m: float,
    known: LandmarkMap | None = None,
    bumped: Mapping[str, str] | None = None,
    engine: str = "local",
) -> SiteSurvey:
    """Survey the parts of one site into one map: each one separately on the engine, then all together here.

    Args:
        size_m: side of the landmarks, meters; landmarks in ``known`` have their own.
        known: landmarks with known poses, such as yesterday's map; it defines the map frame.
        bumped: reason why a recording's rig is no longer valid, by the recording's name; these are omitted if there
            are others.

    Raises:
        InputError: no recording can be surveyed, or the engine is not available.
    """
    if all(store.exists(f"{part_folder(f'{DETECT}/{p.key}', p.number)}/{READINGS}") for p in parts):
        return _survey_readings(store, site, parts, size_m, known)
    anchors = {} if known is None else anchors_of(known)
    reasons = {p.name: bumped[p.recording] for p in parts if bumped and p.recording in bumped}
    left_out = reasons if len(reasons) < len(parts) else {}
    used = [part for part in parts if part.name not in left_out]
    with tempfile.TemporaryDirectory(prefix="lmkit-") as scratch:
        answers: dict[Part, SingleSurvey | str] = {}
        for part, answer in run_jobs(PartSurvey(store, size_m, anchors), used, engine):
            answers[part] = DIED if answer is None else _stored(answer, Path(scratch) / f"{len(answers)}.npz")
        joint = join_surveys({part.name: answers[part] for part in used}, anchors)
    joint = replace(joint, left_out={**left_out, **joint.left_out})
    landmarks = joint.landmarks if known is None else joint.landmarks.with_history_of(known)
    return SiteSurvey(site, landmarks, {"site": site, **joint.to_dict()})


def _stored(answer: SingleSurvey | str, path: Path) -> SingleSurvey | str:
    """The survey of a part, with its observations in a file, since those of a site may exceed the memory.

    Raises:
        InputError: they cannot be written.
    """
    try:
        if isinstance(answer, SingleSurvey):
            answer.solved.problem.store_observations(path)
    except OSError as error:
        raise InputError(
            "not_writable", f"cannot write {path} ({error})", "set TMPDIR to a folder with space left"
        ) from None
    return answer


def _survey_readings(
    store: Store, site: str, parts: Sequence[Part], size_m: float, known: LandmarkMap | None
) -> SiteSurvey:
    """The map in the plane from recordings of ranges and bearings."""
    if known is not None:
        raise InputError(
            "known_with_readings",
            f"site '{site}' has ranges and bearings, whose map has a frame of its own",
            "leave out --known; to use a known map, give it to lmkit track --readings",
        )
    recordings = {}
    left_out = {}
    for part in parts:
        recording, _ = read_detected(store, part)
        if isinstance(recording.odometry, Odometry):
            recordings[part.name] = recording
        else:
            left_out[part.name] = "ranges and bearings need wheel odometry: odometry.csv"
    if not recordings:
        raise InputError("nothing_surveyed", f"site '{site}': {next(iter(left_out.values()))}", "record odometry too")
    found = survey_readings_together(recordings, size_m)
    left_out |= dict.fromkeys(found.left_out, "it shares fewer than three landmarks with the others")
    entries = [{**landmark_dict(m), "valid_from_s": None} for m in found.landmarks]
    names = [{"name": name, "frames": len(drive), "located": len(drive)} for name, drive in found.drives.items()]
    nothing: dict[str, list[str]] = {
        name: [] for name in ("moved", "poorly_determined", "unplaced", "ambiguous", "warnings")
    }
    facts = {"site": site, "recordings": names, "left_out": left_out, "landmarks": entries, **nothing}
    return SiteSurvey(site, found.landmarks, facts)


def write_site(store: Store, surveyed: SiteSurvey) -> str:
    """Write the map and the facts of a site into the store; returns the map's text."""
    text = map_to_yaml(surveyed.landmarks)
    store.write(f"{STAGE}/{surveyed.site or 'site'}.yaml", text)
    store.write_table(f"{STAGE}/{surveyed.site or 'site'}.parquet", {"site": [surveyed.site]}, surveyed.facts)
    return text


def stored_sites(store: Store) -> dict[str, dict[str, Any]]:
    """Facts of every surveyed site, by its name."""
    names = [name for name in store.names(STAGE) if name.endswith(".parquet")]
    facts = [store.read_table(f"{STAGE}/{name}")[1] for name in names]
    return {fact["site"]: fact for fact in facts}


def stored_map(store: Store, site: str) -> str:
    """Text of a site's map.

    Raises:
        InputError: the site was not surveyed.
    """
    return store.read(f"{STAGE}/{site or 'site'}.yaml").decode()
