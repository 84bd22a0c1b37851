"""The commands as a user runs them, with good input."""

from __future__ import annotations

import csv
import json
import os
import re
import subprocess
import sys

import numpy as np
import pytest
from ids import lm8
from scenes import paste_landmark

from lmkit.model.landmark_id import LandmarkId


def test_generate_detect_verify(lmkit, tmp_path):
    assert lmkit("generate", "--codes", "7,200", "-o", "sheets.pdf").out.strip() == "sheets.pdf"
    verified = lmkit("verify", "sheets.pdf", "--json")
    assert verified.code == 0
    rows = [json.loads(line) for line in verified.out.splitlines()]
    assert [row["code"] for row in rows] == [7, 200]
    for row in rows:
        assert row["side_mm"] == pytest.approx([180, 180], abs=0.1)
        assert row["problems"] == []


def test_verify_notices_a_wrong_label_and_a_wrong_size(lmkit, tmp_path):
    from PIL import Image

    assert lmkit("generate", "--code", "7", "-o", "x.png", "--dpi", "150").code == 0
    photo = Image.open(tmp_path / "x.png")
    photo.save(tmp_path / "small.png", dpi=(160, 160))  # claims more dots per inch than it has
    answer = lmkit("verify", "small.png", "--json")
    assert json.loads(answer.out)["side_mm"] == pytest.approx([180 * 150 / 160] * 2, abs=0.2)

    from lmkit.generation.page import Page
    from lmkit.generation.pdf import pages_to_pdf
    from lmkit.generation.sheet import compose_landmark_page
    from lmkit.io.template import load_template
    from lmkit.model.landmark import LM8

    right, wrong = (compose_landmark_page(LM8, code, 180.0, load_template("a4")) for code in (7, 8))
    drawing = [item for item in right.items if getattr(item, "role", "mark") != "mark"]
    labels = [item for item in wrong.items if getattr(item, "role", "mark") == "mark"]
    (tmp_path / "mixed.pdf").write_bytes(pages_to_pdf([Page(right.size_mm, (*drawing, *labels), "")], ""))
    answer = lmkit("verify", "mixed.pdf")
    assert answer.code == 1
    assert "reads as code 7, but its label states 8" in answer.out


@pytest.mark.parametrize("suffix", ["png", "svg"])
def test_several_codes_make_several_images(lmkit, tmp_path, suffix):
    answer = lmkit("generate", "--codes", "1-2", "--bare", "--dpi", "50", "-o", f"x.{suffix}")
    assert answer.out.split() == [f"x-1.{suffix}", f"x-2.{suffix}"]
    assert sorted(p.name for p in tmp_path.iterdir()) == answer.out.split()


def test_detect_prints_what_the_formats_page_says(lmkit, tmp_path, photographs):
    import cv2

    image = cv2.resize(photographs[0], (320, 240))
    image, truth = paste_landmark(image, 99, (160, 120), 60, 20, np.random.default_rng(0))
    cv2.imwrite(str(tmp_path / "scene.png"), image)
    answer = lmkit("detect", "scene.png", "--json", "--annotate", "marked")
    assert answer.code == 0
    (line,) = answer.out.splitlines()
    row = json.loads(line)
    assert (row["image"], row["width"], row["height"]) == ("scene.png", 320, 240)
    (detection,) = row["detections"]
    assert detection.keys() == {"id", "code", "family", "corners", "center", "confidence", "margin"}
    assert (detection["code"], detection["family"]) == (99, "lm8")
    assert np.abs(np.array(detection["corners"]) - truth).max() < 0.5
    assert 0.9 < detection["confidence"] <= 1
    assert (tmp_path / "marked" / "scene.jpg").is_file()


def test_doctor_finds_this_installation_sound(lmkit):
    answer = lmkit("doctor")
    assert re.search(r"extras: .*\bbags\b", answer.out)
    assert "benchmark" not in answer.out
    assert answer.code == 0, answer.out
    assert "OpenCV" in answer.out


def test_a_folder_gives_the_same_on_several_cores_as_one_by_one(lmkit, tmp_path, photographs):
    import cv2

    for k in range(7):
        image = cv2.resize(photographs[k % len(photographs)], (240, 200))
        image, _ = paste_landmark(image, 30 * k, (120, 100), 50, 20, np.random.default_rng(k))
        (tmp_path / "many").mkdir(exist_ok=True)
        cv2.imwrite(str(tmp_path / "many" / f"{k}.png"), image)
    (tmp_path / "many" / "3.png").write_bytes(b"nothing")
    together = lmkit("detect", "many", "--json")
    assert together.code == 2
    alone = [lmkit("detect", f"many/{k}.png", "--json").out for k in range(7)]
    assert together.out == "".join(alone)
    assert [len(json.loads(line).get("detections", [])) for line in together.out.splitlines()] == [
        1,
        1,
        1,
        0,
        1,
        1,
        1,
    ]


