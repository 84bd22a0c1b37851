"""Is an old calibration still valid?  Rigs that were bumped, lenses that were turned, and unchanged rigs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from board_views import BOARD, views

from lmkit.calibration.rig_check import check_rig
from lmkit.errors import InputError
from lmkit.geometry.camera import CameraModel
from lmkit.geometry.pose import Pose
from lmkit.geometry.rotations import rotation_exp
from lmkit.geometry.stereo_rig import StereoRig
from lmkit.model.landmark import LM8
from lmkit.model.observation import PairView
from lmkit.simulation.scene import make_rig


def bumped(turn_deg=(0.0, 0.0, 0.0), focal=1.0) -> StereoRig:
    """The rig with its right camera turned, its left lens zoomed."""
    rig = make_rig()
    R = rotation_exp(np.deg2rad(turn_deg)) @ rig.T_right_left.R
    K = rig.left.K * np.array([[focal, 1, 1], [1, focal, 1], [1, 1, 1]])
    left = CameraModel(rig.left.image_size, K, rig.left.distortion)
    return replace(rig, left=left, T_right_left=Pose("right", "left", R, rig.T_right_left.t))


def landmarks(rig: StereoRig, count: int = 25, noise: float = 0.15) -> list[PairView]:
    """Landmarks seen in ordinary driving, 1 to 3 m ahead."""
    rng = np.random.default_rng(3)
    points = LM8.object_points(0.18)
    seen = []
    while len(seen) < count:
        R = rotation_exp(np.array([0, rng.uniform(-0.7, 0.7), 0])) @ np.diag([1.0, -1.0, -1.0])
        z = rng.uniform(1, 3)
        in_left = points @ R.T + [rng.uniform(-0.4, 0.4) * z, rng.uniform(-0.3, 0.3) * z, z]
        in_right = in_left @ rig.T_right_left.R.T + rig.T_right_left.t
        pixels = [rig.left.project(in_left), rig.right.project(in_right)]
        if all(c.contains(p).all() for c, p in zip((rig.left, rig.right), pixels, strict=True)):
            left, right = (p + rng.normal(0, noise, p.shape) for p in pixels)
            seen.append(PairView(f"{len(seen)}", np.arange(4), left, np.arange(4), right))
    return seen


@pytest.mark.parametrize("seed", range(8))
def test_a_rig_left_alone_is_still_true(seed):
    checked = check_rig(make_rig(), BOARD.object_points, views(10, 0.15, seed))
    assert checked.state == "true"
    assert checked.contradicted == ()


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_bump_is_found_with_its_size(axis):
    turn = np.zeros(3)
    turn[axis] = 0.3
    checked = check_rig(make_rig(), BOARD.object_points, views(12, 0.1, 1, bumped(tuple(turn))))
    assert checked.state == "moved"
    assert np.allclose(checked.turn_deg, turn, atol=5 * checked.turn_sigma_deg.max() + 0.01)
    assert ("pitched", "yawed", "rolled")[axis] in checked.sentence


def test_a_turned_lens_is_found():
    checked = check_rig(make_rig(), BOARD.object_points, views(15, 0.1, 1, bumped(focal=1.02)))
    assert checked.state == "lenses"
    assert checked.focal_change[0] == pytest.approx(0.02, abs=0.003)
    assert abs(checked.focal_change[1]) < 0.003
    assert "focal" in checked.sentence


def test_landmarks_of_an_ordinary_drive_tell_a_bump():
    points = LM8.object_points(0.18)
    still = check_rig(make_rig(), points, landmarks(make_rig()), lenses=False)
    assert still.state == "true"
    pitched = check_rig(make_rig(), points, landmarks(bumped((0.3, 0, 0))), lenses=False)
    assert pitched.state == "moved"
    assert pitched.turn_deg[0] == pytest.approx(0.3, abs=0.05)


@pytest.mark.slow
def test_a_pair_of_different_times_does_not_speak_for_a_moved_rig():
    seen = views(12, 0.1)
    seen[4] = replace(seen[4], right=seen[5].right)
    checked = check_rig(make_rig(), BOARD.object_points, seen)
    assert checked.state == "true"
    assert checked.contradicted == ("04",)


def test_three_views_are_too_few():
    with pytest.raises(InputError, match="at least 5"):
        check_rig(make_rig(), BOARD.object_points, views(3, 0.1))


@pytest.mark.parametrize("degrees", [1.0, 4.0])
def test_no_view_is_blamed_for_a_bump(degrees):
    """Small far boards have two poses in one camera; the old relation confirms the wrong one."""
    seen = views(20, 0.3, 4, bumped((0.0, degrees, 0.0)))
    checked = check_rig(make_rig(), BOARD.object_points, seen)
    assert checked.contradicted == ()
    assert checked.turn_deg[1] == pytest.approx(degrees, abs=0.05)
