"""A fleet from scan to report, here and on a Dask cluster on loopback."""

from __future__ import annotations

import json
import os
import pickle
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bag_files import write_bag

pytest.importorskip("pyarrow")

from lmkit.errors import InputError
from lmkit.fleet import parts
from lmkit.fleet.detection import STAGE, detect_recording, parts_of, read_detected
from lmkit.fleet.engines import run_jobs, share_of
from lmkit.fleet.jobs import done_jobs, run_stage
from lmkit.fleet.mapping import parts_by_site, survey_site
from lmkit.fleet.recordings import add_recordings, find_recordings, stored_recordings
from lmkit.fleet.store import Store
from lmkit.fleet.tracking import track_recording
from lmkit.io.external_maps import read_any_map
from lmkit.io.landmark_map import map_to_yaml
from lmkit.io.rig import rig_to_yaml
from lmkit.model.landmark_id import LandmarkId
from lmkit.simulation.recording import T_BASE_LEFT
from lmkit.simulation.scene import make_rig
from lmkit.simulation.site import Planted, Site, day_name, write_site

OPTIONS = {"families": ["lm8"], "hz": None}


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("small")
    write_site(folder, halls=1, days=2, seconds=15.0)
    return folder


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Site]:
    folder = tmp_path_factory.mktemp("site")
    # robot1's camera is bumped on the second day, and its rig is calibrated again on the third.
    planted = Planted(bumped=(1, 1), recalibrated=2, clock=(0, 1))
    site = write_site(folder, halls=2, days=3, planted=planted)
    damaged = folder / "logs" / "hall0" / "robot1" / "damaged"
    damaged.mkdir()
    (damaged / "detections.csv").write_text("time_s,camera,code\n1,left,7\n")
    return folder, site


def answers(lmkit, *arguments: str) -> list[dict]:
    answer = lmkit("fleet", *arguments, "--json")
    assert answer.code == 0, answer.err
    return [json.loads(line) for line in answer.out.splitlines()]


@pytest.mark.slow
def test_from_scan_to_report(lmkit, small, tmp_path):
    pattern = f"{small}/logs/{{site}}/{{robot}}/{{date}}"
    stated = answers(lmkit, "scan", pattern, "--rig", f"{small}/rigs/{{robot}}/{{date}}.yaml", "--store", "store")
    assert stated == [{"found": 2, "changed": 2, "recordings": 2}]
    assert [row["failure"] for row in answers(lmkit, "detect", "--store", "store", "--jobs", "1")] == [None, None]
    # What is done is not done again.
    assert answers(lmkit, "detect", "--store", "store") == []
    [row] = answers(lmkit, "survey", "--store", "store", "-o", "map.yaml", "--jobs", "1")
    assert row["map"] == "map.yaml" and len(row["recordings"]) == 2
    assert len(read_any_map(tmp_path / "map.yaml")) == len(row["landmarks"]) > 5
    again = ("fleet", "survey", "--store", "store", "-o", "new.yaml", "--known", "map.yaml", "--jobs", "1")
    assert "from 2 of these recordings" in lmkit(*again).err
    assert "no recording from 2030-01-01 on" in lmkit(*again, "--since", "2030-01-01").err
    assert "--since 'today' is not a day" in lmkit(*again, "--since", "today").err
    tracked = answers(lmkit, "track", "--store", "store", "--jobs", "1")
    assert min(row["ok"] / row["frames"] for row in tracked) > 0.9
    [report] = answers(lmkit, "report", "--store", "store", "-o", "fleet.html")
    assert [fault["kind"] for fault in report["faults"]] == ["moved"]
    assert f"hall0/robot0/{day_name(0)}" in (tmp_path / "fleet.html").read_text()


