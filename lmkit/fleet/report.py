"""`lmkit fleet report`: one HTML page of a site's recordings, robots, landmarks and faults."""

from __future__ import annotations

import base64
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from html import escape
from typing import Any

import numpy as np

from lmkit.fleet.detection import STAGE as DETECT
from lmkit.fleet.fading import Reading, SiteReadings, Step, readings_of
from lmkit.fleet.faults import DELAY, Fault, Rows, find_faults, start_of
from lmkit.fleet.jobs import done_jobs
from lmkit.fleet.mapping import share_joined, stored_map, stored_sites
from lmkit.fleet.recordings import stored_recordings
from lmkit.fleet.rig_checks import STAGE as CHECK
from lmkit.fleet.rig_checks import UNKNOWN, moved_cameras, stored_check_options
from lmkit.fleet.store import Store
from lmkit.fleet.tracking import STAGE as TRACK
from lmkit.fleet.tracking import map_of
from lmkit.fleet.views import read_views
from lmkit.model.landmark_map import day_of
from lmkit.visualization import html
from lmkit.visualization.plan_view import PHONE_SIZE, draw_plan

MOST_LANDMARKS = 30  # rows


@dataclass(frozen=True, eq=False)
class FleetState:
    """All results in a store that belong to the same options.

    Attributes:
        recordings: number of all recordings, detected or not.
        sites: facts of each surveyed site.
        detected, checked, tracked: recordings, keys and outcomes of the stages.
        readings: reading quality of the landmarks of each site.
    """

    recordings: int
    sites: Mapping[str, Mapping[str, Any]]
    detected: Rows
    checked: Rows
    tracked: Rows
    readings: Mapping[str, SiteReadings]

    def faults(self) -> list[Fault]:
        """All faults that should be examined."""
        return find_faults(self.sites, self.detected, self.checked, self.tracked, self.readings)


def fleet_state(store: Store, detect: Mapping[str, Any], track: Mapping[str, Any] | None) -> FleetState:
    """The store's results.

    Args:
        detect, track: options of the stages; None if nothing was tracked.
    """
    check = stored_check_options(store)
    detected = done_jobs(store, DETECT, detect)
    tracked = [] if track is None else done_jobs(store, TRACK, track)
    return FleetState(
        len(stored_recordings(store)),
        stored_sites(store),
        detected,
        [] if check is None else done_jobs(store, CHECK, check),
        tracked,
        _site_readings(store, detected, tracked),
    )


def _site_readings(store: Store, detected: Rows, tracked: Rows) -> dict[str, SiteReadings]:
    """Reading quality of the landmarks of each site in its tracked recordings."""
    views = read_views(store, tracked)
    start_s = {recording.source: start_of(recording, outcome) for recording, _, outcome in detected}
    known = sorted(views.keys() & start_s.keys(), key=lambda source: start_s[source])
    names = {recording.source: (recording.site, recording.name) for recording, _, _ in tracked}
    found = {}
    for site in sorted({names[source][0] for source in known}):
        mine = [source for source in known if names[source][0] == site]
        days = tuple(day_of(start_s[source]) for source in mine)
        readings = readings_of([views[source] for source in mine])
        found[site] = SiteReadings(tuple(names[source][1] for source in mine), days, tuple(readings))
    return found


def fleet_report(store: Store, state: FleetState) -> str:
    """The page."""
    sites, detected, tracked, faults = state.sites, state.detected, state.tracked, state.faults()
    parts = [
        html.headline(
            "good" if not faults else "fair",
            f"{len(faults)} thing{'s' * (len(faults) > 1)} to do" if faults else "Nothing to do",
            f"{state.recordings} recordings, {sum(o.ok for _, _, o in detected)} detected, "
            f"{sum(o.ok for _, _, o in tracked)} tracked, {len(sites)} site{'s' * (len(sites) != 1)} with a map.",
        ),
        html.listed("What to do this week", [str(fault) for fault in faults]),
    ]
    figures = [_map_figure(store, site, facts) for site, facts in sites.items()]
    parts += ["<h2>Maps</h2>", html.grid(figures, "two")] if figures else []
    parts += ["<h2>Robots</h2>", _robots(state), "<h2>Days</h2>", _days(state)]
    parts += ["<h2>Landmarks</h2>", _landmarks(state.readings)] if state.readings else []
    parts += ["<h2>Recordings</h2>", _recordings(detected, tracked)]
    return html.page("Fleet report", parts)


def _map_figure(store: Store, site: str, facts: Mapping[str, Any]) -> tuple[str, str]:
    """Drawing of a site's map, and its caption."""
    landmarks = map_of(stored_map(store, site))
    drawing = base64.b64encode(draw_plan(landmarks, (), title=site, kind="svg", size=PHONE_SIZE)).decode()
    image = f"<img alt='map of {escape(site or 'the site')}' src='data:image/svg+xml;base64,{drawing}'>"
    return image, f"{len(facts['landmarks'])} landmarks from {share_joined(facts)}, {len(facts['moved'])} moved"


