"""Landmarks drawn on the board of real stereo photographs: true lens, the photographs' own blur and noise.

The landmark is painted on the chessboard's plane at the pose that the chessboard gives in that
pair, through the calibrated camera with its distortion, in each camera.  The chessboard's corners and
the landmark are read by different code, so that their agreement is evidence.
"""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from ids import lm8
from scenes import DPI, MM, sheet_by_pdfium, to_code_values, to_linear

from lmkit.calibration.stereo import calibrate_stereo
from lmkit.detection.detector import detect_landmarks
from lmkit.geometry.pose import Pose
from lmkit.geometry.rotations import rotation_angle
from lmkit.io.images import read_image
from lmkit.localization.absolute_pose import locate_rig
from lmkit.model.board import BoardSpec
from lmkit.model.landmark_map import LandmarkMap, MappedLandmark
from lmkit.pipelines.board_views import find_board_pairs

BOARD = BoardSpec.parse("chessboard:9x6:30mm")
SIDE_M = 0.15
MIN_SIDE_PX = 25
S = 2  # oversampling of the painting, which is blurred by 0.8 px


@pytest.fixture(scope="module")
def bouguet(data):
    root = data / "stereo" / "opencv_bouguet"
    files = [sorted((root / which).glob("*.jpg")) for which in ("left", "right")]
    pairs = find_board_pairs(list(zip(files[0], files[1], strict=True)), BOARD)
    return pairs, calibrate_stereo(pairs.views, BOARD, pairs.image_size, rejected=pairs.rejected)


@pytest.mark.slow
def test_the_published_baseline_comes_back(bouguet):
    _, result = bouguet
    assert result.rig.baseline_m * 1000 == pytest.approx(99.8, abs=0.5)
    assert result.held_out_epipolar_px <= 0.13


@pytest.mark.slow
def test_landmarks_on_the_board_are_found_and_locate_the_rig(bouguet):
    pairs, result = bouguet
    rig = result.rig
    middle = BOARD.object_points.mean(axis=0)
    # The landmark lies in the board's plane (x right, y down there), its z toward the viewer.
    T_board_landmark = Pose("board", "landmark", np.diag([1.0, -1.0, -1.0]), middle)
    located, positions, angles, left_out = 0, [], [], []
    for index, view in enumerate(result.used):
        T_left_board = _board_pose(rig, view)
        T_left_landmark = T_left_board @ T_board_landmark
        code = (37 * index + 11) % 256
        landmark = MappedLandmark(lm8(code), SIDE_M, Pose("map", "landmark", np.eye(3), np.zeros(3)))
        seen = []
        for which, path in enumerate(pairs.files[view.name]):
            camera = (rig.left, rig.right)[which]
            T = T_left_landmark if which == 0 else _relabel(rig.T_right_left) @ T_left_landmark
            corners = camera.project(T.apply(landmark.corners_map))
            side = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1).mean()
            if side < MIN_SIDE_PX or not camera.contains(corners, 2).all():
                left_out.append(view.name)
                break
            seen.append(detect_landmarks(_painted(read_image(path), camera, T, code)))
        else:
            codes = [[d.code for d in found] for found in seen]
            estimate = locate_rig(seen, rig, LandmarkMap([landmark]))
            if codes == [[code], [code]] and estimate.T_map_camera is not None:
                located += 1
                expected = T_left_landmark.inverse()
                positions.append(np.linalg.norm(estimate.T_map_camera.t - expected.t) * 1000)
                angles.append(np.rad2deg(rotation_angle(estimate.T_map_camera.R @ expected.R.T)))
    # Pair 009's right camera shows no chessboard, so it has no pose to draw at.
    assert len(result.used) + len(result.rejected) == 13
    assert len(left_out) <= 1
    assert located >= 12 - len(left_out)
    assert np.median(positions) < 3.0
    assert np.median(angles) < 1.0


def _board_pose(rig, view) -> Pose:
    """T_left_board by OpenCV's own solver on the left corners."""
    rays = rig.left.unproject(view.left)
    points = BOARD.object_points[view.ids_left]
    _, rvec, tvec = cv2.solvePnP(points, rays, np.eye(3), None, flags=cv2.SOLVEPNP_ITERATIVE)
    return Pose.from_rvec("camera", "board", rvec, tvec)


