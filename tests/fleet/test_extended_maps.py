"""A site's map that extends an earlier one keeps the recordings and moved landmarks of it."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("pyarrow")

from lmkit.errors import InputError
from lmkit.fleet.mapping import SiteSurvey, extended_surveys, share_joined, write_site
from lmkit.fleet.parts import Part
from lmkit.fleet.store import Store
from lmkit.model.landmark_map import LandmarkMap


def facts(day: int, code: int) -> dict:
    moved = {"id": f"lm8:{code}", "sentence": f"lm8:{code} was moved"}
    left_out = {f"day{day} at night": "dark"}
    return {"site": "hall", "recordings": [{"name": f"day{day}"}], "left_out": left_out, "moved": [moved]}


def part(day: int) -> Part:
    return Part(f"day{day}", "key", 1, 1)


def test_a_map_that_is_extended_daily_keeps_its_recordings_and_moved_landmarks(tmp_path: Path) -> None:
    store, empty = Store(str(tmp_path / "store")), LandmarkMap([])
    known = write_site(store, SiteSurvey("hall", empty, facts(1, 7))).encode()
    for day, code in ((2, 8), (3, 9)):
        earlier = extended_surveys(store, {"hall": [part(day)], "yard": [part(day)]}, known)
        assert list(earlier) == ["hall"]
        surveyed = SiteSurvey("hall", empty, facts(day, code)).extending(earlier["hall"])
        known = write_site(store, surveyed).encode()
    assert [moved["id"] for moved in surveyed.facts["moved"]] == ["lm8:7", "lm8:8", "lm8:9"]
    assert share_joined(surveyed.facts) == "3 of 4 recordings"
    for day in (1, 2, 3):
        with pytest.raises(InputError, match=f"made from 1 of these recordings, which would count twice: day{day}"):
            extended_surveys(store, {"hall": [part(day), part(4)]}, known)
    assert extended_surveys(store, {"hall": [part(1)]}, b"another map") == {}
