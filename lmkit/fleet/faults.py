"""Faults of a fleet that should be examined, with site, robot and day."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any

import numpy as np

from lmkit.fleet.fading import Reading, SiteReadings
from lmkit.fleet.jobs import Outcome
from lmkit.fleet.parts import recording_of
from lmkit.fleet.recordings import FleetRecording
from lmkit.fleet.rig_checks import UNKNOWN, bumped_sentence, moved_cameras
from lmkit.model.landmark_map import CALENDAR_S, day_of

Rows = Sequence[tuple[FleetRecording, str, Outcome]]
FAULT_SHARE = 0.8  # least share of located frames in a recording without a fault
CLOCK_S, CLOCK_SIGMA = 0.25, 5.0  # largest difference of odometry's delay from the fleet's: both must be exceeded
LEAST_CLOCKS = 3  # recordings that determine the fleet's usual delay
AHEAD_S = 3600.0  # a recording that ends this long after its files were written has a wrong clock
DELAY = "delay_s"


@dataclass(frozen=True)
class Fault:
    """One fault.

    Attributes:
        kind: ``failed``, ``rig``, ``clock``, ``moved``, ``faded``, ``left_out``, ``warning``, ``few_located`` or
            ``remark``.
        sentence: the problem, and what to do, without site, robot and day.
        day: first day of the fault, such as 2026-11-27; empty: no day.
        until: last day of the fault.
        recordings: names of the affected recordings.
    """

    kind: str
    sentence: str
    site: str = ""
    robot: str = ""
    day: str = ""
    until: str = ""
    recordings: tuple[str, ...] = ()

    def __str__(self) -> str:
        """The fault in one line, as `lmkit fleet report` lists it."""
        days = self.day if self.until in ("", self.day) else f"{self.day} to {self.until}"
        what = self.recordings[0] if len(self.recordings) == 1 else "/".join(p for p in (self.site, self.robot) if p)
        head = f"{what} ({days})" if what and days else what or days
        return f"{head}: {self.sentence}" if head else self.sentence

    def to_dict(self) -> dict[str, Any]:
        """JSON of ``lmkit fleet report``."""
        texts = {name: getattr(self, name) for name in ("kind", "site", "robot", "day", "until", "sentence")}
        return {**texts, "recordings": list(self.recordings)}


def find_faults(
    sites: Mapping[str, Mapping[str, Any]],
    detected: Rows,
    checked: Rows,
    tracked: Rows,
    readings: Mapping[str, SiteReadings],
) -> list[Fault]:
    """Every fault, the most urgent first.

    Args:
        sites: facts of each surveyed site.
        detected, checked, tracked: recordings, keys and outcomes of the stages.
        readings: reading quality of the landmarks of each site.
    """
    when = {r.source: (start_of(r, o), day_of(start_of(r, o))) for r, _, o in detected}
    clocks = [*_slow_clocks(tracked, when), *_clocks_ahead(detected, when)]
    rigs = _bumped_rigs(checked, when)
    explained = {name for fault in (*clocks, *rigs) for name in fault.recordings}
    failures = [
        Fault("failed", o.failure, r.site, r.robot, when[r.source][1], "", (r.name,))
        for rows in (detected, tracked)
        for r, _, o in rows
        if not o.ok and r.source in when
    ]
    landmarks = [*_of_sites(sites, rigs), *_faded(readings)]
    return [*rigs, *clocks, *failures, *landmarks, *_of_tracks(tracked, when, explained)]


def start_of(recording: FleetRecording, outcome: Outcome) -> float:
    """Start of a recording, seconds since 1970, by its own clock if this counts from 1970, else by its files."""
    start = outcome.facts.get("from_s")
    return float(start) if start is not None and start > CALENDAR_S else recording.modified_s


When = Mapping[str, tuple[float, str]]
Row = tuple[FleetRecording, str, Outcome]


def _runs(rows: Iterable[Row], when: When, is_off: Callable[[Row], bool]) -> list[tuple[str, list[Row]]]:
    """Consecutive faulty recordings of one robot, each run with the last good day before it."""
    runs = []
    ordered = sorted((row for row in rows if row[0].source in when), key=lambda row: when[row[0].source][0])
    for robot in sorted({r.robot for r, _, _ in ordered}):
        good = ""
        for off, some in groupby((row for row in ordered if row[0].robot == robot), key=is_off):
            run = list(some)
            if off:
                runs.append((good, run))
            else:
                good = when[run[-1][0].source][1]
    return runs


def _fault(kind: str, sentence: str, run: Sequence[Row], when: When) -> Fault:
    sites = {r.site for r, _, _ in run}
    days = [when[r.source][1] for r, _, _ in run]
    names = tuple(r.name for r, _, _ in run)
    return Fault(kind, sentence, sites.pop() if len(sites) == 1 else "", run[0][0].robot, days[0], days[-1], names)


def _bumped_rigs(checked: Rows, when: When) -> list[Fault]:
    """Rigs contradicted by landmarks, by robot, with the first day."""
    judged = [row for row in checked if any(c["state"] != UNKNOWN for c in row[2].facts.get("cameras", ()))]
    faults = []
    for good, run in _runs(judged, when, lambda row: bool(moved_cameras(row[2].facts))):
        surest = min(run, key=lambda row: min(max(c["turn_sigma_deg"]) for c in moved_cameras(row[2].facts)))
        before = f", valid until {good}" if good else ""
        sentence = f"{bumped_sentence(moved_cameras(surest[2].facts))} against its rig file{before}; recalibrate"
        faults.append(_fault("rig", sentence, run, when))
    return faults


def _slow_clocks(tracked: Rows, when: When) -> list[Fault]:
    """Robots whose delay between odometry and cameras differs from the fleet's."""
    judged = [row for row in tracked if DELAY in row[2].facts.get("parameters", {})]
    if len(judged) < LEAST_CLOCKS:
        return []
    usual = float(np.median([row[2].facts["parameters"][DELAY] for row in judged]))

    def off_s(row: Row) -> float:
        return float(row[2].facts["parameters"][DELAY]) - usual

    def is_off(row: Row) -> bool:
        sigma = float(row[2].facts.get("parameter_sigmas", {}).get(DELAY, 0.0))
        return abs(off_s(row)) > max(CLOCK_S, CLOCK_SIGMA * sigma)

    faults = []
    for good, run in _runs(judged, when, is_off):
        off = float(np.median([off_s(row) for row in run]))
        before = f", right until {good}" if good else ""
        sentence = (
            f"the clock of its odometry is {abs(off):.2f} s {'behind' if off > 0 else 'ahead of'} where the fleet's "
            f"usual delay of {usual:.2f} s has it{before}; synchronize its clocks"
        )
        faults.append(_fault("clock", sentence, run, when))
    return faults


