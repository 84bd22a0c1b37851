"""Guided calibration: its sources, its end, and films that are uploaded."""

from __future__ import annotations

import asyncio
import itertools

import cv2
import numpy as np
import pytest

from lmkit.calibration.stereo import calibrate_stereo
from lmkit.calibration.view_coverage import coverage_of
from lmkit.errors import InputError
from lmkit.io.board_corners import SavedCorners
from lmkit.model.board import BoardSpec
from lmkit.model.observation import PairView
from lmkit.pipelines.capture_board import Found, Judgment, Looked
from lmkit.simulation.scene import board_poses, make_rig
from lmkit.web import guided
from lmkit.web.guided import ENOUGH_PAIRS, _learned, guide
from lmkit.web.jobs import Jobs
from lmkit.web.project import open_project
from lmkit.web.verbs import VERBS, JobBody

BOARD = "chessboard:9x6:25mm"


@pytest.fixture(scope="session")
def film(tmp_path_factory):
    """Bytes of a short film."""
    path = tmp_path_factory.mktemp("film") / "film.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 5, (64, 48))
    for _ in range(3):
        writer.write(np.full((48, 64, 3), 90, np.uint8))
    writer.release()
    return path.read_bytes()


def test_cameras_films_and_folders_can_be_sources(tmp_path, film):
    project = open_project(tmp_path)
    (tmp_path / "one.avi").write_bytes(film)
    (tmp_path / "two.avi").write_bytes(film)
    for side in ("left", "right"):
        (tmp_path / "pairs/a" / side).mkdir(parents=True)

    def plan(source, second=""):
        return VERBS["guide"](project, JobBody(source=source, second=second, board=BOARD))

    start = f"lmkit calibrate {{}} --board {BOARD} --capture"
    assert plan("camera:0", "camera:2").command.startswith(start.format("camera:0 camera:2") + " --save-pairs")
    assert plan("one.avi").command.startswith(start.format("one.avi") + " --side-by-side --save-pairs")
    assert plan("one.avi", "two.avi").command.startswith(start.format("one.avi two.avi") + " --save-pairs")
    assert (
        plan("pairs/a").command.startswith(start.format("pairs/a/left pairs/a/right")) and plan("pairs/a").can_finish
    )
    for wrong in (
        ("one.avi", "camera:0"),
        ("pairs/a", "one.avi"),
        ("one.avi", "one.avi"),
        ("camera:x", ""),
        ("", ""),
    ):
        with pytest.raises(InputError):
            plan(*wrong)


def test_the_film_is_read_until_its_end_or_until_it_is_asked_to_end(tmp_path, film):
    (tmp_path / "one.avi").write_bytes(film)
    task = {"cameras": [str(tmp_path / "one.avi")], "board": BOARD, "folder": str(tmp_path / "p"), "at_m": 2.0}
    for most in (9, 2):
        looks = itertools.count(1)
        states = []
        with pytest.raises(InputError, match="0 pairs"):
            guide(task | {"until_m": 0.005}, states.append, lambda looks=looks, most=most: next(looks) >= most)
        assert states[0]["total"] == 3 and states[0]["done"] == 1 and next(looks) - 1 == min(most, 3)


def test_the_guidance_ends_by_what_the_calibration_adds_and_not_before_ten_pairs(monkeypatch):
    rig = make_rig()
    looked, rng = [], np.random.default_rng(0)
    views = []
    board = BoardSpec.parse(BOARD)
    ids = np.arange(len(board.object_points))
    for pose in board_poses(0, rig, board, ENOUGH_PAIRS):
        left = pose.apply(board.object_points)
        pixels = [rig.left.project(left), rig.right.project(left @ rig.T_right_left.R.T + rig.T_right_left.t)]
        noisy = [p + 0.05 * rng.normal(size=p.shape) for p in pixels]
        views.append(PairView(f"{len(views):03d}", ids, noisy[0], ids, noisy[1], 0.05, 0.05))
        nothing = np.zeros((0, 3, 3)), np.zeros((0, 3))
        coverage = coverage_of((), *nothing, rig.left.image_size, rig.right.image_size)
        found = Found(SavedCorners(board, rig.left.image_size, tuple(views), (), rig.right.image_size), {})
        looked.append(Looked(Judgment(True, "kept", ""), None, None, found, coverage))
    solved = {}  # once for each number of pairs

    def solve(views, *args, **kwargs):
        if len(views) not in solved:
            solved[len(views)] = calibrate_stereo(views, *args, **kwargs)
        return solved[len(views)]

    monkeypatch.setattr(guided, "calibrate_stereo", solve)
    state = {"at_m": 2.0, "until_m": 1.0, "curve": []}
    assert not _learned(looked[-2], state)["reached"] and _learned(looked[-1], state)["reached"]
    here = next(d for d in _learned(looked[-1], state)["depth"] if d["at_m"] == 2.0)
    assert here["error_m"] < here["total_m"]
    assert not _learned(looked[-1], state | {"until_m": 0.9 * here["error_m"]})["reached"]
    assert _learned(looked[-1], state | {"until_m": 1.1 * here["error_m"]})["reached"]  # less than the total


def test_a_film_is_stored_once_a_frame_of_it_can_be_read(client, folder, film):
    assert client.put("/api/films/my%20film.avi", content=film).json() == {"name": "films/my film.avi"}
    assert client.put("/api/films/my%20film.avi", content=film).json() == {"name": "films/my film-2.avi"}
    assert {"name": "films/my film.avi"} in client.get("/api/project").json()["films"]
    kept = sorted((folder / "films").iterdir())
    for name, data in (("a.avi", b""), ("a.mp4", b"no film"), ("a.html", film), ("a.avi.sh", film), ("a", film)):
        reply = client.put(f"/api/films/{name}", content=data)
        assert reply.status_code == 400 and reply.json()["hint"] and "/tmp" not in reply.text
    assert client.put("/api/films/..%2fa.avi", content=film).status_code in (400, 404, 405)
    assert sorted((folder / "films").iterdir()) == kept


def test_a_film_that_is_too_large_leaves_nothing(client, folder, film, monkeypatch):
    from lmkit.web import films

    monkeypatch.setattr(films, "MOST_BYTES", 1000)
    before = sorted((folder / "films").glob("*")) if (folder / "films").exists() else []
    assert client.put("/api/films/a.avi", content=film + bytes(1000)).status_code == 413
    assert sorted((folder / "films").glob("*")) + sorted((folder / "films").glob(".*")) == before


def test_only_a_running_guidance_ends_early(client, tmp_path):
    assert client.post("/api/jobs/99/finish").status_code == 404
    words = "import sys; sys.exit(0 if sys.stdin.readline() == 'finish\\n' else 3)"

    async def try_it():
        jobs = Jobs(tmp_path)
        other = jobs.start("survey", "other", [["-c", "pass"]], "other")
        await other.task
        other.state = "running"
        one = jobs.start("guide", "one", [["-c", words]], "one", can_finish=True)
        while one.state == "waiting":
            await asyncio.sleep(0.01)
        shown, answers = one.as_dict(), []
        for job in (other, one):
            try:
                answers.append(jobs.finish(job))
            except InputError as error:
                answers.append(error.message)
        await one.task
        return one, shown["can_finish"], answers

    one, was_offered, answers = asyncio.run(try_it())
    assert was_offered and one.state == "done" and not one.as_dict()["can_finish"]
    assert answers == ["job 1 cannot end early", None]
