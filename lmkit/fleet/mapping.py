"""`lmkit fleet survey`: the landmark map of every site, from all of its recordings together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from lmkit.api.recordings import motion_of
from lmkit.fleet.detection import STAGE as DETECT
from lmkit.fleet.detection import Detected, read_detected
from lmkit.fleet.jobs import done_jobs
from lmkit.fleet.store import Store
from lmkit.io.landmark_map import map_to_yaml
from lmkit.mapping.joint_survey import JointSurvey
from lmkit.mapping.several_recordings import NamedRecording, survey_recordings
from lmkit.mapping.survey import anchors_of, landmark_sizes
from lmkit.mapping.wall_constraints import LandmarkConstraint
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


def detected_by_site(store: Store, options: Mapping[str, Any]) -> dict[str, list[Detected]]:
    """Recordings that were detected with these options and saw a landmark, by site, from early to late."""
    found: dict[str, list[tuple[float, Detected]]] = {}
    for recording, key, outcome in done_jobs(store, DETECT, options):
        if outcome.ok and outcome.facts["detections"]:
            detected = read_detected(store, recording.name, key)
            found.setdefault(recording.site, []).append((outcome.facts["from_s"], detected))
    return {site: [d for _, d in sorted(some, key=lambda one: one[0])] for site, some in sorted(found.items())}


def survey_site(
    site: str,
    detected: Sequence[Detected],
    size_m: float,
    known: LandmarkMap | None = None,
    constraints: Sequence[LandmarkConstraint] = (),
    bumped: Mapping[str, str] | None = None,
) -> SiteSurvey:
    """Survey the recordings of one site into one map.

    Args:
        size_m: side of the landmarks, meters; landmarks in ``known`` have their own.
        known: landmarks with known poses, such as yesterday's map; it defines the map frame.
        bumped: why a recording's rig is no longer true, by the recording's name; those are left out while there are
            others.

    Raises:
        InputError: no recording can be surveyed.
    """
    anchors = {} if known is None else anchors_of(known)
    reasons = {d.name: bumped[d.name] for d in detected if bumped and d.name in bumped}
    left_out = reasons if len(reasons) < len(detected) else {}
    used = [d for d in detected if d.name not in left_out]
    frames = [frame for one in used for frame in one.recording.frames]
    named = [NamedRecording(d.name, d.recording.frames, d.rig, motion_of(d.recording)) for d in used]
    joint = survey_recordings(named, landmark_sizes(frames, size_m, anchors), anchors, constraints, True)
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