def _clocks_ahead(detected: Rows, when: When) -> list[Fault]:
    """Robots whose recordings end after their files were written."""

    def ahead_s(row: Row) -> float:
        end = row[2].facts.get("to_s")
        return 0.0 if end is None or not row[0].modified_s else float(end) - row[0].modified_s

    faults = []
    for _, run in _runs(detected, when, lambda row: ahead_s(row) > AHEAD_S):
        hours = min(map(ahead_s, run)) / 3600
        sentence = f"its clock is at least {hours:.1f} h ahead of the time at which its files were written; set it"
        faults.append(_fault("clock", sentence, run, when))
    return faults


def _of_sites(sites: Mapping[str, Mapping[str, Any]], rigs: Sequence[Fault]) -> list[Fault]:
    """Moved landmarks, omitted recordings, and the survey's other warnings."""
    bumped = {name for fault in rigs for name in fault.recordings}
    faults = []
    for site, facts in sites.items():
        for moved in facts["moved"]:
            times = moved["valid_from_s"], moved["valid_to_s"]
            day = day_of(times[0]) if times[0] is not None and times[0] > CALENDAR_S else ""
            faults.append(Fault("moved", moved["sentence"], site, "", day))
        for name, reason in facts["left_out"].items():
            if recording_of(name) not in bumped:
                faults.append(Fault("left_out", f"left out of the map: {reason}", site, "", "", "", (name,)))
        faults += [Fault("warning", text, site) for text in facts["warnings"]]
    return faults


def _faded(sites: Mapping[str, SiteReadings]) -> list[Fault]:
    """Landmarks whose reading quality has decreased."""
    faults = []
    for site, seen in sites.items():
        for reading in seen.readings:
            falls = [step for step in reading.fallen if step is not None]
            if falls:
                first = min(step.first for step in falls)
                sentence = _faded_sentence(reading, seen.days[first - 1])
                names = seen.names[first:]
                faults.append(Fault("faded", sentence, site, "", seen.days[first], seen.days[-1], names))
    return faults


def _faded_sentence(reading: Reading, good_day: str) -> str:
    """One sentence: the decrease of a landmark's readings, and what to do."""
    share, evidence = reading.fallen
    texts = []
    if evidence is not None:
        left = np.exp(evidence.change)
        texts.append(
            f"the margin of its readings is {100 * left:.0f} ± {100 * left * evidence.sigma:.0f} % of what it was"
        )
    if share is not None:
        texts.append(
            f"it is read in {100 * max(share.before + share.change, 0.0):.0f} of 100 images that should show it, "
            f"{100 * share.before:.0f} before"
        )
    hidden = "see whether something hides it, " if evidence is None else ""
    anew = f"lmkit generate --family {reading.id.family} --code {reading.id.code}"
    advice = f"{hidden}clean it, or print it again in the same size ({anew})"
    return f"{reading.id} is read worse after {good_day}: {' and '.join(texts)}; {advice}"


def _of_tracks(tracked: Rows, when: When, explained: set[str]) -> list[Fault]:
    """Recordings that are poorly located, and remarks of tracking, if no other fault explains them."""
    faults = []
    for recording, _, outcome in tracked:
        if not outcome.ok or recording.name in explained or recording.source not in when:
            continue
        facts = outcome.facts
        place = recording.site, recording.robot, when[recording.source][1], "", (recording.name,)
        if facts["ok"] < FAULT_SHARE * facts["frames"]:
            faults.append(Fault("few_located", f"{facts['ok']} of {facts['frames']} frames located", *place))
        faults += [Fault("remark", remark, *place) for remark in facts["remarks"]]
    return faults