def test_videos_are_read_frame_by_frame(lmkit, tmp_path, photographs):
    import cv2

    image = cv2.resize(photographs[0], (320, 240))
    image, _ = paste_landmark(image, 99, (160, 120), 80, 10, np.random.default_rng(0))
    writer = cv2.VideoWriter(str(tmp_path / "drive.avi"), cv2.VideoWriter_fourcc(*"MJPG"), 5, (320, 240))
    for _ in range(2):
        writer.write(image)
    writer.release()
    answer = lmkit("detect", "drive.avi", "--json", "--annotate", "marked", "--csv", "seen.csv")
    rows = [json.loads(line) for line in answer.out.splitlines()]
    assert [row["image"] for row in rows] == ["drive.avi#0", "drive.avi#1"]
    assert [row["time_s"] for row in rows] == pytest.approx([0.0, 0.2])
    assert [[d["code"] for d in row["detections"]] for row in rows] == [[99], [99]]
    table = list(csv.DictReader((tmp_path / "seen.csv").open()))
    assert [(row["image"], float(row["time_s"]), row["code"]) for row in table] == [
        ("drive.avi#0", 0.0, "99"),
        ("drive.avi#1", 0.2, "99"),
    ]
    assert float(table[0]["x0_px"]) == pytest.approx(rows[0]["detections"][0]["corners"][0][0], abs=1e-3)
    assert [path.name for path in (tmp_path / "marked").iterdir()] == ["drive.mp4"]
    video = cv2.VideoCapture(str(tmp_path / "marked" / "drive.mp4"))
    frames = [video.read()[1] for _ in range(2)]
    assert not video.read()[0]
    assert video.get(cv2.CAP_PROP_FPS) == pytest.approx(5)
    # The outline is drawn in green, which the photograph under it is not.
    blue, green, red = (frames[1][:, :, k].astype(int) for k in range(3))
    assert ((green > 150) & (green > red + 60) & (green > blue + 60)).sum() > 100


@pytest.mark.parametrize("family", ["lm8", "lm12"])
def test_readings_of_range_and_bearing(lmkit, tmp_path, family):
    from lmkit.io.landmark_map import map_to_yaml
    from lmkit.model.landmark_map import LandmarkMap, MappedLandmark, wall_pose

    places = ((1, 4.0, -1.0), (2, 4.0, 2.0))
    landmarks = [MappedLandmark(LandmarkId(family, c), 0.18, wall_pose([x, y, 1.0], 0.0)) for c, x, y in places]
    (tmp_path / "map.yaml").write_text(map_to_yaml(LandmarkMap(landmarks)))
    rows = ["time_s,code,range_m,bearing_rad", "0.5,1,2.961457,-0.642063", "0.5,2,3.124446,0.387606", "0.7,1,2.9,0.1"]
    (tmp_path / "r.csv").write_text("\n".join(rows))
    answer = lmkit("locate", "--readings", "r.csv", "--map", "map.yaml", "--json")
    assert answer.code == 0, answer.err
    first, second = (json.loads(line) for line in answer.out.splitlines())
    assert first["position"] == pytest.approx([1.356354, 0.334677], abs=1e-4)
    assert first["heading_rad"] == pytest.approx(np.deg2rad(10), abs=1e-4)
    assert (first["codes"], first["ids"]) == ([1, 2], [f"{family}:1", f"{family}:2"])
    assert (second["status"], second["position"]) == ("no_landmarks", None)


