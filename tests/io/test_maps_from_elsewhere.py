"""Maps whose keys change what their numbers mean."""

from __future__ import annotations

import json

import pytest
import yaml

from lmkit.errors import InputError
from lmkit.io.external_maps import map_to_wpilib, read_any_map
from lmkit.io.landmark_map import map_to_yaml
from lmkit.model.landmark_id import LandmarkId
from lmkit.simulation.recording import make_drive

LANDMARKS = make_drive(0, seconds=3).landmarks
TAG = {"position": {"x": 1.0, "y": 0.0, "z": 1.5}, "rotation": {"x": 0.0, "y": 0.0, "z": 0.0}}


def file(folder, data: object):
    path = folder / "map"
    path.write_text(json.dumps(data))
    return path


def test_the_format_key_decides_before_anything_else(tmp_path):
    path = file(tmp_path, yaml.safe_load(map_to_yaml(LANDMARKS)))
    assert [m.id for m in read_any_map(path)] == [m.id for m in LANDMARKS]


def test_a_layout_that_names_its_tags_is_believed(tmp_path):
    layout = json.loads(map_to_wpilib(LANDMARKS, (8.0, 5.0)))
    code = layout["tags"][0]["ID"]
    found = read_any_map(file(tmp_path, layout | {"family": "tag16h5", "size": 0.1524}))
    assert found.find(LandmarkId("tag16h5", code)).size_m == 0.1524
    for wrong in ({"family": "qr"}, {"size": -1}, {"size": 152.4}):
        with pytest.raises(InputError, match="unknown"):
            read_any_map(file(tmp_path, layout | wrong))


def test_a_tagslam_bodys_own_pose_is_applied(tmp_path):
    pose = {"position": {"x": 4.0, "y": 1.0, "z": 0.0}, "rotation": {"x": 0.0, "y": 0.0, "z": 1.5707963267948966}}
    body = {"is_static": True, "default_tag_size": 0.2, "pose": pose, "tags": [{"id": 4, "pose": TAG}]}
    moving = {"is_static": False, "default_tag_size": 0.2, "tags": [{"id": 9, "pose": TAG}]}
    found = read_any_map(file(tmp_path, {"bodies": [{"lab": body}, {"cart": moving}]}))
    assert len(found) == 1
    T = found.find(LandmarkId("tag36h11", 4)).T_map_landmark
    assert T.t == pytest.approx([4.0, 2.0, 1.5])
    assert T.R[:, 0] == pytest.approx([0, 1, 0])