def _relabel(T: Pose) -> Pose:
    return Pose("camera", "camera", T.R, T.t)


def _painted(image, camera, T_camera_landmark, code):
    """The sheet painted into the image, every sub-pixel by its own distorted ray."""
    x0, y0, x1, y1 = _window(image, camera, T_camera_landmark)
    painted = image.copy()
    painted[y0:y1, x0:x1] = _painted_window(image, camera, T_camera_landmark, code, (x0, y0, x1, y1))
    return painted


def _window(image, camera, T_camera_landmark) -> tuple[int, int, int, int]:
    """Box around the sheet in the image with room for the blur: x0, y0, x1, y1."""
    reach = SIDE_M / 0.18 * 0.105
    square = reach * np.array([[-1.0, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]])
    corners = camera.project(T_camera_landmark.apply(square))
    limits = np.array(image.shape[1::-1])
    low = np.clip(np.floor(corners.min(axis=0)).astype(int) - 12, 0, limits)
    high = np.clip(np.ceil(corners.max(axis=0)).astype(int) + 12, 0, limits)
    return int(low[0]), int(low[1]), int(high[0]), int(high[1])


def _painted_window(image, camera, T_camera_landmark, code, window):
    x0, y0, x1, y1 = window
    sheet = to_linear(sheet_by_pdfium(code))
    height, width = y1 - y0, x1 - x0
    steps = (np.arange(S) + 0.5) / S - 0.5
    x = (np.arange(x0, x1)[:, None] + steps).ravel()
    y = (np.arange(y0, y1)[:, None] + steps).ravel()
    pixels = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    rays = np.column_stack([camera.unproject(pixels), np.ones(len(pixels))])
    T = T_camera_landmark
    plane = rays @ np.linalg.inv(np.column_stack([T.R[:, 0], T.R[:, 1], T.t])).T
    mm = plane[:, :2] / plane[:, 2:] * 1000 * (0.18 / SIDE_M)
    # On the sheet of template a4 the face's middle lies at (109.8, 108) mm from its top left.
    on_sheet = (np.column_stack([mm[:, 0] + 109.8, 108.0 - mm[:, 1]]) * MM - 0.5).astype(np.float32)
    shape = (len(y), len(x))
    maps = [on_sheet[:, k].reshape(shape) for k in (0, 1)]
    face = (np.abs(mm) < 100).all(axis=1).reshape(shape).astype(np.float32)
    step = abs(float(rays[1, 0] - rays[0, 0])) * float(np.linalg.norm(T.t)) * 1000 * 0.18 / SIDE_M * MM
    blurred = cv2.GaussianBlur(sheet, (0, 0), max(step / 2, 0.4))
    layer = cv2.remap(blurred, maps[0], maps[1], cv2.INTER_LINEAR) * face[:, :, None]
    # The photograph's own white and sharpness: its bright squares, and 0.8 px of blur.
    layer = cv2.GaussianBlur(layer, (0, 0), 0.8 * S).reshape(height, S, width, S, 3).mean(axis=(1, 3))
    alpha = cv2.GaussianBlur(face, (0, 0), 0.8 * S).reshape(height, S, width, S).mean(axis=(1, 3))[:, :, None]
    light = to_linear(np.uint8([np.percentile(image, 97)])).item()
    under = image[y0:y1, x0:x1]
    painted = to_code_values(layer * light + to_linear(under) * (1 - alpha)).astype(np.float32)
    # The photograph's own noise, taken from its own pixels.
    noise = image.astype(np.float32) - cv2.GaussianBlur(image, (0, 0), 1.0)
    shifted = np.roll(np.clip(noise, -4, 4), (17, 31), axis=(0, 1))[y0:y1, x0:x1]
    return np.where(alpha > 1e-3, np.clip(np.round(painted + shifted * alpha), 0, 255), under).astype(np.uint8)


assert DPI == 150  # MM above is the sheet's own scale
