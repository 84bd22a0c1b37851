"""`lmkit fleet survey`: the landmark map of every site, from all of its recordings together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from lmkit.api.recordings import motion_of
from lmkit.errors import InputError
from lmkit.fleet.detection import STAGE as DETECT
from lmkit.fleet.detection import parts_of, read_detected
from lmkit.fleet.engines import run_jobs
from lmkit.fleet.jobs import DIED, done_jobs
from lmkit.fleet.parts import Part
from lmkit.fleet.store import Store
from lmkit.io.landmark_map import map_to_yaml
from lmkit.mapping.bundle_adjustment import Anchor
from lmkit.mapping.joint_survey import JointSurvey
from lmkit.mapping.recording_group import LoneSurvey
from lmkit.mapping.several_recordings import NamedRecording, join_surveys, survey_alone
from lmkit.mapping.survey import anchors_of, landmark_sizes
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import LandmarkMap

STAGE = "survey"


@dataclass(frozen=True, eq=False)
class SiteSurvey:
    """Map of one site.

    Attributes:
        site: its name; empty where the fleet has one site.
        joint: map, moved landmarks, recordings that do not fit.
    """

    site: str
    joint: JointSurvey

    def to_dict(self) -> dict[str, Any]:
        """JSON of ``lmkit fleet survey`` (docs/formats.md): that of ``lmkit survey`` with several recordings."""
        return {"site": self.site, **self.joint.to_dict()}


@dataclass(frozen=True)
class PartSurvey:
    """Work of one job: survey a part alone.

    Attributes:
        store: that has its detections.
        size_m: side of the landmarks, meters; those that are known have their own.
        anchors: landmarks with known poses.
    """

    store: Store
    size_m: float
    anchors: Mapping[LandmarkId, Anchor]

    def __call__(self, part: Part) -> LoneSurvey | str:
        """Survey of the part, or why there is none."""
        try:
            recording, rig = read_detected(self.store, part)
        except InputError as error:
            return str(error)
        named = NamedRecording(part.name, recording.frames, rig, motion_of(recording))
        return survey_alone(named, landmark_sizes(recording.frames, self.size_m, self.anchors), self.anchors)


def parts_by_site(store: Store, options: Mapping[str, Any]) -> dict[str, list[Part]]:
    """Parts of the recordings that were detected with these options and saw a landmark, from early to late."""
    found: dict[str, list[tuple[float, list[Part]]]] = {}
    for recording, key, outcome in done_jobs(store, DETECT, options):
        if outcome.ok and outcome.facts["detections"]:
            parts = parts_of(recording, key, outcome)
            found.setdefault(recording.site, []).append((outcome.facts["from_s"], parts))
    return {
        site: [part for _, parts in sorted(some, key=lambda one: one[0]) for part in parts]
        for site, some in sorted(found.items())
    }


def survey_site(
    store: Store,
    site: str,
    parts: Sequence[Part],
    size_m: float,
    known: LandmarkMap | None = None,
    bumped: Mapping[str, str] | None = None,
    engine: str = "local",
) -> SiteSurvey:
    """Survey the parts of one site into one map: each alone on the engine, then all together here.

    Args:
        size_m: side of the landmarks, meters; landmarks in ``known`` have their own.
        known: landmarks with known poses, such as yesterday's map; it defines the map frame.
        bumped: why a recording's rig is no longer true, by the recording's name; those are left out while there are
            others.

    Raises:
        InputError: no recording can be surveyed, or the engine cannot be had.
    """
    anchors = {} if known is None else anchors_of(known)
    reasons = {p.name: bumped[p.recording] for p in parts if bumped and p.recording in bumped}
    left_out = reasons if len(reasons) < len(parts) else {}
    used = [part for part in parts if part.name not in left_out]
    answers = dict(run_jobs(PartSurvey(store, size_m, anchors), used, engine))
    joint = join_surveys({part.name: answers[part] or DIED for part in used}, anchors)
    return SiteSurvey(site, replace(joint, left_out={**left_out, **joint.left_out}))


def write_site(store: Store, surveyed: SiteSurvey) -> str:
    """Write the map and the facts of a site into the store; the map's text."""
    text = map_to_yaml(surveyed.joint.landmarks)
    store.write(f"{STAGE}/{surveyed.site or 'site'}.yaml", text)
    store.write_table(f"{STAGE}/{surveyed.site or 'site'}.parquet", {"site": [surveyed.site]}, surveyed.to_dict())
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
