"""Files as users have them: the list of reported files with their tests, and tests that have no other place.

Each row stands for a kind of file that ROS, OpenCV, Kalibr, WPILib, TagSLAM, evo and nav2 users reported.
"""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from command_line import Answer, run_command

from lmkit.demos.example_files import FLOOR
from lmkit.errors import InputError
from lmkit.io.landmark_map import map_to_yaml
from lmkit.io.recording_tables import detections_to_csv, gyro_to_csv, odometry_to_csv
from lmkit.io.rig import rig_to_yaml
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import LandmarkMap
from lmkit.simulation.recording import make_drive

TESTS = Path(__file__).parents[1]
HERE = "cli/test_user_files.py"
RIGS, MAPS, TABLES = (f"io/test_{kind}_from_elsewhere.py" for kind in ("rigs", "maps", "tables"))
ROWS = {
    "ground truth of EuRoC and TUM-VI": (
        f"{TABLES}::test_a_trajectory_is_the_same_in_every_dress",
        f"{HERE}::test_ground_truth_with_w_first_is_equal_to_an_estimate_in_ns",
    ),
    "a trajectory in ns as a bag": (f"{HERE}::test_a_trajectory_in_ns_becomes_a_bag_or_leaves_nothing",),
    "equal stamps, CRLF and byte order marks": (
        f"{TABLES}::test_what_is_wrong_in_a_trajectory_is_named",
        f"{TABLES}::test_a_trajectory_is_the_same_in_every_dress",
        f"{HERE}::test_a_byte_order_mark_and_crlf_are_read_in_every_text_file",
    ),
    "maps of map_server and nav2": (
        "io/test_ros_maps.py::test_every_mode_gives_the_same_floor",
        "io/test_ros_maps.py::test_a_rotated_origin_rotates_floor_and_walls",
    ),
    "camera_info as ROS writes it": (f"{RIGS}::test_camera_info_as_ros_tools_write_it",),
    "rigs that no camera can be": (
        f"{RIGS}::test_what_no_rig_can_be_is_refused_or_named_on_every_way_in",
        f"{RIGS}::test_camera_infos_of_swapped_cameras_are_named",
        f"{RIGS}::test_a_camera_info_without_stereo_calibration_is_refused",
    ),
    "rigs of OpenCV, Kalibr and OpenVINS": (
        f"{RIGS}::test_file_storage_in_xml_and_json",
        f"{RIGS}::test_opencv_matrices_by_other_names_and_a_byte_order_mark",
        f"{RIGS}::test_cameras_related_through_an_imu",
        f"{RIGS}::test_another_camera_model_is_named",
    ),
    "maps of other markers": (
        f"{MAPS}::test_family_and_size_are_given_or_assumed_aloud",
        f"{MAPS}::test_a_layout_that_names_its_tags_is_believed",
        f"{MAPS}::test_family_and_size_on_the_command_line_and_in_python",
        "io/test_marker_maps.py::test_fiducial_slam",
        "io/test_marker_maps.py::test_a_bundle_of_apriltag_ros",
    ),
    "TagSLAM bodies": (f"{MAPS}::test_a_tagslam_bodys_own_pose_is_applied",),
    "a lmkit map in JSON": (
        f"{MAPS}::test_the_format_key_decides_before_anything_else",
        f"{MAPS}::test_the_format_key_is_parsed_not_searched_for",
    ),
    "AprilTag detections": (f"{HERE}::test_detections_with_tag_ids_are_surveyed_as_landmarks_are",),
    "AprilTag's corner order": (
        "localization/test_contradiction.py::test_apriltags_corner_order_is_refused_by_name",
        f"{HERE}::test_apriltags_corner_order_is_refused_by_track",
    ),
    "readings of tags, of lm12, of another building": (
        f"{HERE}::test_readings_of_any_family_locate_track_and_plan",
        f"{HERE}::test_a_map_of_another_building_is_refused",
    ),
    "odometry and gyro in other units, signs and clocks": (
        "tracking/test_plausibility.py::test_a_fault_is_refused_by_name",
        f"{HERE}::test_tables_in_other_units_and_clocks_are_refused_by_track",
    ),
    "tables of Excel and rostopic": (f"{TABLES}::test_odometry_is_the_same_in_every_dress",),
    "floors drawn as SVG": (
        "io/test_svg.py::test_what_cannot_be_seen_is_no_wall",
        "io/test_svg.py::test_units_are_those_of_a_browser",
        "io/test_svg.py::test_a_door_is_an_arc_of_lines",
    ),
    "track without odometry": (
        "tracking/test_track.py::test_cameras_are_tracked_without_odometry",
        f"{HERE}::test_track_without_odometry",
    ),
}
TUM = "".join(f"{1520530308.25 + k / 4:.2f} {k} 2 3 0.1 0.2 0.3 0.9273618495495703\n" for k in range(4))
NS = "".join(f"{1520530308250000000 + k * 250000000} {k} 2 3 0.1 0.2 0.3 0.9273618495495703\n" for k in range(4))
EUROC = "#timestamp [ns], p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z []\n"
EUROC += "".join(f"{1520530308250000000 + k * 250000000},{k},2,3,0.9273618495495703,0.1,0.2,0.3\n" for k in range(4))