@pytest.mark.slow
def test_planted_faults_are_found(lmkit, written, tmp_path):
    folder, site = written
    pattern = f"{folder}/logs/{{site}}/{{robot}}/{{date}}"
    stated = answers(lmkit, "scan", pattern, "--rig", f"{folder}/rigs/{{robot}}/{{date}}.yaml", "--store", "store")
    assert stated == [{"found": 7, "changed": 7, "recordings": 7}]
    detected = answers(lmkit, "detect", "--store", "store", "--jobs", "1")
    assert sum(row["failure"] is None for row in detected) == 6
    failure = next(row["failure"] for row in detected if row["failure"])
    assert "detections.csv" in failure and "columns" in failure
    # What is done is not done again.
    assert answers(lmkit, "detect", "--store", "store") == []
    surveyed = {
        row["site"]: row for row in answers(lmkit, "survey", "--store", "store", "-o", "map.yaml", "--jobs", "1")
    }
    assert set(surveyed) == {"hall0", "hall1"}
    for name, row in surveyed.items():
        # The recording of the bumped camera is left out of its hall's map.
        assert len(row["recordings"]) == (2 if name == "hall0" else 3), row
        [moved] = row["moved"]
        assert moved["id"] == str(site.moved[name].id) and abs(moved["metres"] - 0.4) < 0.02
        last = day_name(0) if name == "hall0" else day_name(1)
        assert moved["sentence"].endswith(f"(last seen there {last}, seen elsewhere from {day_name(2)})")
        assert site.map_error_m(name, read_any_map(tmp_path / row["map"])) < 0.02
    tracked = answers(lmkit, "track", "--store", "store", "--jobs", "1")
    # The damaged one is not tracked.
    assert [row["failure"] for row in tracked] == [None] * 6
    [report] = answers(lmkit, "report", "--store", "store", "-o", "fleet.html")
    faults = {
        kind: [f for f in report["faults"] if f["kind"] == kind] for kind in {f["kind"] for f in report["faults"]}
    }
    assert set(faults) == {"failed", "rig", "clock", "moved"}, report["faults"]
    [rig], [clock], [failed] = faults["rig"], faults["clock"], faults["failed"]
    assert (rig["robot"], rig["day"], rig["until"]) == ("robot1", day_name(1), day_name(1))
    assert "yawed by +0." in rig["sentence"] and f"valid until {day_name(0)}" in rig["sentence"]
    assert (clock["robot"], clock["day"], clock["until"]) == ("robot0", day_name(1), day_name(2))
    assert f"right until {day_name(0)}" in clock["sentence"]
    assert failed["recordings"] == ["hall0/robot1/damaged"]
    assert [f["day"] for f in faults["moved"]] == [day_name(2)] * 2
    page = (tmp_path / "fleet.html").read_text()
    assert str(site.moved["hall0"].id) in page
    assert "damaged" in page and f"hall0/robot1/{day_name(1)} ({day_name(1)})" in page


def test_stored_detections_read_back_exactly(small, tmp_path):
    from lmkit.io.any_rig import read_any_rig
    from lmkit.pipelines.detect_recording import open_recording

    folder = small
    store = Store(str(tmp_path / "store"))
    add_recordings(
        store,
        find_recordings(f"{folder}/logs/hall0/{{robot}}/{day_name(0)}", f"{folder}/rigs/{{robot}}/{{date}}.yaml"),
    )
    list(run_stage(store, STAGE, detect_recording, OPTIONS))
    [(recording, key, outcome)] = done_jobs(store, STAGE, OPTIONS)
    [part] = parts_of(recording, key, outcome)
    back, _ = read_detected(store, part)
    source = Path(recording.source)
    first = open_recording(
        rig=read_any_rig(Path(recording.rig)), detections=source / "detections.csv",
        odometry=source / "odometry.csv", gyro=source / "gyro.csv",
    ).read()  # fmt: skip
    assert outcome.facts["frames"] == len(first.frames) == len(back.frames)
    for a, b in zip(first.frames, back.frames, strict=True):
        assert a.time_s == b.time_s
        assert [d.id for d in a.detections] == [d.id for d in b.detections]
        assert all(np.array_equal(x.corners, y.corners) for x, y in zip(a.detections, b.detections, strict=True))
    kept = np.isin(first.odometry.times_s, back.odometry.times_s)
    assert np.array_equal(first.odometry.turn_rad[kept], back.odometry.turn_rad)
    assert np.array_equal(first.gyro.rate_radps[np.isin(first.gyro.times_s, back.gyro.times_s)], back.gyro.rate_radps)
    assert np.ptp(back.odometry.times_s) > np.ptp(first.times_s) - 0.1


