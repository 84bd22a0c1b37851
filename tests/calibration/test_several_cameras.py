"""Three cameras in a row: neighbors see the board together, the outer ones never do."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from board_views import BOARD

from lmkit.calibration.mono import calibrate_camera
from lmkit.calibration.several_cameras import calibrate_rig
from lmkit.errors import InputError
from lmkit.geometry.pose import Pose
from lmkit.geometry.rotations import rotation_log
from lmkit.model.observation import BoardObservation
from lmkit.reports.rig_calibration import rig_calibration_report, rig_calibration_summary
from lmkit.simulation.scene import board_poses, make_rig

STEREO = make_rig()
CAMERA = STEREO.left
IDS = np.arange(len(BOARD.object_points))
STEP = Pose("camera", "camera", STEREO.T_right_left.R, STEREO.T_right_left.t)


def simulated(seed: int, order=(0, 1, 2)):
    """Corners of every camera by frame; the first frames are seen by cameras 0 and 1, the others by 1 and 2."""
    rng = np.random.default_rng(seed)
    seen = [{}, {}, {}]
    for first in (0, 1):
        for k, pose in enumerate(board_poses(seed + first, STEREO, BOARD, 20)):
            points = pose.apply(BOARD.object_points)
            for camera, there in ((first, points), (first + 1, STEP.apply(points))):
                pixels = CAMERA.project(there) + rng.normal(0, 0.1, (len(points), 2))
                seen[camera][f"{first}{k:02d}"] = BoardObservation(IDS, pixels)
    return [seen[k] for k in order]


def calibrated(seen):
    cameras = [calibrate_camera(list(views.items()), BOARD, CAMERA.image_size, "pinhole") for views in seen]
    return calibrate_rig(["a", "b", "c"], cameras, seen, BOARD)


@lru_cache
def calibrated_in(order):
    return calibrated(simulated(3, order))


@pytest.mark.parametrize(
    "order", [(1, 0, 2), *(pytest.param(o, marks=pytest.mark.slow) for o in ((0, 1, 2), (2, 1, 0)))]
)
def test_cameras_that_share_no_view_are_tied_by_the_one_between(order):
    result = calibrated_in(order)
    T = [Pose.identity("camera", "camera"), STEP, STEP @ STEP]
    for k, camera in enumerate(result.rig.cameras[1:], start=1):
        true = T[order[k]] @ T[order[0]].inverse()
        shift = np.linalg.norm(camera.T_camera_left.t - true.t)
        turn = np.linalg.norm(rotation_log(camera.T_camera_left.R @ true.R.T))
        sigma = np.sqrt(np.diag(camera.covariance))
        assert shift < min(0.002, 4 * np.linalg.norm(sigma[:3]))
        assert turn < min(np.deg2rad(0.1), 4 * np.linalg.norm(sigma[3:]))
    assert len(result.ties) == 2
    assert result.rms_px == pytest.approx((0.14,) * 3, abs=0.02)


def test_a_camera_that_shares_nothing_is_named():
    seen = simulated(3)
    seen[2] = {f"z{name}": corners for name, corners in seen[2].items()}
    with pytest.raises(InputError, match="cameras c share fewer than 3 views"):
        calibrated(seen)


def test_the_report_names_every_camera_and_what_is_wrong():
    result = calibrated_in((1, 0, 2))
    text = rig_calibration_report(result, BOARD)
    for words in ("Lens of a", "Lens of b", "Lens of c", "a - b", "a - c", "Good fit, 1 warning."):
        assert words in text
    assert text.count("100 times longer") == 3
    assert rig_calibration_summary(replace(result, rms_px=(0.5, *result.rms_px[1:])))[1] == (
        "The cameras do not agree."
    )
    few = (replace(result.cameras[0], held_out_px=None), *result.cameras[1:])
    assert rig_calibration_summary(replace(result, cameras=few))[0] == "poor"


def test_one_camera_has_a_report_without_words_about_others():
    order = 1, 0, 2
    result = calibrate_rig(["a"], calibrated_in(order).cameras[:1], simulated(3, order)[:1], BOARD)
    text = rig_calibration_report(result, BOARD)
    assert "Calibration of one camera" in text
    assert "1 camera, " in text
    assert result.ties == ()
    assert result.rms_px[0] == pytest.approx(result.cameras[0].rms_px, rel=0.02)
    for words in ("joint", "others", "worst camera", "Places of the cameras", "a: the"):
        assert words not in text
