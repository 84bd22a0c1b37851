"""Maps of square markers of other programs, made here with known poses."""

from __future__ import annotations

import json

import numpy as np
import pytest

from lmkit.errors import InputError
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
    with pytest.raises(InputError, match="neither the markers' family nor their size"):
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
