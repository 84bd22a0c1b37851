"""Maps of WPILib and TagSLAM."""

import json
from dataclasses import replace

import numpy as np
import pytest

from lmkit.errors import InputError
from lmkit.io.external_maps import has_correlations, map_to_tagslam, map_to_wpilib, read_any_map
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import LandmarkMap
from lmkit.simulation.recording import make_drive


def test_maps_come_back(tmp_path):
    landmarks = make_drive(0, seconds=3).landmarks
    for text in (map_to_wpilib(landmarks, (8.0, 5.0)), map_to_tagslam(landmarks)):
        path = tmp_path / "map"
        path.write_text(text)
        back = read_any_map(path)
        for m in landmarks:
            found = back.find(LandmarkId("tag36h11", m.code))
            assert pytest.approx(m.T_map_landmark.R, abs=1e-9) == found.T_map_landmark.R
            assert found.T_map_landmark.t == pytest.approx(m.T_map_landmark.t, abs=1e-9)


def test_correlations_that_a_tagslam_file_loses_are_seen():
    """Standard deviations along the landmark's own axes are kept; a covariance of another shape is not."""
    first, *_ = make_drive(0, seconds=3).landmarks
    turn = np.kron(np.eye(2), first.T_map_landmark.R)
    own = np.diag([1e-6, 4e-6, 9e-6, 1e-6, 1e-6, 1e-5])
    correlated = own.copy()
    correlated[0, 4] = correlated[4, 0] = 5e-7
    maps = [LandmarkMap([replace(first, covariance=turn @ C @ turn.T)]) for C in (own, correlated)]
    assert [has_correlations(landmarks) for landmarks in maps] == [False, True]
    assert not has_correlations(LandmarkMap([first]))


@pytest.mark.parametrize("key", ["tags", "field-tags"])
def test_a_field_tag_without_rotation_looks_along_x(tmp_path, key):
    """In WPILib, a tag's x axis points out of its face; in lmkit, it is z."""
    pose = {
        "translation": {"x": 1.0, "y": 2.0, "z": 0.5},
        "rotation": {"quaternion": {"W": 1.0, "X": 0.0, "Y": 0.0, "Z": 0.0}},
    }
    path = tmp_path / "field.json"
    size = {"length": 16.5, "width": 8.0}
    path.write_text(json.dumps({key: [{"ID": 4, "pose": pose}], "field": size, "field-dimensions": size}))
    T = read_any_map(path).find(LandmarkId("tag36h11", 4)).T_map_landmark
    assert T.R[:, 2] == pytest.approx([1, 0, 0])
    assert T.R[:, 1] == pytest.approx([0, 0, 1])
    assert np.linalg.det(T.R) == pytest.approx(1)


@pytest.mark.parametrize(
    "text",
    ['{"tags": [{"ID": 1}]}', '{"tags": []}', "{]", "bodies:\n- a: {is_static: true, tags: [{id: 3, pose: {}}]}\n"],
)
def test_broken_ones_are_refused(tmp_path, text):
    path = tmp_path / "map"
    path.write_text(text)
    with pytest.raises(InputError):
        read_any_map(path)