def test_a_long_recording_is_stored_and_located_in_parts(small, tmp_path, monkeypatch):
    monkeypatch.setattr(parts, "FRAMES", 25)
    folder = small
    store = Store(str(tmp_path / "store"))
    add_recordings(
        store,
        find_recordings(f"{folder}/logs/{{site}}/{{robot}}/{day_name(0)}", f"{folder}/rigs/{{robot}}/{{date}}.yaml"),
    )
    monkeypatch.setenv("LMKIT_JOBS", "1")
    [detected] = run_stage(store, STAGE, detect_recording, OPTIONS)
    assert detected.facts["parts"] == 3 and detected.facts["frames"] > 65
    [(site, some)] = parts_by_site(store, OPTIONS).items()
    assert [part.name for part in some] == [f"{detected.recording}, part {k} of 3" for k in (1, 2, 3)]
    times = [read_detected(store, part)[0].times_s for part in some]
    assert np.all(np.diff(np.concatenate(times)) > 0) and sum(map(len, times)) == detected.facts["frames"]
    surveyed = survey_site(store, site, some, 0.18)
    assert len(surveyed.facts["recordings"]) == 3 and not surveyed.facts["left_out"]
    options = {"maps": {site: map_to_yaml(surveyed.landmarks)}, "detect": OPTIONS}
    [tracked] = run_stage(store, "track", track_recording, options)
    assert tracked.facts["frames"] == detected.facts["frames"]
    assert tracked.facts["ok"] > 0.9 * tracked.facts["frames"]


def test_the_last_part_is_not_a_stub():
    for count, lengths in (
        (0, []),
        (3, [3]),
        (10, [10]),
        (14, [14]),
        (15, [10, 5]),
        (24, [10, 14]),
        (27, [10, 10, 7]),
    ):
        assert [len(part) for part in parts.split_frames(iter([None] * count), 10)] == lengths