def test_each_row_names_tests_that_exist():
    assert len(ROWS) == 17
    for row, names in ROWS.items():
        for name in names:
            path, _, function = name.partition("::")
            assert re.search(rf"^def {function}\(", (TESTS / path).read_text(), re.MULTILINE), (row, name)


@pytest.fixture(scope="module")
def drive():
    return make_drive(3, seconds=8.0, size_m=(8.0, 5.0))


def of_family(landmarks: LandmarkMap, family: str) -> LandmarkMap:
    """Landmarks at the places of others, with codes of another family."""
    from dataclasses import replace

    return LandmarkMap([replace(m, id=LandmarkId(family, k)) for k, m in enumerate(landmarks)])


@pytest.fixture
def folder(tmp_path, drive, monkeypatch) -> Path:
    """Files of a recording, in the working folder."""
    readings = [(t, r) for t, seen in drive.readings(3) for r in seen]
    codes = {m.id: k for k, m in enumerate(drive.landmarks)}
    rows = [f"{t:.3f},{codes[r.id]},{r.range_m:.4f},{r.bearing_rad:.5f}" for t, r in readings]
    texts = {
        "rig.yaml": rig_to_yaml(drive.rig),
        "map.yaml": map_to_yaml(drive.landmarks),
        "map_tags.yaml": map_to_yaml(drive.landmarks).replace("lm8", "tag36h11"),
        "floor.yaml": FLOOR.format(8.0, 5.0),
        "detections.csv": detections_to_csv(drive.frames),
        "odometry.csv": odometry_to_csv(drive.odometry),
        "gyro.csv": gyro_to_csv(drive.gyro),
        "readings.csv": "\n".join(["time_s,code,range_m,bearing_rad", *rows]) + "\n",
    }
    for name, text in texts.items():
        (tmp_path / name).write_text(text)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def run(words: str, code: int = 0) -> Answer:
    answer = run_command(*words.split())
    assert answer.code == code, answer.err
    return answer


def as_tags(folder: Path, order=(0, 1, 2, 3)) -> None:
    """Write the detections as AprilTags, with corners in another order."""
    head, *rows = (folder / "detections.csv").read_text().splitlines()
    names = head.split(",")
    first, family = names.index("x0"), names.index("family") if "family" in names else None
    cells = [row.split(",") for row in rows]
    for row in cells:
        corners = np.array(row[first : first + 8]).reshape(4, 2)
        row[first : first + 8] = corners[list(order)].ravel().tolist()
    keep = [k for k in range(len(names)) if k != family]
    head = ",".join("tag_id" if names[k] == "code" else names[k] for k in keep)
    (folder / "tags.csv").write_text("\n".join([head, *(",".join(row[k] for k in keep) for row in cells)]) + "\n")


def test_ground_truth_with_w_first_is_equal_to_an_estimate_in_ns(folder):
    (folder / "data.csv").write_text(EUROC)
    (folder / "ns.tum").write_text(NS)
    errors = json.loads(run("evaluate data.csv ns.tum --json").out)
    assert errors["pairs"] == 4
    assert (errors["position_m"]["max"], errors["rotation_deg"]["max"]) == pytest.approx((0, 0), abs=1e-5)


def test_a_trajectory_in_ns_becomes_a_bag_or_leaves_nothing(folder):
    """Without the extra `bags`, one line says that it is missing."""
    (folder / "ns.tum").write_text(NS)
    answer = run_command(*["convert", "ns.tum", "--to", "bag", "-o", "drive"])
    assert answer.code in (0, 2), answer.err
    # The file of messages had a name that begins with a dot.
    written = {"drive.db3", "metadata.yaml"} if answer.code == 0 else set()
    assert {path.name for path in (folder / "drive").glob("*")} == written
    assert len(answer.err.splitlines()) == (1 if answer.code else 0)


def test_a_byte_order_mark_and_crlf_are_read_in_every_text_file(folder):
    for path in folder.iterdir():
        path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes().replace(b"\n", b"\r\n"))
    (folder / "map.json").write_text("\ufeff" + json.dumps(json_map(folder)))
    files = "--rig rig.yaml --map map.json --odometry odometry.csv --gyro gyro.csv"
    assert '"ok"' in run(f"track --detections detections.csv {files} --json").out


