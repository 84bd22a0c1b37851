"""Documents made to harm, or harmed on their way: refused by name, quickly, and never with another exception."""

from __future__ import annotations

import os
import random
from pathlib import Path

import pytest
from harmed_files import harm_text

from lmkit.errors import InputError
from lmkit.geometry.stereo_rig import StereoRig
from lmkit.io.any_rig import read_any_rig
from lmkit.io.board_corners import read_corners
from lmkit.io.documents import load_document, load_json, read_text
from lmkit.io.external_maps import map_to_tagslam, map_to_wpilib, read_any_map
from lmkit.io.floor_plan import read_floor
from lmkit.io.kalibr import rig_to_camchain
from lmkit.io.landmark_map import map_to_yaml
from lmkit.io.manifest import read_manifest
from lmkit.io.opencv_rig import rig_to_opencv_yaml
from lmkit.io.readings import read_readings
from lmkit.io.recording_tables import read_detections, read_gyro, read_odometry
from lmkit.io.rig import rig_to_yaml
from lmkit.io.ros_camera_info import read_camera_infos, rig_to_camera_infos
from lmkit.io.svg_lines import read_svg_lines
from lmkit.io.template import load_template
from lmkit.io.trajectory import read_trajectory
from lmkit.simulation.recording import make_drive
from lmkit.simulation.scene import make_rig

HERE = Path("document")


def bomb() -> str:
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 9)}]" for k in range(1, 12)]
    return "\n".join(lines)


@pytest.mark.parametrize(
    ("text", "code"),
    [
        (bomb(), "document_too_large"),
        ("a: " + "[" * 500 + "]" * 500, "document_too_large"),
        ("a: " + "[" * 50_000, "bad_yaml"),
        ("a: &a [*a]", "bad_yaml"),
        ("a: !!int abc", "bad_yaml"),
        ("a: !!float [1]", "bad_yaml"),
        ("a: !!bool perhaps", "bad_yaml"),
        ("a: !!timestamp yesterday", "bad_yaml"),
        ("a: " + "9" * 5000, "bad_yaml"),
        ("a: " + "9" * 400, "bad_value"),
        ("a: [1, .nan]", "not_finite"),
        ("a: 1e999", "not_finite"),
        ('a: "\\ud800"', "bad_yaml"),
        ("{a: 1}: 2", "bad_yaml"),
        ("a: 1\n---\na: 2\n", "bad_yaml"),
        ("a: [", "bad_yaml"),
    ],
    ids=lambda value: str(value)[:24],
)
def test_hostile_yaml_is_refused_by_name(text, code):
    with pytest.raises(InputError) as caught:
        load_document(HERE, text)
    assert caught.value.code == code


@pytest.mark.parametrize(
    "text",
    ["[" * 100_000, '{"a": NaN}', '{"a": 1e999}', '{"a": ' + "9" * 5000 + "}", '{"a": "\\ud800"}', "{", '"', "{]"],
    ids=lambda value: value[:16],
)
def test_hostile_json_is_refused(text):
    with pytest.raises(InputError):
        load_json(HERE, text)


def test_dates_and_numbers_to_base_60_are_words():
    text = "{a: 2020-01-01, b: 1:30:00, c: 0777, d: 1e-3, e: -2.5, f: 12, g: 08}"
    assert load_document(HERE, text) == {
        "a": "2020-01-01", "b": "1:30:00", "c": 777, "d": 1e-3, "e": -2.5, "f": 12, "g": 8
    }  # fmt: skip


def test_aliases_within_bounds_are_read():
    assert load_document(HERE, "a: &a [1, 2]\nb: *a\n") == {"a": [1, 2], "b": [1, 2]}


def test_text_as_other_systems_write_it(tmp_path):
    path = tmp_path / "text"
    for data in (b"\xef\xbb\xbfa\r\nb\r\n", "a\nb\n".encode("utf-16"), b"a\rb\r"):
        path.write_bytes(data)
        assert read_text(path, "text") == "a\nb\n"


def test_what_is_no_regular_text_file_is_refused(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "zeros").write_bytes(b"a\0b")
    (tmp_path / "latin").write_bytes(b"caf\xe9")
    names = [tmp_path / name for name in ("pipe", "zeros", "latin", "missing", "n" * 5000, "a\0b")]
    for path in [*names, Path("/dev/zero"), tmp_path]:
        with pytest.raises(InputError):
            read_text(path, "text")


