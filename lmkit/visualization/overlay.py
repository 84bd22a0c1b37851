"""Results drawn on images."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from lmkit.arrays import ByteArray, FloatArray
from lmkit.geometry.camera import CameraModel
from lmkit.model.estimate import PoseEstimate
from lmkit.model.landmark_map import LandmarkMap
from lmkit.model.observation import Detection

Bgr = tuple[int, int, int]
GREEN: Bgr = (80, 220, 60)
YELLOW: Bgr = (0, 210, 255)
MAGENTA: Bgr = (220, 60, 200)
RED: Bgr = (40, 40, 230)
INK: Bgr = (30, 30, 30)
USUAL_PX = 1400.0  # longer side of an image; in larger images, lines and words are enlarged
EXPECTED = "magenta: expected by the map"
UNSEEN = "thin: in the map, not detected"
OUTLIER = "red: contradicts the pose"
SHIFT = 4  # sub-pixel bits of OpenCV's drawing


def draw_landmarks(
    image: ByteArray,
    landmarks: Sequence[Detection],
    enlarge: int = 2,
    labels: Sequence[str] | None = None,
    outlines: Sequence[Bgr] | None = None,
) -> ByteArray:
    """A copy, ``enlarge`` times larger, with each landmark's outline, top edge and label.

    Args:
        labels: text beside each landmark; None: the codes.
        outlines: color of each outline; None: green, with a yellow top edge.
    """
    canvas = _enlarged(image, enlarge)
    for number, landmark in enumerate(landmarks):
        corners = (landmark.corners + 0.5) * enlarge - 0.5
        _polyline(canvas, corners, outlines[number] if outlines else GREEN, closed=True)
        if outlines is None:
            _polyline(canvas, corners[:2], YELLOW, closed=False)
        label_at = corners.min(axis=0) - [0, 6]
        draw_label(canvas, labels[number] if labels else str(landmark.code), label_at)
    return canvas


def draw_axes(image: ByteArray, camera: CameraModel, points_camera: FloatArray, enlarge: int = 2) -> None:
    """Draw three axes in place: ``points_camera`` (4,3) origin and tips of x, y, z, camera frame."""
    if points_camera[:, 2].min() <= 0.01:
        return
    at = (camera.project(points_camera) + 0.5) * enlarge - 0.5
    for tip, color in zip(at[1:], ((60, 60, 230), (60, 200, 60), (230, 120, 40)), strict=True):
        _polyline(image, np.array([at[0], tip]), color, closed=False)


def draw_located(
    image: ByteArray,
    seen: Sequence[Detection],
    camera: CameraModel,
    estimate: PoseEstimate,
    landmarks: LandmarkMap,
    enlarge: int = 2,
) -> ByteArray:
    """A copy, ``enlarge`` times larger, with detections, predicted landmarks of the map, and axes."""
    canvas = draw_landmarks(image, seen, enlarge)
    if estimate.T_map_camera is None:
        draw_estimate(canvas, estimate)
        return canvas
    T_camera_map = estimate.T_map_camera.inverse()
    read, shown = {o.id for o in seen}, {"green: detected"} if seen else set[str]()
    for landmark in landmarks:
        corners = T_camera_map.apply(landmark.corners_map)
        if corners[:, 2].min() < 0.05:
            continue
        pixels = camera.project(corners)
        if not camera.contains(pixels).any() or not camera.reaches(pixels).all():
            continue
        faces = (landmark.T_map_landmark.R[:, 2] @ (estimate.T_map_camera.t - landmark.T_map_landmark.t)) > 0
        if not faces and landmark.id not in read:
            continue
        outline = (pixels + 0.5) * enlarge - 0.5
        if landmark.id not in read:
            # A wall or a person may hide it: only its predicted outline is drawn.
            _polyline(canvas, outline, MAGENTA, closed=True, width=1)
            shown.add(UNSEEN)
            continue
        is_outlier = landmark.id in estimate.outliers
        shown.add(OUTLIER if is_outlier else EXPECTED)
        _polyline(canvas, outline, RED if is_outlier else MAGENTA, closed=True)
        tips = landmark.size_m / 2 * np.array([[0, 0, 0], [1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0]])
        draw_axes(canvas, camera, T_camera_map.apply(landmark.T_map_landmark.apply(tips)), enlarge)
    draw_estimate(canvas, estimate)
    draw_label(canvas, "; ".join(sorted(shown)), np.array([8.0, canvas.shape[0] - 8.0]))
    return canvas


def draw_estimate(canvas: ByteArray, estimate: PoseEstimate) -> None:
    """Write status and position, of the robot's base if the rig has T_base_left, at the top left."""
    text = str(estimate.status)
    if estimate.T_map_base is not None:
        x, y, z = estimate.T_map_base.t
        text += f": x {x:.3f} y {y:.3f} z {z:.3f} m"
    draw_label(canvas, text, np.array([8.0, 24.0]))


def draw_label(canvas: ByteArray, text: str, at: FloatArray, scale: float = 0.6) -> None:
    """A line of text on a plate, in place, kept inside the image; larger in large images."""
    grown = _grown(canvas)
    scale, thick = scale * grown, round(grown)
    (width, height), base = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, scale, thick)
    x = int(np.clip(at[0], 2, max(2, canvas.shape[1] - width - 4)))
    y = int(np.clip(at[1], height + 4, canvas.shape[0] - base - 2))
    cv2.rectangle(canvas, (x - 3, y - height - 4), (x + width + 3, y + base), INK, cv2.FILLED)
    cv2.putText(canvas, text, (x, y), cv2.FONT_HERSHEY_SIMPLEX, scale, (255, 255, 255), thick, cv2.LINE_AA)


def side_by_side(left: ByteArray, right: ByteArray) -> ByteArray:
    """Two images side by side; the taller one is reduced to the height of the other."""
    height = min(left.shape[0], right.shape[0])
    both = [
        image
        if image.shape[0] == height
        else cv2.resize(
            image, (round(image.shape[1] * height / image.shape[0]), height), interpolation=cv2.INTER_AREA
        )
        for image in (left, right)
    ]
    return np.asarray(np.hstack(both), dtype=np.uint8)


def encode_jpeg(image: ByteArray, quality: int = 92) -> bytes:
    """The bytes of a JPEG file."""
    _, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])
    return bytes(data)


def encode_png(image: ByteArray) -> bytes:
    """The bytes of a PNG file."""
    _, data = cv2.imencode(".png", image)
    return bytes(data)


def _enlarged(image: ByteArray, factor: int) -> ByteArray:
    size = (image.shape[1] * factor, image.shape[0] * factor)
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_CUBIC), dtype=np.uint8)


def _grown(canvas: ByteArray) -> float:
    """Scale of lines and words, relative to the usual size."""
    return max(1.0, float(max(canvas.shape[:2])) / USUAL_PX)


def _polyline(canvas: ByteArray, points: FloatArray, color: Bgr, closed: bool, width: int = 2) -> None:
    fixed = np.round(points * (1 << SHIFT)).astype(np.int32).reshape(-1, 1, 2)
    thick = round(width * _grown(canvas))
    cv2.polylines(canvas, [fixed], closed, INK, 2 * thick, cv2.LINE_AA, SHIFT)
    cv2.polylines(canvas, [fixed], closed, color, thick, cv2.LINE_AA, SHIFT)