def json_map(folder: Path) -> object:
    import yaml

    return yaml.safe_load((folder / "map.yaml").read_text("utf-8-sig"))


def test_detections_with_tag_ids_are_surveyed_as_landmarks_are(folder, drive):
    as_tags(folder)
    moved = "--rig rig.yaml --odometry odometry.csv --gyro gyro.csv"
    run(f"survey --detections tags.csv {moved} --known map_tags.yaml -o m.yaml")
    run(f"survey --detections detections.csv {moved} --known map.yaml -o lm.yaml")
    assert (folder / "m.yaml").read_text().replace("tag36h11", "lm8") == (folder / "lm.yaml").read_text()


def test_apriltags_corner_order_is_refused_by_track(folder):
    as_tags(folder, (3, 2, 1, 0))
    answer = run("track --detections tags.csv --rig rig.yaml --map map_tags.yaml", 2)
    assert "another order" in answer.err


@pytest.mark.parametrize("family", ["tag36h11", "lm12"])
def test_readings_of_any_family_locate_track_and_plan(folder, drive, family):
    (folder / "m.yaml").write_text(map_to_yaml(of_family(drive.landmarks, family)))
    assert '"ok"' in run("locate --readings readings.csv --map m.yaml --json").out
    assert '"ok"' in run("track --readings readings.csv --map m.yaml --odometry odometry.csv --json").out
    run("plan route 1,1 6,3 --floor floor.yaml --map m.yaml --rig rig.yaml")


def test_a_map_of_another_building_is_refused(folder, drive):
    other = [m for m in make_drive(4, seconds=2.0).landmarks if m.code >= len(drive.landmarks)]
    (folder / "m.yaml").write_text(map_to_yaml(LandmarkMap(other)))
    for words in ("locate --readings readings.csv", "track --readings readings.csv --odometry odometry.csv"):
        answer = run_command(*words.split(), "--map", "m.yaml")
        assert answer.code in (1, 2)
        assert "map" in answer.err
        assert len(answer.err.splitlines()) == 1


@pytest.mark.parametrize(
    ("name", "column", "change", "word"),
    [
        ("gyro", 1, lambda v: 57.2957795 * v, "degrees per second"),
        ("gyro", 0, lambda v: 1.7e9 + v, "clock"),
        ("odometry", 1, lambda v: -v, "backwards"),
        ("odometry", 1, lambda v: 1000 * v, "millimeters"),
    ],
)
def test_tables_in_other_units_and_clocks_are_refused_by_track(folder, name, column, change, word):
    head, *rows = (folder / f"{name}.csv").read_text().splitlines()
    cells = [row.split(",") for row in rows]
    for row in cells:
        row[column] = repr(change(float(row[column])))
    (folder / f"{name}.csv").write_text("\n".join([head, *map(",".join, cells)]) + "\n")
    moved = "--odometry odometry.csv --gyro gyro.csv"
    assert word in run(f"track --readings readings.csv --map {lm8_map(folder)} {moved}", 2).err
    if name == "gyro" or word == "millimeters":
        from lmkit.live.recorded_feed import motion_rows

        with pytest.raises(InputError, match=word):
            motion_rows(folder / "odometry.csv", folder / "gyro.csv")


def test_a_survey_of_several_recordings_of_readings_refuses_a_gyro_in_degrees(folder):
    head, *rows = (folder / "gyro.csv").read_text().splitlines()
    cells = [row.split(",") for row in rows]
    in_degrees = "\n".join([head, *(f"{time},{57.2957795 * float(rate)!r}" for time, rate in cells)]) + "\n"
    for day in ("one", "two"):
        (folder / day).mkdir()
        for name in ("readings.csv", "odometry.csv"):
            (folder / day / name).write_text((folder / name).read_text())
        (folder / day / "gyro.csv").write_text(in_degrees)
    assert "degrees per second" in run("survey one two --family lm8 -o joint.yaml", 2).err
    assert not (folder / "joint.yaml").exists()


def lm8_map(folder: Path) -> str:
    """A map for the readings, whose codes count from 0."""
    from lmkit.io.landmark_map import read_map

    (folder / "m.yaml").write_text(map_to_yaml(of_family(read_map(folder / "map.yaml"), "lm8")))
    return "m.yaml"


def test_track_without_odometry(folder):
    lines = run("track --detections detections.csv --rig rig.yaml --map map.yaml --json").out.splitlines()
    assert len(lines) > 16
    assert {json.loads(line)["status"] for line in lines} == {"ok"}
