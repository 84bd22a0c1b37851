"""Rig and map files survive a round trip, and errors in them are named with their key."""

from __future__ import annotations

import numpy as np
import pytest
from ids import lm8

from lmkit.errors import InputError
from lmkit.io.landmark_map import map_to_yaml, read_map
from lmkit.io.rig import read_rig, rig_to_yaml
from lmkit.model.landmark_map import LandmarkMap, MappedLandmark, wall_pose
from lmkit.simulation.scene import make_rig

RIG = rig_to_yaml(make_rig())
MAP = map_to_yaml(
    LandmarkMap(
        [
            MappedLandmark(lm8(3), 0.18, wall_pose([1.0, 0.0, 1.5], 0.3), 1e-4 * np.eye(6)),
            MappedLandmark(lm8(9), 0.09, wall_pose([2.0, 0.0, 1.5], 1.3)),
        ]
    )
)


def test_a_rig_survives(tmp_path):
    path = tmp_path / "rig.yaml"
    path.write_text(RIG)
    rig, original = read_rig(path), make_rig()
    assert np.array_equal(rig.left.K, original.left.K)
    assert np.array_equal(rig.right.distortion, original.right.distortion)
    assert np.array_equal(rig.T_right_left.t, original.T_right_left.t)


def test_a_map_survives(tmp_path):
    path = tmp_path / "map.yaml"
    path.write_text(MAP)
    landmarks = read_map(path)
    assert len(landmarks) == 2
    found = landmarks.find(lm8(3))
    assert found is not None
    assert np.allclose(found.T_map_landmark.R, wall_pose([1.0, 0.0, 1.5], 0.3).R)
    assert np.allclose(found.T_map_landmark.t, [1.0, 0.0, 1.5])
    assert np.allclose(found.covariance, 1e-4 * np.eye(6))


@pytest.mark.parametrize(
    ("old", "new", "named"),
    [
        ("model: pinhole", "model: pinhole\n  lens: big", "left.lens: unknown key"),
        ("  image_size: [640, 480]\n", "", "left.image_size: missing"),
        ("model: pinhole", "model: telescope", "left.model"),
        ("lmkit-rig/1", "lmkit-rig/9", "lmkit-rig/9"),
        ("[0.0, 0.0, 1.0]", "[0.0, 0.0, .nan]", "left.K[2][2] is nan"),
        ("[0.0, 0.0, 1.0]", "[0.0, 0.0, .inf]", "left.K[2][2] is inf"),
        ("[0.0, 0.0, 1.0]", "[0.0, 0.0, 2.0]", "left: K is not a camera matrix"),
        ("[0.0, 0.0, 1.0]", "[0.0, 0.0]", "left.K[2]"),
        ("right:", "left:", "duplicate key"),
        ("left:", "left: [", "line"),
    ],
)
def test_what_is_wrong_in_a_rig_file_is_named(old, new, named, tmp_path):
    path = tmp_path / "rig.yaml"
    path.write_text(RIG.replace(old, new, 1))
    with pytest.raises(InputError) as caught:
        read_rig(path)
    assert named in caught.value.message
    assert str(path) in caught.value.message
    assert caught.value.hint


@pytest.mark.parametrize(
    ("old", "new", "named"),
    [
        ("code: 9", "code: 3", "twice"),
        ("code: 9", "code: 256", "landmarks[1].code"),
        ("code: 9", "code: -1", "landmarks[1].code"),
        ("size_m: 0.09", "size_m: 0", "landmarks[1].size_m"),
        ("size_m: 0.09", "size_m: .nan", "landmarks[1].size_m is nan"),
        ("size_m: 0.09", "size_m: 0.09\n  color: red", "landmarks[1].color: unknown key"),
        ("quaternion: [", "quaternion: [5, ", "landmarks[0].quaternion"),
        ("frame: map", "frame: odom", "frame"),
    ],
)
def test_what_is_wrong_in_a_map_file_is_named(old, new, named, tmp_path):
    path = tmp_path / "map.yaml"
    path.write_text(MAP.replace(old, new, 1))
    with pytest.raises(InputError) as caught:
        read_map(path)
    assert named in caught.value.message


def test_a_yaml_file_cannot_run_code(tmp_path):
    path = tmp_path / "rig.yaml"
    path.write_text("format: !!python/object/apply:os.system ['true']\n")
    with pytest.raises(InputError):
        read_rig(path)


def test_a_maps_covariance_is_one(tmp_path):
    path = tmp_path / "map.yaml"
    path.write_text(MAP.replace("0.0001", "-0.0001"))
    with pytest.raises(InputError, match=r"landmarks\[\d\].covariance: not symmetric, or negative"):
        read_map(path)