def test_workers_open_the_folder_that_the_client_means(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    sent = pickle.dumps(Store("store"))
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    pickle.loads(sent).write("a.txt", "one")
    assert (tmp_path / "store" / "a.txt").read_text() == "one"


def test_another_option_or_file_is_another_result(small, tmp_path):
    folder = small
    found = find_recordings(f"{folder}/logs/*/{{robot}}/2*")
    keys = {r.key(STAGE, OPTIONS) for r in found} | {r.key(STAGE, {**OPTIONS, "hz": 5.0}) for r in found}
    assert len(keys) == 2 * len(found) == 4
    assert {r.key(STAGE, {**OPTIONS, "max_bytes": 10**6}) for r in found} < keys


def test_another_map_concerns_its_own_site_alone(small):
    [recording] = find_recordings(f"{small}/logs/{{site}}/{{robot}}/{day_name(0)}")
    keys = [
        recording.key("track", {"maps": {"hall0": own, "hall1": other}, "detect": OPTIONS})
        for own, other in (("a", "b"), ("a", "c"), ("d", "b"))
    ]
    assert keys[0] == keys[1] != keys[2]


def test_rigs_are_found_from_any_working_folder(small, monkeypatch):
    monkeypatch.chdir(small)
    [recording] = find_recordings(f"logs/{{site}}/{{robot}}/{day_name(0)}", "rigs/{robot}/{date}.yaml")
    assert recording.rig == f"{small}/rigs/robot0/{day_name(0)}.yaml"
    assert find_recordings("logs/*/*/2*")[0].rig == ""


@pytest.mark.parametrize(
    ("pattern", "rig", "word"),
    [("logs/{hall}/*", "", "hall"), ("logs/*", "rigs/{robot}.yaml", "robot"), ("nothing/*", "", "no recording")],
)
def test_wrong_patterns_are_named(pattern, rig, word):
    with pytest.raises(InputError, match=word):
        find_recordings(pattern, rig)


def test_shards_share_all_jobs():
    jobs = list(range(11))
    assert sorted(j for k in range(1, 5) for j in share_of(jobs, f"{k}/4")) == jobs
    for text in ("0/4", "5/4", "x", "1/0", "-1/4"):
        with pytest.raises(InputError, match="shard"):
            share_of(jobs, text)


def square(number: int) -> int:
    if number == 3 and os.environ.get("LMKIT_TEST_PARENT") != str(os.getpid()):
        os.kill(os.getpid(), signal.SIGKILL)
    return number**2


@pytest.mark.slow
def test_a_job_that_kills_its_worker_takes_no_other_with_it(monkeypatch):
    monkeypatch.setattr("lmkit.parallel._limit", None)  # an earlier command's --jobs
    monkeypatch.setenv("LMKIT_TEST_PARENT", str(os.getpid()))
    monkeypatch.setenv("LMKIT_JOBS", "2")
    assert dict(run_jobs(square, range(6))) == {0: 0, 1: 1, 2: 4, 3: None, 4: 16, 5: 25}


@pytest.fixture
def cluster() -> Iterator[tuple[str, list[subprocess.Popen]]]:
    pytest.importorskip("distributed")
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    command = [sys.executable, "-m", "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0",
               "--no-dashboard", "--scheduler-file"]  # fmt: skip
    import tempfile

    with tempfile.TemporaryDirectory() as scratch:
        stated = Path(scratch) / "scheduler.json"
        processes = [subprocess.Popen([*command, str(stated)], env=environment)]
        deadline = time.monotonic() + 60
        while not stated.exists() and time.monotonic() < deadline:
            time.sleep(0.1)
        address = json.loads(stated.read_text())["address"]
        worker = [sys.executable, "-m", "distributed.cli.dask_worker", address, "--nthreads", "1", "--no-dashboard",
                  "--no-nanny"]  # fmt: skip
        processes += [subprocess.Popen(worker, env=environment) for _ in range(2)]
        yield address, processes
        for process in processes[::-1]:
            process.kill()
            process.wait()


@pytest.mark.slow
def test_a_cluster_gives_the_same_map_though_a_worker_dies(lmkit, small, tmp_path, cluster):
    address, processes = cluster
    scanned = (f"{small}/logs/{{site}}/{{robot}}/{{date}}", "--rig", f"{small}/rigs/{{robot}}/{{date}}.yaml")
    maps = []
    for store, engine in (("here", "local"), ("there", f"dask:{address}")):
        answers(lmkit, "scan", *scanned, "--store", store)
        if store == "there":
            processes[1].kill()
        assert len(answers(lmkit, "detect", "--store", store, "--engine", engine, "--jobs", "1")) == 2
        rows = answers(lmkit, "survey", "--store", store, "-o", f"{store}.yaml", "--engine", engine, "--jobs", "1")
        maps.append([read_any_map(tmp_path / row["map"]) for row in rows])
    for a, b in zip(*maps, strict=True):
        assert [m.id for m in a] == [m.id for m in b]
        for x, y in zip(a, b, strict=True):
            assert np.abs(x.T_map_landmark.matrix - y.T_map_landmark.matrix).max() < 1e-9


def test_the_table_keeps_what_is_known(small, tmp_path):
    folder = small
    store = Store(str(tmp_path / "store"))
    assert add_recordings(store, find_recordings(f"{folder}/logs/{{site}}/{{robot}}/{day_name(0)}")) == (1, 1)
    assert add_recordings(store, find_recordings(f"{folder}/logs/{{site}}/{{robot}}/2*")) == (1, 2)
    assert {r.site for r in stored_recordings(store)} == {"hall0"}


def test_wheels_are_read_with_the_track_that_was_scanned(tmp_path, monkeypatch):
    folder = tmp_path / "logs" / "a" / "1"
    folder.mkdir(parents=True)
    (folder / "readings.csv").write_text("time_s,code,range_m,bearing_rad\n1.0,3,2.0,0.1\n1.5,3,2.0,0.1\n")
    (folder / "odometry.csv").write_text("time_s,left_m,right_m\n1.0,0.1,0.1\n1.5,0.1,0.3\n")
    monkeypatch.setenv("LMKIT_JOBS", "1")
    store = Store(str(tmp_path / "store"))
    pattern = f"{tmp_path}/logs/{{robot}}/*"
    add_recordings(store, find_recordings(pattern))
    [failed] = run_stage(store, STAGE, detect_recording, OPTIONS)
    assert "lmkit fleet scan: --wheel-track 0.4m" in failed.failure
    again = run_stage(store, STAGE, detect_recording, OPTIONS)
    assert (list(again), again.failed_before) == ([], 1)
    assert len(run_stage(store, STAGE, detect_recording, OPTIONS, retry=True).jobs) == 1
    assert add_recordings(store, find_recordings(pattern, wheel_track_m=0.4)) == (1, 1)
    [detected] = run_stage(store, STAGE, detect_recording, OPTIONS)
    [(_, key, _)] = done_jobs(store, STAGE, OPTIONS)
    [part] = parts_of(stored_recordings(store)[0], key, detected)
    odometry = read_detected(store, part)[0].odometry
    assert odometry.turn_rad.tolist() == pytest.approx([0.0, 0.5]) and odometry.forward_m[1] == pytest.approx(0.2)


def test_topics_that_are_scanned_are_those_of_the_bag(tmp_path, monkeypatch):
    pytest.importorskip("rosbags")
    rig = replace(make_rig(image_size=(64, 48)), T_base_left=T_BASE_LEFT)
    write_bag(tmp_path / "logs" / "bag", rig, cameras=("port", "starboard"))
    (tmp_path / "rig.yaml").write_text(rig_to_yaml(rig))
    monkeypatch.setenv("LMKIT_JOBS", "1")
    store = Store(str(tmp_path / "store"))
    outcomes = {}
    named = "left=/cam/port/image_raw right=/cam/starboard/image_raw"
    for topics, rig_file in (("", ""), (named, ""), (named, str(tmp_path / "rig.yaml"))):
        add_recordings(store, find_recordings(f"{tmp_path}/logs/*", rig_file, topics=topics))
        [outcomes[bool(topics), bool(rig_file)]] = run_stage(store, STAGE, detect_recording, OPTIONS)
    assert "lmkit fleet scan: --topic left=TOPIC" in outcomes[False, False].failure
    # The rig from camera_info does not contain the place of the cameras on the robot.
    assert "T_base_left" in outcomes[True, False].failure and "--rig" in outcomes[True, False].failure
    assert outcomes[True, True].ok and outcomes[True, True].facts["frames"] == 3
    with pytest.raises(InputError, match="port=/x"):
        find_recordings("logs/*", topics="port=/x")


def test_ranges_and_bearings_go_through_all_stages(tmp_path, monkeypatch):
    """Two robots that read ranges and bearings in one hall, without a rig."""
    rng = np.random.default_rng(1)
    places = {code: np.array([x, y]) for code, (x, y) in enumerate([(4, 3), (4, -3), (-4, 3), (-4, -3), (0, 5)])}
    for robot, radius in (("a", 1.5), ("b", 2.0)):
        times = np.arange(0, 60, 0.1)
        angle = 2 * np.pi * times / 30
        x, y, heading = radius * np.sin(angle), radius * (1 - np.cos(angle)), angle
        odometry = [f"{t:.2f},{radius * 2 * np.pi / 30:.6f},{2 * np.pi / 30:.6f}" for t in times]
        readings = []
        for k in range(0, len(times), 5):
            for code, place in places.items():
                away = place - [x[k], y[k]]
                distance = np.hypot(*away) + rng.normal(0, 0.02)
                bearing = np.arctan2(away[1], away[0]) - heading[k] + rng.normal(0, 0.005)
                readings.append(f"{times[k]:.2f},{code},{distance:.4f},{(bearing + np.pi) % (2 * np.pi) - np.pi:.5f}")
        folder = tmp_path / "logs" / "hall" / robot / "1"
        folder.mkdir(parents=True)
        (folder / "odometry.csv").write_text("\n".join(["time_s,forward_mps,turn_radps", *odometry]) + "\n")
        (folder / "readings.csv").write_text("\n".join(["time_s,code,range_m,bearing_rad", *readings]) + "\n")
    monkeypatch.setenv("LMKIT_JOBS", "1")
    store = Store(str(tmp_path / "store"))
    add_recordings(store, find_recordings(f"{tmp_path}/logs/{{site}}/{{robot}}/*"))
    assert all(outcome.ok for outcome in run_stage(store, STAGE, detect_recording, OPTIONS))
    [(site, some)] = parts_by_site(store, OPTIONS).items()
    surveyed = survey_site(store, site, some, 0.18)
    assert len(surveyed.facts["recordings"]) == 2 and not surveyed.facts["left_out"]
    a = np.array([surveyed.landmarks.find(LandmarkId("lm8", code)).T_map_landmark.t[:2] for code in places])
    b = np.array(list(places.values()))
    apart = np.linalg.norm(a[:, None] - a, axis=2) - np.linalg.norm(b[:, None] - b, axis=2)
    assert np.abs(apart).max() < 0.1
    options = {"maps": {site: map_to_yaml(surveyed.landmarks)}, "detect": OPTIONS}
    outcomes = list(run_stage(store, "track", track_recording, options))
    assert all(outcome.ok and outcome.facts["ok"] == outcome.facts["frames"] > 100 for outcome in outcomes), outcomes