def _seeds(folder: Path) -> dict[str, tuple[str, object]]:
    """A valid text for each reader, and the reader."""
    rig: StereoRig = make_rig()
    landmarks = make_drive(0, seconds=3).landmarks
    left, right = rig_to_camera_infos(rig)
    (folder / "right.yaml").write_text(right)
    pose = "0.5 1 2 3 0 0 0 1\n0.7 1 2 3 0 0 0 1\n"
    corners = "1,2,3,4,5,6,7,8"
    floor = "format: lmkit-floor/1\nwalls:\n- {from: [0, 0], to: [4, 0]}\n- {from: [4, 0], to: [0, 3]}\n"
    template = (Path(__file__).parents[2] / "templates" / "a4.toml").read_text()
    drawing = (
        '<svg xmlns="http://www.w3.org/2000/svg" width="400" height="300"><rect width="100%" height="100%"/>'
        '<g transform="translate(1 2) rotate(90)"><line x1="0" y1="0" x2="9" y2="0"/><path d="M0 0h9v-3z"/>'
        '<polygon points="0,0 4,0 4,3"/></g></svg>'
    )
    return {
        "floor.svg": (drawing, read_svg_lines),
        "rig.yaml": (rig_to_yaml(rig), read_any_rig),
        "opencv.yaml": (rig_to_opencv_yaml(rig), read_any_rig),
        "kalibr.yaml": (rig_to_camchain(rig)[0], read_any_rig),
        "left.yaml": (left, lambda path: read_camera_infos(path, folder / "right.yaml")),
        "map.yaml": (map_to_yaml(landmarks), read_any_map),
        "tagslam.yaml": (map_to_tagslam(landmarks), read_any_map),
        "field.json": (map_to_wpilib(landmarks, (8.0, 5.0)), read_any_map),
        "floor.yaml": (floor, read_floor),
        "template.toml": (template, lambda path: load_template(str(path))),
        "corners.json": (
            '{"format": "lmkit-corners/1", "board": "chessboard:9x6:25mm", "image_size": [640, 480], "pairs": []}',
            read_corners,
        ),
        "manifest.json": ('{"format": "lmkit-prints/1", "lmkit": "0", "landmarks": []}', read_manifest),
        "poses.tum": (pose, read_trajectory),
        "odometry.csv": ("time_s,x_m,y_m,heading_rad\n0,1,2,3\n1,2,3,4\n", read_odometry),
        "gyro.csv": ("time_s,rate_radps\n0,1\n1,2\n", read_gyro),
        "detections.csv": (
            f"time_s,camera,code,x0,y0,x1,y1,x2,y2,x3,y3\n0,left,3,{corners}\n",
            lambda path: read_detections(path, ["lm8"]),
        ),
        "readings.csv": ("time_s,code,range_m,bearing_rad\n0,3,1.5,0.1\n", lambda p: read_readings(p, ["lm8"])),
    }  # fmt: skip


def fuzz(folder: Path, count: int, seed: int) -> dict[str, int]:
    """Harm texts ``count`` times and read them; whatever else than an answer or InputError is raised goes through.

    Returns:
        numbers of texts read and refused.
    """
    rng = random.Random(seed)
    seeds = _seeds(folder)
    counts = {"read": 0, "refused": 0}
    for _ in range(count):
        name = rng.choice(sorted(seeds))
        text, read = seeds[name]
        path = folder / name
        path.write_bytes(harm_text(text, rng).encode("utf-8", "surrogatepass"))
        try:
            read(path)
            counts["read"] += 1
        except InputError:
            counts["refused"] += 1
        except Exception as error:
            raise AssertionError(f"{name}: {path.read_bytes()[:3000]!r}") from error
    return counts


@pytest.mark.filterwarnings("ignore::lmkit.errors.InputWarning")
def test_harmed_files_are_read_or_refused(tmp_path):
    counts = fuzz(tmp_path, 2000, 1)
    assert min(counts.values()) > 100


SVG = '<svg xmlns="http://www.w3.org/2000/svg">{}</svg>'


@pytest.mark.parametrize(
    ("body", "code"),
    [
        ("<g>" * 5000 + "</g>" * 5000, "svg_too_large"),
        ('<path d="M0 0' + "h1v1" * 150_000 + '"/>', "svg_too_large"),
        ('<line x1="1e400" x2="3"/>', "svg_too_large"),
        ('<line x1="1e300" x2="3"/>', "svg_too_large"),
        ('<rect width="100%" height="100%"/>', "no_walls"),
        ('<g style="display:none"><line x2="3"/></g>', "no_walls"),
        ('<g visibility="hidden"><line x2="3"/></g>', "no_walls"),
    ],
    ids=lambda value: str(value)[:24],
)
def test_drawings_that_hold_no_walls_or_too_many_are_refused(tmp_path, body, code):
    path = tmp_path / "floor.svg"
    path.write_text(SVG.format(body))
    with pytest.raises(InputError) as caught:
        read_svg_lines(path)
    assert caught.value.code == code


def test_a_template_of_more_than_a_megabyte_is_refused(tmp_path):
    from lmkit.io.template import load_template

    (tmp_path / "big.toml").write_text('format = "lmkit-template/1"\n' + "[[texts]]\n" * 120_000)
    with pytest.raises(InputError, match="larger than 1 MiB"):
        load_template(str(tmp_path / "big.toml"))