def _robots(state: FleetState) -> str:
    checks = {r.source: o for r, _, o in state.checked if o.ok}
    tracks = {r.source: o for r, _, o in state.tracked if o.ok}
    rows = []
    for name in sorted({r.robot for r, _, _ in state.detected}):
        mine = [(r, o) for r, _, o in state.detected if r.robot == name]
        ran = [tracks[r.source].facts for r, _ in mine if r.source in tracks]
        frames, ok = sum(f["frames"] for f in ran), sum(f["ok"] for f in ran)
        share = f"{100 * ok / frames:.1f} %" if frames else "-"
        looked = [checks[r.source].facts for r, _ in mine if r.source in checks]
        judged = [f for f in looked if any(c["state"] != UNKNOWN for c in f["cameras"])]
        true = f"{sum(not moved_cameras(f) for f in judged)} of {len(judged)}" if judged else "-"
        delays = [f["parameters"][DELAY] for f in ran if DELAY in f["parameters"]]
        delay = f"{float(np.median(delays)):z.2f}" if delays else "-"
        failed = sum(not o.ok for _, o in mine)
        rows.append((name or "-", str(len(mine)), str(failed), str(frames), share, true, delay))
    head = ("robot", "recordings", "failed", "frames tracked", "located", "rig valid", "odometry delay s")
    return html.table(head, rows)


def _days(state: FleetState) -> str:
    """Share of located driving by day, which decreases if landmarks fade or are covered."""
    tracks = {r.source: o.facts for r, _, o in state.tracked if o.ok}
    days: dict[str, list[str]] = {}
    for recording, _, outcome in state.detected:
        days.setdefault(day_of(start_of(recording, outcome)), []).append(recording.source)
    rows = []
    for day, sources in sorted(days.items()):
        ran = [tracks[source] for source in sources if source in tracks]
        frames, ok = sum(f["frames"] for f in ran), sum(f["ok"] for f in ran)
        rows.append(
            (
                day.replace("-", "\u2011"),
                str(len(sources)),
                str(frames),
                f"{100 * ok / frames:.1f} %" if frames else "-",
            )
        )
    return html.table(("day", "recordings", "frames tracked", "located"), rows)


def _landmarks(sites: Mapping[str, SiteReadings]) -> str:
    """Reading quality of landmarks, the most significant decrease first."""
    rows = [(_sureness(r), site, r) for site, seen in sites.items() for r in seen.readings]
    rows.sort(key=lambda row: row[0])
    cells = [
        (
            " ".join((site, str(r.id))).strip(),
            str(r.expected),
            f"{100 * r.read / r.expected:.0f} %",
            _change(r.share, lambda change: 100 * change, ""),
            _change(r.evidence, lambda change: 100 * float(np.expm1(change)), " %"),
        )
        for _, site, r in rows[:MOST_LANDMARKS]
    ]
    more = f"<p class='note'>The first {MOST_LANDMARKS} of {len(rows)}.</p>" if len(rows) > MOST_LANDMARKS else ""
    note = (
        "<p class='note'>Expected: images in which the landmark should be visible from the robot's pose. Read: the "
        "share of them in which it was read. Changes: the most significant drops over time with their standard "
        "deviations, of the share in percentage points, of the decoding margin relative to similar views before.</p>"
    )
    head = ("landmark", "expected", "read", "change of share", "change of margin")
    return note + html.table(head, cells) + more


def _sureness(reading: Reading) -> float:
    return min((step.change / step.sigma for step in (reading.share, reading.evidence) if step), default=0.0)


def _change(step: Step | None, percent: Callable[[float], float], unit: str) -> str:
    """A decrease and its standard deviation; a dash without a decrease."""
    if step is None or step.change >= 0:
        return "-"
    return f"{percent(step.change):z.0f} ± {percent(step.sigma):.0f}{unit}"


def _recordings(detected: Rows, tracked: Rows) -> str:
    tracks = {r.source: o for r, _, o in tracked}
    rows = []
    for recording, _, outcome in detected:
        facts, ran = outcome.facts, tracks.get(recording.source)
        located = f"{ran.facts['ok']} of {ran.facts['frames']}" if ran is not None and ran.ok else "-"
        numbers = [str(facts.get(name, "-")) for name in ("frames", "detections", "landmarks")]
        rows.append(
            (recording.name, day_of(start_of(recording, outcome)), *numbers, located, f"{outcome.seconds:.1f}")
        )
    return html.table(("recording", "day", "frames", "detections", "landmarks", "located", "seconds"), rows)
