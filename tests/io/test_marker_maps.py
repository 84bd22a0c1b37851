"""Maps of square markers of other programs, made here with known poses."""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest

from lmkit.errors import InputError, InputWarning
from lmkit.io.external_maps import map_to_wpilib, read_any_map
from lmkit.io.marker_maps import MarkerDefaults
from lmkit.model.landmark_id import LandmarkId
from lmkit.simulation.recording import make_drive

ANSWER = MarkerDefaults("aruco5x5_1000", 0.14)


def written(folder, text: str):
    path = folder / "map"
    path.write_text(text)
    return path


def test_fiducial_slam(tmp_path):
    """Roll, pitch and yaw about fixed axes; family and size must be given."""
    path = written(tmp_path, "11 -0.5 0.8 2.0 180.0 -0.0 0.0 0.001 10\n12 1 2 3 90 0 90 0.001 10 11\n")
    found = read_any_map(path, ANSWER)
    ceiling = found.find(LandmarkId("aruco5x5_1000", 11)).T_map_landmark
    assert pytest.approx(np.diag([1.0, -1.0, -1.0])) == ceiling.R
    wall = found.find(LandmarkId("aruco5x5_1000", 12)).T_map_landmark
    assert wall.R[:, 1] == pytest.approx([0, 0, 1])
    assert wall.R[:, 2] == pytest.approx([1, 0, 0])
    with pytest.raises(InputError, match="neither the family nor the size"):
        read_any_map(path)
    for wrong in ("-0..5 0 0 0 0 0", "0 0 0 1e308 0 0"):
        with pytest.raises(InputError, match="line 2 is not a marker"):
            read_any_map(written(tmp_path, f"11 0 0 0 0 0 0 0.001 10\n12 {wrong} 0.001 10\n"), ANSWER)


def test_a_bundle_of_apriltag_ros(tmp_path):
    tag = "{id: 23, size: 0.5, x: 1.0, y: 0.0, z: 0.0, qw: 1.0, qx: 0.0, qy: 0.0, qz: 0.0}"
    bundle = f"{{name: a, layout: [{tag}]}}"
    found = read_any_map(written(tmp_path, f"tag_bundles: [{bundle}]\n"))
    assert found.find(LandmarkId("tag36h11", 23)).size_m == 0.5
    for text in (f"tag_bundles: [{bundle}, {bundle}]\n", "standalone_tags: [{id: 1, size: 0.2}]\n"):
        with pytest.raises(InputError, match=r"apriltag_ros holds (2 bundles|no tag)"):
            read_any_map(written(tmp_path, text))


def test_a_field_map_of_limelight_is_as_the_same_layout_of_wpilib(tmp_path):
    turn = np.eye(4)
    turn[:3, :3] = [[-0.5, -np.sqrt(0.75), 0], [np.sqrt(0.75), -0.5, 0], [0, 0, 1]]
    turn[:3, 3] = 6.8, -3.9, 1.4
    tag = {"family": "apriltag3_36h11_classic", "id": 1, "size": 165.1, "transform": turn.ravel().tolist()}
    found = read_any_map(written(tmp_path, json.dumps({"fiducials": [tag], "type": "frc"})))
    quaternion = {"W": 0.5, "X": 0.0, "Y": 0.0, "Z": float(np.sqrt(0.75))}
    pose = {"translation": {"x": 6.8, "y": -3.9, "z": 1.4}, "rotation": {"quaternion": quaternion}}
    same = read_any_map(written(tmp_path, json.dumps({"tags": [{"ID": 1, "pose": pose}]})))
    (a,), (b,) = found, same
    assert a.T_map_landmark.matrix == pytest.approx(b.T_map_landmark.matrix, abs=1e-9)
    assert a.size_m == pytest.approx(0.1651)
    with pytest.raises(InputError, match="not a field map of Limelight"):
        read_any_map(written(tmp_path, json.dumps({"fiducials": [tag | {"transform": [1, 2]}]})))


def test_a_map_of_marker_mapper(tmp_path):
    head = "%YAML:1.0\n---\naruco_bc_dict: ARUCO_MIP_36h12\naruco_bc_nmarkers: 1\naruco_bc_mInfoType: 1\n"
    corners = "[ [ 1.0, -0.1, 1.6 ], [ 1.0, 0.1, 1.6 ], [ 1.0, 0.1, 1.4 ], [ 1.0, -0.1, 1.4 ] ]"
    text = f"{head}aruco_bc_markers:\n   - {{ id:7, corners:{corners} }}\n"
    found = read_any_map(written(tmp_path, text)).find(LandmarkId("aruco_mip_36h12", 7))
    assert found.size_m == pytest.approx(0.2)
    assert found.T_map_landmark.t == pytest.approx([1.0, 0.0, 1.5])
    assert pytest.approx(np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0]])) == found.T_map_landmark.R
    with pytest.raises(InputError, match="pixels"):
        read_any_map(written(tmp_path, text.replace("mInfoType: 1", "mInfoType: 0")))


