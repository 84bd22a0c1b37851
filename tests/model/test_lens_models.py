"""Every row of LENS_MODELS: projection, derivatives, kernels, files and calibration support the model."""

from __future__ import annotations

import numpy as np
import pytest

from lmkit.calibration.initialization import MODELS
from lmkit.calibration.intrinsics import intrinsics_prior, intrinsics_vector, with_intrinsics
from lmkit.geometry.camera import CameraModel
from lmkit.geometry.lens_models import LENS_MODELS
from lmkit.geometry.pose import Pose
from lmkit.geometry.rig import MountedCamera, Rig
from lmkit.io.any_rig import read_any_rig
from lmkit.io.rig import rig_to_yaml
from lmkit.io.ros_camera_info import rig_to_camera_info
from lmkit.kernels.lens import corners_through_lens
from lmkit.localization.reprojection import lens_of

K = np.array([[420.0, 0, 318], [0, 425.0, 241], [0, 0, 1]])
POINTS = np.array([[0.3, -0.2, 1.1], [-0.5, 0.1, 1.4], [0.2, 0.35, 0.9], [0.01, -0.02, 2.0]])


def camera_of(name: str) -> CameraModel:
    lens = LENS_MODELS[name]
    distortion = np.random.default_rng(3).uniform(-0.03, 0.03, lens.fitted)
    distortion[[k for k, what in enumerate(lens.coefficients[: lens.fitted]) if what.startswith("p")]] /= 20
    return CameraModel((640, 480), K, distortion, name)


@pytest.fixture(params=LENS_MODELS)
def camera(request: pytest.FixtureRequest) -> CameraModel:
    return camera_of(request.param)


def test_a_row_is_whole(camera: CameraModel) -> None:
    lens = camera.lens
    assert lens.fitted in lens.counts
    assert len(lens.coefficients) == len(lens.powers) == max(lens.counts)
    assert lens.name in MODELS
    assert len(intrinsics_prior(camera)) == 4 + lens.fitted


def test_rays_lead_back_to_their_pixels(camera: CameraModel) -> None:
    np.testing.assert_allclose(camera.unproject(camera.project(POINTS)), POINTS[:, :2] / POINTS[:, 2:], atol=1e-9)


def test_derivatives_are_those_of_the_pixels(camera: CameraModel) -> None:
    pixels, by_point, by_intrinsics = camera.project_with_jacobian(POINTS)
    np.testing.assert_allclose(pixels, camera.project(POINTS), atol=1e-9)
    step = 1e-6
    for k in range(3):
        moved = camera.project(POINTS + step * np.eye(3)[k]) - camera.project(POINTS - step * np.eye(3)[k])
        np.testing.assert_allclose(by_point[:, :, k], moved / (2 * step), rtol=1e-4, atol=1e-3)
    vector = intrinsics_vector(camera)
    for k, unit in enumerate(np.eye(len(vector))):
        ahead, behind = (with_intrinsics(camera, vector + s * step * unit).project(POINTS) for s in (1, -1))
        np.testing.assert_allclose(by_intrinsics[:, :, k], (ahead - behind) / (2 * step), rtol=1e-4, atol=1e-3)


def test_the_kernels_know_the_lens(camera: CameraModel) -> None:
    corners = camera.project(POINTS)[None]
    rays = corners_through_lens(lens_of(camera), corners, None, 0.1, 0.5)[0]
    np.testing.assert_allclose(rays[0], POINTS[:, :2] / POINTS[:, 2:], atol=1e-6)


@pytest.mark.parametrize("write", [rig_to_yaml, rig_to_camera_info])
def test_files_hold_the_lens(camera: CameraModel, write, tmp_path) -> None:
    rig = Rig((MountedCamera("left", camera, Pose.identity("camera", "left")),))
    path = tmp_path / "rig.yaml"
    path.write_text(write(rig), encoding="utf-8")
    read = read_any_rig(path).left
    assert read.model == camera.model
    np.testing.assert_allclose(read.project(POINTS), camera.project(POINTS), atol=1e-6)


def test_an_unknown_lens_is_named(tmp_path) -> None:
    with pytest.raises(ValueError, match="known: pinhole, fisheye, rational"):
        CameraModel((640, 480), K, np.zeros(4), "double_sphere")
