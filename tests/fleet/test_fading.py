"""Landmarks that are read worse than before: which are named, which are not, and how views are counted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("pyarrow")

from lmkit.fleet.fading import SiteReadings, readings_of
from lmkit.fleet.faults import find_faults
from lmkit.fleet.jobs import Outcome
from lmkit.fleet.recordings import FleetRecording
from lmkit.fleet.store import Store
from lmkit.fleet.views import Count, Views, read_views, write_views
from lmkit.model.pose_status import PoseStatus
from lmkit.model.tracked_trajectory import TrackedTrajectory
from lmkit.simulation.recording import T_BASE_LEFT, make_drive
from lmkit.simulation.scene import make_rig
from lmkit.simulation.site import day_name

RECORDINGS, FROM = 8, 4


def site(seed: int, share: float = 0.0, evidence: float = 0.0) -> list[dict]:
    """Counts of eight recordings of ten landmarks, of which the first falls from the fifth one on.

    Each recording has its own light and its own kinds of view, and some landmarks are always hidden.
    """
    rng = np.random.default_rng(seed)
    recordings = []
    for recording in range(RECORDINGS):
        counts, light = {}, rng.normal(0, 0.4)
        for number in range(10):
            own, falls = rng.normal(0, 0.05), number == 0 and recording >= FROM
            for size in rng.permutation(6)[:4].tolist():
                expected = int(rng.integers(3, 12))
                usual = 0.0 if size == 5 else 0.95
                read = int(rng.binomial(expected, max(usual - share * falls, 0.0)))
                level = -2.0 + 0.1 * size + light + own - evidence * falls
                counts[f"lm8:{number}", size, 0] = Count(expected, read, read * level, read)
        recordings.append(counts)
    return recordings


def faults(recordings: list[dict]) -> list:
    days = tuple(day_name(k) for k in range(RECORDINGS))
    return find_faults({}, [], [], [], {"hall": SiteReadings(days, days, tuple(readings_of(recordings)))})


@pytest.mark.parametrize(
    ("fall", "texts"),
    [
        ({"evidence": 0.5}, ["the margin of its readings is 6", "; clean it, or print it again"]),
        ({"share": 0.5}, ["images that should show it, 89 before", "see whether something hides it, clean it"]),
        ({"evidence": 0.5, "share": 0.5}, ["margin", "images that should show it"]),
    ],
)
def test_a_landmark_that_fades_is_named_with_its_day(fall, texts):
    [fault] = faults(site(1, **fall))
    assert (fault.kind, fault.site, fault.day, fault.until) == ("faded", "hall", day_name(FROM), day_name(7))
    assert fault.sentence.startswith(f"lm8:0 is read worse after {day_name(FROM - 1)}: ")
    assert all(text in fault.sentence for text in [*texts, "lmkit generate --family lm8 --code 0"])


def test_no_good_landmark_is_named():
    assert [faults(site(seed)) for seed in range(6)] == [[]] * 6


def test_one_bad_recording_or_a_small_fall_is_no_reason_to_act():
    recordings = site(2)
    for kind, count in recordings[3].items():
        if kind[0] == "lm8:0":
            recordings[3][kind] = replace(count, read=0, evidence=0.0, weighed=0)
    assert faults(recordings) == []
    assert faults(site(3, evidence=0.1, share=0.05)) == []


def test_views_are_counted_where_the_pose_has_them(tmp_path):
    rig = replace(make_rig(), T_base_left=T_BASE_LEFT)
    drive = make_drive(5, 6.0, count=8, rig=rig)
    lost = drive.frames[0].seen[0][0].id
    frames = [
        replace(frame, seen=tuple(tuple(d for d in some if d.id != lost) for some in frame.seen))
        for frame in drive.frames
    ]
    count = len(frames)
    tracked = TrackedTrajectory(
        drive.times_s, [drive.pose(k) for k in range(count)], np.tile(1e-6 * np.eye(6), (count, 1, 1)),
        [PoseStatus.OK] * count, [()] * count,
    )  # fmt: skip
    views = Views()
    views.add(frames, rig, drive.landmarks, tracked)
    write_views(Store(str(tmp_path)), "key", views)
    done = (FleetRecording("logs/a", "", "", "", 1, 0.0), "key", Outcome("a"))
    back = read_views(Store(str(tmp_path)), [done])["logs/a"]
    mine = {name: [c for (id_, _, _), c in back.items() if id_ == name] for name in {id_ for id_, _, _ in back}}
    assert sum(c.read for c in mine.pop(str(lost))) == 0
    read, expected = (sum(getattr(c, name) for some in mine.values() for c in some) for name in ("read", "expected"))
    # The simulation reads nothing that is smaller than 15 px, or seen too much from the side.
    assert expected > 20 and read > 0.7 * expected
    assert all(c.weighed == c.read for some in mine.values() for c in some)
