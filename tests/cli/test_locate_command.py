"""`lmkit locate` and the files it writes, as a user runs it."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from xml.etree import ElementTree

import cv2
import numpy as np
import pytest

from lmkit.cli.locate_sources import source_groups, warn_of_clocks
from lmkit.geometry.rig import Rig, with_time_offsets
from lmkit.io.landmark_map import map_to_yaml
from lmkit.io.rig import rig_to_yaml
from lmkit.io.trajectory import read_trajectory
from lmkit.model.estimate import PoseEstimate
from lmkit.model.landmark import LM8
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import LandmarkMap
from lmkit.pipelines.locate_images import Located
from lmkit.pipelines.locate_results import LocateResults
from lmkit.simulation.dataset import make_dataset, render_images
from lmkit.simulation.recording import make_drive
from lmkit.simulation.scene import make_rig


@pytest.fixture(scope="module")
def room(tmp_path_factory):
    """Two simulated pairs, the rig, the map and the truth."""
    folder = tmp_path_factory.mktemp("room")
    data = make_dataset(1, pairs=2, boards=0, landmarks=12, family=LM8)
    for name, image in render_images(data):
        path = folder / name.removeprefix("drive/")
        path.parent.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(path), image)
    (folder / "rig.yaml").write_text(rig_to_yaml(data.rig))
    (folder / "map.yaml").write_text(map_to_yaml(data.scene.landmarks))
    return folder, data


def given(room):
    folder, _ = room
    return (folder / "left", folder / "right", "--rig", folder / "rig.yaml", "--map", folder / "map.yaml")


def test_all_that_it_writes(lmkit, room, tmp_path):
    _, data = room
    answer = lmkit(
        "locate", *given(room), "--json", "--tum", "t.txt", "--csv", "t.csv", "--plan", "p.svg", "--annotate", "shown"
    )
    assert answer.code == 0, answer.err
    rows = [json.loads(line) for line in answer.out.splitlines()]
    assert len(rows) == 2
    for row, truth in zip(rows, data.poses, strict=True):
        assert row["status"] in ("ok", "ambiguous", "imprecise")
        if row["status"] == "ok":
            assert np.linalg.norm(np.array(row["position"]) - truth.t) < 0.05
    sure = [row for row in rows if row["status"] == "ok"]
    assert len(read_trajectory(tmp_path / "t.txt")) == len(sure) >= 1
    table = list(csv.DictReader((tmp_path / "t.csv").open()))
    assert [float(r["x_m"]) for r in table] == pytest.approx([row["position"][0] for row in rows], abs=1e-6)
    assert float(table[0]["sigma_x_m"]) == pytest.approx(rows[0]["covariance"][0][0] ** 0.5, rel=1e-6)
    drawn = ElementTree.fromstring((tmp_path / "p.svg").read_text())
    words = "".join(drawn.itertext())
    assert all(str(landmark.code) in words for landmark in data.scene.landmarks)
    assert len(list((tmp_path / "shown").iterdir())) == 2


def test_cameras_that_do_not_expose_together_are_named(capsys):
    rig = make_rig()
    for offset_s, sources, words in (
        (0.08, 2, ["right +80.0 ms", "lmkit track"]),
        (-0.08, 2, ["right -80.0 ms"]),
        (0.08, 1, []),
        (0.0, 2, []),
    ):
        warn_of_clocks([["image.png"] * sources], with_time_offsets(rig, [offset_s]))
        said = capsys.readouterr().err
        assert all(word in said for word in words) and bool(said) == bool(words)


def test_locate_names_cameras_that_do_not_expose_together(lmkit, tmp_path):
    rig = make_rig()
    (tmp_path / "rig.yaml").write_text(rig_to_yaml(with_time_offsets(rig, [0.08])))
    (tmp_path / "map.yaml").write_text(map_to_yaml(make_drive(0, 1.0).landmarks))
    cv2.imwrite(str(tmp_path / "dark.png"), np.zeros(rig.left.image_size[::-1], np.uint8))
    given_ = ("--rig", "rig.yaml", "--map", "map.yaml")
    assert "do not expose together (right +80.0 ms)" in lmkit("locate", "dark.png", "dark.png", *given_).err
    assert "expose" not in lmkit("locate", "dark.png", "--mono", *given_).err


def test_two_images_for_a_rig_of_one_camera_are_named(capsys):
    rig = Rig.of_one(make_rig().left)
    assert source_groups(["l.png", "r.png"], None, rig) == [["l.png"], ["r.png"]]
    assert "l.png and r.png are two frames of it" in capsys.readouterr().err
    assert len(source_groups(["1.png", "2.png", "3.png"], None, rig)) == 3
    assert source_groups([], "l.png", rig) == [["l.png"]]
    assert not capsys.readouterr().err


def test_a_trajectory_has_no_doubtful_poses(room, tmp_path):
    _, data = room
    results = LocateResults(data.rig, data.scene.landmarks, "camera")
    for number, status in enumerate(("ok", "ambiguous", "no_landmarks", "ok")):
        pose = None if status == "no_landmarks" else data.poses[0]
        results.add(Located((f"{number}.png",), PoseEstimate(status, pose, 1e-4 * np.eye(6))))
    (tmp_path / "t.txt").write_text(results.tum())
    assert read_trajectory(tmp_path / "t.txt").times_s.tolist() == [0, 3]


def test_a_map_of_another_place_is_named_though_some_frames_are_located(lmkit, room, tmp_path, monkeypatch):
    """Frames that see one landmark alone cannot contradict a map, and are located."""
    _, data = room
    ids = [m.id for m in data.scene.landmarks]
    cause = "the landmarks seen are in the map, but at other places"
    sure = PoseEstimate("ok", data.poses[0], 1e-4 * np.eye(6), inliers=(ids[0],))
    off = PoseEstimate("inconsistent", outliers=(ids[0], ids[1]), warnings=(cause,))
    agree = replace(sure, inliers=(ids[0], ids[1]))

    def said(*estimates):
        found = (Located((f"{k}.png",), e) for k, e in enumerate(estimates))
        monkeypatch.setattr("lmkit.pipelines.locate_images.locate_in_sources", lambda *_: found)
        answer = lmkit("locate", *given(room))
        assert answer.code == 0, answer.err
        return answer.err

    assert f"2 of 2 frames that saw two landmarks or more contradict the map: {cause}" in said(sure, off, off)
    assert "contradict" not in said(off, agree, agree)
    assert "contradict" not in said(sure, agree)


def test_what_is_read_is_named_where_the_map_has_none_of_it(lmkit, room, tmp_path):
    _, data = room
    landmarks = data.scene.landmarks
    unused = sorted(set(range(256)) - {m.code for m in landmarks})
    elsewhere = [replace(m, id=LandmarkId(m.family, code)) for m, code in zip(landmarks, unused, strict=False)]
    (tmp_path / "elsewhere.yaml").write_text(map_to_yaml(LandmarkMap(tuple(elsewhere))))
    answer = lmkit("locate", *given(room)[:4], "--map", "elsewhere.yaml")
    assert answer.code == 1
    assert "no pose from 2 frames; the images show lm8:" in answer.err
    assert "the map has none of them" in answer.err


def test_nothing_is_overwritten(lmkit, room, tmp_path):
    (tmp_path / "t.txt").write_text("mine")
    answer = lmkit("locate", *given(room), "--tum", "t.txt")
    assert answer.code == 2
    assert (tmp_path / "t.txt").read_text() == "mine"


def test_images_named_by_time_keep_their_names_apart(lmkit, room, tmp_path):
    """`12.25.png` and `12.75.png` are two frames: in the trajectory, and as images."""
    folder, _ = room
    for side in ("left", "right"):
        (tmp_path / side).mkdir()
        for k, file in enumerate(sorted((folder / side).iterdir())):
            (tmp_path / side / f"12.{25 + 50 * k}.png").write_bytes(file.read_bytes())
    answer = lmkit("locate", "left", "right", *given(room)[2:], "--json", "--tum", "t.txt", "--annotate", "shown")
    assert answer.code == 0, answer.err
    rows = [json.loads(line) for line in answer.out.splitlines()]
    assert [row["time_s"] for row in rows] == [12.25, 12.75]
    times = [row["time_s"] for row in rows if row["status"] == "ok"]
    assert read_trajectory(tmp_path / "t.txt").times_s.tolist() == times
    assert sorted(p.name for p in (tmp_path / "shown").iterdir()) == ["12.25.jpg", "12.75.jpg"]


def test_a_film_is_located_frame_by_frame(lmkit, room, tmp_path):
    folder, _ = room
    films = []
    for side in ("left", "right"):
        films.append(tmp_path / f"{side}.avi")
        writer = cv2.VideoWriter(str(films[-1]), cv2.VideoWriter.fourcc(*"MJPG"), 5, (640, 480))
        for file in sorted((folder / side).iterdir()):
            writer.write(cv2.imread(str(file)))
        writer.release()
    answer = lmkit("locate", *films, *given(room)[2:], "--json")
    rows = [json.loads(line) for line in answer.out.splitlines()]
    assert [row["left"] for row in rows] == [f"{films[0]}#0", f"{films[0]}#1"]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--heading", "north"], "--heading"),
        (["--heading", "90+-0"], "--heading"),
        (["--planar", "0.4"], "height of --planar"),
        (["--planar", "0.4m,steep"], "steep"),
        (["--planar", "0.4m,90"], "not a valid tilt"),
        (["--planar", "0.4m,nan"], "not a valid tilt"),
        (["--plan", "p.pdf"], ".png or .svg"),
        (["--range-sigma", "0.1m"], "--range-sigma"),
        (["--readings", "r.csv"], "--readings and images"),
    ],
)
def test_wrong_options_are_explained_in_one_line(lmkit, room, options, words):
    answer = lmkit("locate", *given(room), *options)
    assert answer.code == 2
    assert words in answer.err
    assert len(answer.err.strip().splitlines()) == 1


def test_priors_are_taken(lmkit, room):
    _, data = room
    heading = np.rad2deg(np.arctan2(data.poses[0].R[1, 2], data.poses[0].R[0, 2]))
    folder = room[0]
    first = sorted(p.name for p in (folder / "left").iterdir())[0]
    pair = (folder / "left" / first, folder / "right" / first)
    right = lmkit("locate", *pair, *given(room)[2:], "--json", "--heading", f"{heading:.2f}+-1")
    assert right.code == 0, right.err
    wrong = lmkit("locate", *pair, *given(room)[2:], "--json", "--heading", f"{heading + 40:.2f}+-0.01")
    one, other = json.loads(right.out), json.loads(wrong.out)
    assert np.linalg.norm(np.subtract(one["position"], other["position"])) < 0.05
    assert right.err == ""
    assert "the prior contradicts the images and is left out: heading" in wrong.err


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ([], "--map"),
        (["--map", "m.yaml", "--heading", "90"], "--readings and --heading"),
        (["--map", "m.yaml", "--time-offset", "nan"], "--time-offset"),
        (["--map", "m.yaml", "--range-sigma", "x%"], "--range-sigma"),
        (["--map", "m.yaml", "--bearing-sigma", "0"], "--bearing-sigma"),
    ],
)
def test_wrong_options_of_readings_are_explained_in_one_line(lmkit, room, tmp_path, options, words):
    (tmp_path / "m.yaml").write_text((room[0] / "map.yaml").read_text())
    (tmp_path / "r.csv").write_text("time_s,code,range_m,bearing_rad\n0,1,1,\n")
    answer = lmkit("locate", "--readings", "r.csv", *options)
    assert answer.code == 2
    assert words in answer.err
    assert len(answer.err.strip().splitlines()) == 1


def test_frames_without_a_time_get_that_of_a_steady_rate():
    from lmkit.pipelines.locate_images import Located, with_times

    named = (("a.png", None), ("7.5.png", 7.5), ("c.png", None))
    frames = [Located((name,), None, time_s=time_s) for name, time_s in named]
    assert [frame.time_s for frame in with_times(frames, 4.0)] == [0.0, 7.5, 0.5]
    assert [frame.time_s for frame in with_times(frames, None)] == [None, 7.5, None]
