"""`lmkit fleet report`: one HTML page of a site's recordings, robots, landmarks and faults."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from html import escape
from typing import Any

from lmkit.fleet.detection import STAGE as DETECT
from lmkit.fleet.jobs import Outcome, done_jobs
from lmkit.fleet.mapping import stored_map, stored_sites
from lmkit.fleet.recordings import FleetRecording, stored_recordings
from lmkit.fleet.store import Store
from lmkit.fleet.tracking import STAGE as TRACK
from lmkit.fleet.tracking import map_of
from lmkit.model.landmark_map import CALENDAR_S
from lmkit.visualization import html
from lmkit.visualization.plan_view import draw_plan

Rows = Sequence[tuple[FleetRecording, str, Outcome]]
FAULT_SHARE = 0.8  # of frames that are located in a recording without trouble


def fleet_report(store: Store, detect: Mapping[str, Any], track: Mapping[str, Any] | None) -> str:
    """The page.

    Args:
        detect, track: options of the stages whose results are shown; None: nothing was tracked.
    """
    detected = done_jobs(store, DETECT, detect)
    tracked = [] if track is None else done_jobs(store, TRACK, track)
    sites = stored_sites(store)
    total = len(stored_recordings(store))
    todo = things_to_do(sites, detected, tracked)
    parts = [
        html.headline(
            "good" if not todo else "fair",
            f"{len(todo)} thing{'s' * (len(todo) > 1)} to do" if todo else "Nothing to do",
            f"{total} recordings, {sum(o.ok for _, _, o in detected)} detected, "
            f"{sum(o.ok for _, _, o in tracked)} tracked, {len(sites)} sites with a map.",
        ),
        html.listed("To do", todo),
    ]
    figures = [_map_figure(store, site, facts) for site, facts in sites.items()]
    parts += ["<h2>Maps</h2>", html.grid(figures, "two")] if figures else []
    parts += ["<h2>Robots</h2>", _robots(detected, tracked), "<h2>Recordings</h2>", _recordings(detected, tracked)]
    return html.page("lmkit fleet", parts)


def _map_figure(store: Store, site: str, facts: Mapping[str, Any]) -> tuple[str, str]:
    """Drawing of a site's map, and its caption."""
    landmarks = map_of(stored_map(store, site))
    drawing = base64.b64encode(draw_plan(landmarks, (), title=site, kind="svg")).decode()
    image = f"<img alt='map of {escape(site or 'the site')}' src='data:image/svg+xml;base64,{drawing}'>"
    joined = f"{facts['joined']} of {facts['recordings']} recordings"
    return image, f"{facts['landmarks']} landmarks from {joined}, {len(facts['moved'])} moved"


def things_to_do(sites: Mapping[str, Mapping[str, Any]], detected: Rows, tracked: Rows) -> list[str]:
    """One sentence per fault that a person should look at."""
    texts = []
    for site, facts in sites.items():
        where = f"{site}: " if site else ""
        texts += [f"{where}{text}" for text in facts["moved"]]
        texts += [f"{where}{name} is left out of the map: {reason}" for name, reason in facts["left_out"].items()]
        texts += [f"{where}{text}" for text in facts["warnings"]]
    texts += [f"{r.name} ({day_of(r, o)}): {o.failure}" for r, _, o in detected if not o.ok]
    days = {r.source: day_of(r, o) for r, _, o in detected}
    for recording, _, outcome in tracked:
        if not outcome.ok:
            texts.append(f"{recording.name} ({days[recording.source]}): {outcome.failure}")
            continue
        facts = outcome.facts
        if facts["ok"] < FAULT_SHARE * facts["frames"]:
            texts.append(
                f"{recording.name} ({days[recording.source]}): {facts['ok']} of {facts['frames']} frames located"
            )
        texts += [f"{recording.name} ({days[recording.source]}): {remark}" for remark in facts["remarks"]]
    return texts


def day_of(recording: FleetRecording, outcome: Outcome) -> str:
    """Day of a recording by its own clock where that counts from 1970, else by its files."""
    start = outcome.facts.get("from_s")
    time_s = start if start is not None and start > CALENDAR_S else recording.modified_s
    return datetime.fromtimestamp(time_s, UTC).strftime("%Y-%m-%d")


def _robots(detected: Rows, tracked: Rows) -> str:
    names = sorted({r.robot for r, _, _ in detected})
    rows = []
    for name in names:
        mine = [o for r, _, o in detected if r.robot == name]
        ran = [o.facts for r, _, o in tracked if r.robot == name and o.ok]
        frames, ok = sum(f["frames"] for f in ran), sum(f["ok"] for f in ran)
        share = f"{100 * ok / frames:.1f} %" if frames else "-"
        rows.append((name or "-", str(len(mine)), str(sum(not o.ok for o in mine)), str(frames), share))
    return html.table(("robot", "recordings", "failed", "frames tracked", "located"), rows)


def _recordings(detected: Rows, tracked: Rows) -> str:
    tracks = {r.source: o for r, _, o in tracked}
    rows = []
    for recording, _, outcome in detected:
        facts, ran = outcome.facts, tracks.get(recording.source)
        located = f"{ran.facts['ok']} of {ran.facts['frames']}" if ran is not None and ran.ok else "-"
        numbers = [str(facts.get(name, "-")) for name in ("frames", "detections", "landmarks")]
        rows.append((recording.name, day_of(recording, outcome), *numbers, located, f"{outcome.seconds:.1f}"))
    return html.table(("recording", "day", "frames", "detections", "landmarks", "located", "seconds"), rows)
