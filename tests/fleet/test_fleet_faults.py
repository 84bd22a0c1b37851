"""Faults of a fleet by robot and day, from rows of its stages; rig files by date; rig checks by landmarks."""

from __future__ import annotations

import os
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("pyarrow")

from lmkit.fleet.faults import find_faults
from lmkit.fleet.jobs import Outcome
from lmkit.fleet.recordings import FleetRecording, find_recordings
from lmkit.fleet.rig_checks import VIEWS, pair_check
from lmkit.simulation.recording import T_BASE_LEFT, make_drive
from lmkit.simulation.scene import make_rig
from lmkit.simulation.site import DAY_S, MONDAY_S, day_name, turned

GONE_BY_S = MONDAY_S + 100 * DAY_S
STILL = {"turn_sigma_deg": [0.01] * 3, "shift_mm": [0.0] * 3, "shift_sigma_mm": [0.5] * 3}
TRUE = {"camera": "right", "state": "true", "turn_deg": [0.0, 0.0, 0.0], **STILL}
MOVED = {"camera": "right", "state": "moved", "turn_deg": [0.0, 0.4, 0.0], **STILL}
UNKNOWN = {"camera": "right", "state": "unknown", "sentence": ""}


def rows(robot: str, facts_by_day: list[dict], written_s: float = GONE_BY_S) -> list:
    return [
        (
            FleetRecording(f"logs/{robot}/{day}", "hall", robot, "", 1, written_s),
            "",
            Outcome(f"hall/{robot}/{day}", "", 1.0, facts),
        )
        for day, facts in enumerate(facts_by_day)
    ]


def detected(robot: str, days: int, written_s: float = GONE_BY_S) -> list:
    times = [MONDAY_S + DAY_S * day for day in range(days)]
    return rows(robot, [{"from_s": t, "to_s": t + 60.0} for t in times], written_s)


def tracked(robot: str, delays_s: list[float], sigma_s: float = 0.01) -> list:
    good = {"frames": 10, "ok": 10, "remarks": [], "parameter_sigmas": {"delay_s": sigma_s}}
    return rows(robot, [{**good, "parameters": {"delay_s": delay}} for delay in delays_s])


def test_a_bumped_camera_is_named_from_its_first_day_to_its_last():
    checks = [TRUE, UNKNOWN, MOVED, MOVED, TRUE, MOVED]
    checked = rows("a", [{"cameras": [check]} for check in checks]) + rows("b", [{"cameras": [TRUE]}] * 6)
    first, second = find_faults({}, [*detected("a", 6), *detected("b", 6)], checked, [], {})
    assert (first.kind, first.robot, first.day, first.until) == ("rig", "a", day_name(2), day_name(3))
    assert str(first).startswith(
        f"hall/a ({day_name(2)} to {day_name(3)}): camera right has yawed by +0.40 ± 0.01 deg"
    )
    assert f"valid until {day_name(0)}" in first.sentence
    assert (second.day, second.until) == (day_name(5), day_name(5))


def test_a_rig_file_that_is_hardly_off_is_no_bumped_camera():
    hardly = {**MOVED, "turn_deg": [0.0, 0.04, 0.0]}
    shifted = {**MOVED, "turn_deg": [0.0, 0.04, 0.0], "shift_mm": [0.0, 0.0, -4.0]}
    checked = rows("a", [{"cameras": [check]} for check in (hardly, shifted)])
    [fault] = find_faults({}, detected("a", 2), checked, [], {})
    assert fault.day == day_name(1) and "shifted along z by -4.0 ± 0.5 mm" in fault.sentence


def test_a_clock_unlike_the_fleets_is_named():
    usual = [*tracked("a", [0.24, 0.26, 0.25]), *tracked("b", [0.25, 0.22, 0.9])]
    [fault] = find_faults({}, [*detected("a", 3), *detected("b", 3)], [], usual, {})
    assert (fault.kind, fault.robot, fault.day) == ("clock", "b", day_name(2))
    assert "0.65 s behind" in fault.sentence and f"right until {day_name(1)}" in fault.sentence
    # An unknown delay is not a fault.
    vague = tracked("b", [0.25, 0.22, 0.9], sigma_s=0.2)
    assert find_faults({}, [*detected("a", 3), *detected("b", 3)], [], [*usual[:3], *vague], {}) == []


def test_a_robot_whose_clock_is_ahead_of_its_files_is_named():
    [fault] = find_faults({}, detected("a", 1, written_s=MONDAY_S - DAY_S), [], [], {})
    assert fault.kind == "clock" and "24.0 h ahead" in fault.sentence


def test_a_rig_file_by_date_holds_from_its_day_on(tmp_path):
    for day in ("2026-09-20", "2026-09-22", "20260924"):
        recording = tmp_path / "logs" / "robot" / day
        recording.mkdir(parents=True)
        (recording / "detections.csv").write_text("")
    rigs = tmp_path / "rigs" / "robot"
    rigs.mkdir(parents=True)
    for day in ("2026-09-21", "2026-09-24", "2026-09-30"):
        (rigs / f"{day}.yaml").write_text("")
    found = find_recordings(f"{tmp_path}/logs/{{robot}}/{{date}}", f"{tmp_path}/rigs/{{robot}}/{{date}}.yaml")
    names = {r.source[-10:]: r.rig.rpartition("/")[2] for r in found}
    # No rig file is valid on the first day; the missing file is named when it is read.
    assert names == {
        "2026-09-20": "2026-09-20.yaml", "2026-09-22": "2026-09-21.yaml", "t/20260924": "2026-09-24.yaml"
    }  # fmt: skip
    # Without a date in the path the day of the files counts.
    for file in tmp_path.glob("logs/*/*/detections.csv"):
        os.utime(file, (MONDAY_S + 20 * DAY_S,) * 2)
    for recording in find_recordings(f"{tmp_path}/logs/{{robot}}/*", f"{tmp_path}/rigs/{{robot}}/{{date}}.yaml"):
        assert recording.rig.endswith("2026-09-30.yaml")


@pytest.mark.parametrize("yaw_deg", [0.0, 0.3])
def test_landmarks_tell_whether_a_rig_file_is_true(yaw_deg):
    rig = replace(make_rig(), T_base_left=T_BASE_LEFT)
    drive = make_drive(7, 12.0, count=10, rig=turned(rig, np.array([0.0, yaw_deg, 0.0])))
    sizes = {m.id: m.size_m for m in drive.landmarks}
    [camera] = pair_check(rig, drive.frames, sizes, VIEWS // 2)
    assert camera["state"] == ("moved" if yaw_deg else "true")
    if yaw_deg:
        assert abs(camera["turn_deg"][1] - yaw_deg) < 5 * camera["turn_sigma_deg"][1]
