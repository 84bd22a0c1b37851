"""Jobs: commands over files of the project, and the processes that do the work."""

from __future__ import annotations

import os
import time

import pytest

import lmkit
from lmkit.errors import InputError
from lmkit.web.project import open_project
from lmkit.web.verbs import VERBS, JobBody
from lmkit.web.workers import Workers


@pytest.mark.slow
def test_a_survey_and_a_track_run_as_jobs_with_their_reports(serve, tmp_path):
    lmkit.write_example_files(tmp_path / "drives/a", board_pairs=0, seconds=8)
    with serve(tmp_path) as page:
        survey = _ended(page, page.post("/api/jobs/survey", json={"source": "drives/a"}).json())
        assert survey["state"] == "done", survey
        assert survey["command"].startswith("lmkit survey --detections drives/a/detections.csv")
        assert len(lmkit.read_map(tmp_path / "map.yaml")) > 3 and page.get("/api/map").json()["landmarks"]
        report = page.get(f"/api/files/{survey['outputs'][0]}")
        assert "<html" in report.text and "sandbox" in report.headers["content-security-policy"]
        track = _ended(page, page.post("/api/jobs/track", json={"source": "drives/a"}).json())
        assert track["state"] == "done" and (tmp_path / "reports/drives-a-track.tum").is_file()
        assert [job["verb"] for job in page.get("/api/jobs").json()["jobs"]] == ["track", "survey"]


@pytest.mark.parametrize("size", ["--force", "0", "180 parsecs", ""])
def test_a_survey_of_a_wrong_size_is_not_started(serve, tmp_path, size):
    (tmp_path / "drives/a").mkdir(parents=True)
    (tmp_path / "drives/a/detections.csv").touch()
    (tmp_path / "rig.yaml").touch()
    with serve(tmp_path) as page:
        assert page.post("/api/jobs/survey", json={"source": "drives/a", "size": size}).status_code == 400
        assert page.get("/api/jobs").json()["jobs"] == []


def test_a_bag_becomes_a_recording_of_its_own(tmp_path):
    project = open_project(tmp_path)
    for side in ("left", "right"):
        (tmp_path / "drives/monday" / side).mkdir(parents=True)
        (tmp_path / f"drives/monday/{side}/1.png").touch()
    (tmp_path / "drives/monday/rig").mkdir()
    (tmp_path / "monday.mcap").touch()
    unbag = VERBS["unbag"](project, JobBody(source="monday.mcap"))
    assert unbag.command == "lmkit unbag monday.mcap -o drives/monday-2"
    survey = VERBS["survey"](project, JobBody(source="drives/monday"))
    assert "--rig drives/monday/rig --" in survey.command  # the folder that came out of the bag
    for wrong in ("", "../monday.mcap", "tuesday.mcap", "drives"):
        with pytest.raises(InputError, match="there is no bag"):
            VERBS["unbag"](project, JobBody(source=wrong))


def test_a_job_is_canceled_and_another_follows(serve, tmp_path):
    with serve(tmp_path) as page:
        first = page.post("/api/jobs/example", json={}).json()
        second = page.post("/api/jobs/example", json={}).json()
        assert first["waits_for"] is None and second["waits_for"] == "Write the example"
        page.post(f"/api/jobs/{second['id']}/cancel")
        time.sleep(0.5)
        for _ in range(2):  # a second cancel does not disturb the end of the processes
            page.post(f"/api/jobs/{first['id']}/cancel")
        ended = _ended(page, first)
        assert ended["state"] == "canceled" and ended["seconds"] < 20
        assert page.get("/api/jobs/99").status_code == 404
        assert page.post("/api/jobs/format-disk", json={}).status_code == 404


@pytest.mark.slow
def test_a_job_that_fails_says_why(serve, tmp_path):
    lmkit.write_example_files(tmp_path / "drives/a", board_pairs=0, seconds=2)
    (tmp_path / "drives/a/detections.csv").write_text("nonsense\n")
    with serve(tmp_path) as page:
        job = _ended(page, page.post("/api/jobs/survey", json={"source": "drives/a"}).json())
        assert job["state"] == "failed" and "detections.csv" in job["error"] and not (tmp_path / "map.yaml").exists()


def _ended(page, job):
    for _ in range(600):
        job = page.get(f"/api/jobs/{job['id']}").json()
        if job["state"] not in ("waiting", "running"):
            return job
        time.sleep(0.1)
    raise AssertionError(f"still {job['state']}")


def test_a_run_from_the_page_names_its_command_and_its_recording(tmp_path):
    project = open_project(tmp_path)
    plan = VERBS["run"](project, JobBody(source="sim:", record=True))
    assert plan.command == "lmkit run sim: --record runs/run.mcap" and plan.outputs == ("runs/run.mcap",)
    (tmp_path / "run.yaml").write_text("sources: ['sim:']\n")
    assert VERBS["run"](project, JobBody(source="run.yaml")).command == "lmkit run run.yaml"
    (tmp_path / "runs").mkdir()
    (tmp_path / "runs/run.mcap").touch()
    assert VERBS["run"](project, JobBody(source="runs/run.mcap")).command == "lmkit run replay:runs/run.mcap"
    with pytest.raises(InputError):
        VERBS["run"](project, JobBody(source="camera:0"))


def test_work_in_processes_ends_when_it_takes_too_long():
    import asyncio

    async def try_all():
        workers = Workers(1, longest_s=60)
        try:
            assert await workers.run(abs, -3) == 3
            with pytest.raises(InputError, match="reading this file failed"):
                await workers.run(os._exit, 3)
            assert await workers.run(abs, -4) == 4
            workers._longest_s = 0.2
            with pytest.raises(InputError, match="not done"):
                await workers.run(time.sleep, 60)
        finally:
            workers.close()

    asyncio.run(try_all())


def test_planning_jobs_name_their_commands_and_what_is_missing(mapped):
    page, folder = mapped
    project = open_project(folder)
    for verb, code in (("coverage", "no_floor"), ("place", "no_floor")):
        assert page.post(f"/api/jobs/{verb}", json={}).json()["code"] == code
    assert VERBS["sheet"](project, JobBody()).command == (
        "lmkit plan sheet --map map.yaml -o reports/mounting-sheet.pdf --force"
    )
    (folder / "floor.yaml").touch()
    assert page.post("/api/jobs/coverage", json={}).json()["code"] == "no_rig"
    (folder / "rig.yaml").touch()
    plan = VERBS["place"](project, JobBody(error="3cm", camera_height="40cm"))
    assert "--floor floor.yaml --rig rig.yaml --error 3cm --camera-height 40cm --map map.yaml" in plan.command
    for body in ({"error": "--force"}, {"camera_height": "-o x"}, {"error": ""}):
        assert page.post("/api/jobs/coverage", json=body).status_code == 400