def test_readings_of_a_map_of_two_families_name_theirs(lmkit, tmp_path):
    from lmkit.io.landmark_map import map_to_yaml
    from lmkit.model.landmark_map import LandmarkMap, MappedLandmark, wall_pose

    ids = (LandmarkId("lm8", 1), LandmarkId("lm12", 1))
    landmarks = [
        MappedLandmark(i, 0.18, wall_pose([4.0, y, 1.0], 0.0)) for i, y in zip(ids, (-1.0, 2.0), strict=True)
    ]
    (tmp_path / "map.yaml").write_text(map_to_yaml(LandmarkMap(landmarks)))
    header, rows = "time_s,code,range_m,bearing_rad", ["0.5,1,2.961457,-0.642063", "0.5,1,3.124446,0.387606"]
    (tmp_path / "r.csv").write_text("\n".join([header, *rows]))
    refused = lmkit("locate", "--readings", "r.csv", "--map", "map.yaml", "--json")
    assert (refused.code, "line 2" in refused.err, "lm12:1" in refused.err) == (2, True, True)
    (tmp_path / "r.csv").write_text(f"{header},family\n{rows[0]},lm8\n{rows[1]},lm12\n")
    answer = json.loads(lmkit("locate", "--readings", "r.csv", "--map", "map.yaml", "--json").out)
    assert answer["position"] == pytest.approx([1.356354, 0.334677], abs=1e-4)
    assert answer["ids"] == ["lm12:1", "lm8:1"]


@pytest.mark.parametrize("row", ["0.5,1,nan,0.1", "0.5,1,2.9", "0.5,one,2.9,0.1", "0.5,1,-2,0.1"])
def test_a_bad_reading_is_named_with_its_line(lmkit, tmp_path, row):
    from lmkit.io.landmark_map import map_to_yaml
    from lmkit.model.landmark_map import LandmarkMap, MappedLandmark, wall_pose

    landmarks = [MappedLandmark(lm8(1), 0.18, wall_pose([1.0, 2.0, 1.0], 0.0))]
    (tmp_path / "map.yaml").write_text(map_to_yaml(LandmarkMap(landmarks)))
    (tmp_path / "r.csv").write_text("time_s,code,range_m,bearing_rad\n" + row)
    answer = lmkit("locate", "--readings", "r.csv", "--map", "map.yaml")
    assert answer.code == 2
    assert "r.csv: line 2" in answer.err


def test_the_templates_are_listed(lmkit, tmp_path):
    from lmkit.io.template import shipped_templates

    lines = lmkit("generate", "--list-templates").out.splitlines()
    assert [line.split()[0] for line in lines] == shipped_templates()
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("suffix", ["svg", "png"])
def test_tiles_and_contents_go_into_a_file_for_each_page(lmkit, suffix):
    answer = lmkit("generate", "--code", 3, "--size", "300mm", "--dpi", 30, "-o", f"big.{suffix}")
    assert answer.code == 0, answer.err
    assert answer.out.split() == [f"big-3-{page}.{suffix}" for page in range(1, len(answer.out.split()) + 1)]
    answer = lmkit("generate", "--code", 3, "--template", "a4-set", "--dpi", 30, "-o", f"set.{suffix}")
    assert answer.out.split() == [f"set-3-1.{suffix}", f"set-3-2.{suffix}"]


def test_python_m_is_the_command():
    ended = subprocess.run([sys.executable, "-m", "lmkit", "--version"], capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stdout.split()[0]) == (0, "lmkit")


@pytest.mark.skipif(sys.platform == "win32", reason="no pseudo terminals")
def test_stdout_stays_stdout_beside_a_progress_bar(tmp_path):
    """Rich moves stdout to its own console, which is stderr, unless asked not to."""
    import pty

    (tmp_path / "a.png").write_bytes(b"nothing")
    main, terminal = pty.openpty()
    words = [sys.executable, "-m", "lmkit", "detect", "a.png", "--json"]
    ended = subprocess.run(words, stdout=subprocess.PIPE, stderr=terminal, text=True, cwd=tmp_path, check=False)
    os.close(terminal)
    os.close(main)
    assert json.loads(ended.stdout)["image"] == "a.png"


def test_opencv_adds_nothing_to_an_error(tmp_path):
    import cv2

    whole = tmp_path / "whole.mp4"
    writer = cv2.VideoWriter(str(whole), cv2.VideoWriter.fourcc(*"mp4v"), 5, (64, 48))
    writer.write(np.zeros((48, 64, 3), dtype=np.uint8))
    writer.release()
    # FFmpeg complains of a file that ends early.
    (tmp_path / "bad.mp4").write_bytes(whole.read_bytes()[: whole.stat().st_size // 2])
    words = [sys.executable, "-m", "lmkit", "detect", "bad.mp4"]
    ended = subprocess.run(words, capture_output=True, text=True, cwd=tmp_path, check=False)
    assert ended.returncode == 2
    assert ended.stderr.splitlines() == ["lmkit: bad.mp4: no frame can be read; give MP4, AVI, MOV, MKV or WebM"]