def test_family_and_size_that_are_stated_hold_for_a_field_layout(tmp_path):
    landmarks = make_drive(0, seconds=3).landmarks
    path = written(tmp_path, map_to_wpilib(landmarks, (8.0, 5.0)))
    found = read_any_map(path, MarkerDefaults("aruco5x5_1000", 0.1524))
    assert {(m.family, m.size_m) for m in found} == {("aruco5x5_1000", 0.1524)}


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"size": 0.1651}, "tag 1 of 0.1651 mm, which no tag is"),
        ({"transform": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 4, 5, 6, 1]}, "by columns"),
        ({"family": "apriltag3_41h12_standard"}, "is unknown"),
    ],
)
def test_field_maps_in_other_units_and_orders_are_refused(tmp_path, change, match):
    tag = {"family": "36h11", "id": 1, "size": 165.1, "transform": np.eye(4).ravel().tolist()}
    with pytest.raises(InputError, match=match):
        read_any_map(written(tmp_path, json.dumps({"fiducials": [tag | change]})))


@pytest.mark.parametrize("place", [{"x": 593.7, "y": 9.7, "z": 53.4}, {"x": 1.0, "y": 6808.0, "z": 1.5}])
def test_a_layout_in_inches_or_millimeters_is_named(tmp_path, place):
    quaternion = {"W": 1.0, "X": 0.0, "Y": 0.0, "Z": 0.0}
    tags = [
        {"ID": k, "pose": {"translation": at, "rotation": {"quaternion": quaternion}}}
        for k, at in enumerate(({"x": 0.0, "y": 0.0, "z": 1.0}, place))
    ]
    with pytest.warns(InputWarning, match="inches or millimeters"):
        read_any_map(written(tmp_path, json.dumps({"tags": tags, "family": "tag36h11", "size": 0.1651})))


def test_what_is_no_map_is_named(tmp_path):
    parameters = "/**:\n  ros__parameters:\n    family: 36h11\n    size: 0.173\n"
    for text, match in ((parameters, "parameters of a ROS 2 node"), ("1 2 3\n", "no keys"), ("a: 1\n", "keys are a")):
        with pytest.raises(InputError, match=match):
            read_any_map(written(tmp_path, text))


def test_a_map_of_marker_mapper_by_opencvs_own_writer(tmp_path):
    storage = cv2.FileStorage(str(tmp_path / "map.yml"), cv2.FILE_STORAGE_WRITE)
    storage.write("aruco_bc_dict", "ARUCO_MIP_36h12")
    storage.write("aruco_bc_mInfoType", 1)
    storage.startWriteStruct("aruco_bc_markers", cv2.FileNode_SEQ)
    for k in range(2):
        storage.startWriteStruct("", cv2.FileNode_MAP | cv2.FileNode_FLOW)
        storage.write("id", k)
        storage.startWriteStruct("corners", cv2.FileNode_SEQ | cv2.FileNode_FLOW)
        for y, z in ((-0.1, 1.6), (0.1, 1.6), (0.1, 1.4), (-0.1, 1.4)):
            storage.startWriteStruct("", cv2.FileNode_SEQ | cv2.FileNode_FLOW)
            for value in (1.0 / 3, y + k, z):
                storage.write("", value)
            storage.endWriteStruct()
        storage.endWriteStruct()
        storage.endWriteStruct()
    storage.endWriteStruct()
    storage.release()
    found = read_any_map(tmp_path / "map.yml")
    assert [m.T_map_landmark.t.tolist() for m in found] == [pytest.approx([1 / 3, k, 1.5]) for k in range(2)]


def test_a_fiducial_map_of_more_markers_than_a_family_has_is_refused_at_once(tmp_path):
    (tmp_path / "map.txt").write_text("1 0 0 0 0 0 0 0.1 1\n" * 20_002)
    with pytest.raises(InputError, match="more than 20000 markers"):
        read_any_map(tmp_path / "map.txt", MarkerDefaults("aruco5x5_1000", 0.1))
