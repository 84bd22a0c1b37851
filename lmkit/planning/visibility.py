"""Information of landmarks on a robot's pose, at any pose on a floor.

For every pose and visible landmark (in front, in the image, no wall between): the probability that it is
read (`model/detector_model.py`), and the Fisher information of its corners on the pose (derivatives of all corners
in both cameras with the pose, weighted with their deviation).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lmkit.arrays import FloatArray, IntArray
from lmkit.geometry.camera import CameraModel
from lmkit.geometry.pose import Pose
from lmkit.geometry.rig import AnyRig, mounted_cameras
from lmkit.kernels import pose_coverage as kernel
from lmkit.kernels.landmark_sights import Camera, Pairs, add_information, faced_landmarks, seen_sides
from lmkit.localization.pose_prior import PosePrior
from lmkit.localization.reprojection import lens_of
from lmkit.model.detector_model import SMALLEST_PX, corner_sigma_px, half_read_px, recognized
from lmkit.model.floor_plan import FloorPlan
from lmkit.model.landmark_map import MappedLandmark

NEAREST_M = 0.3
STEEPEST = 0.1  # cosine of the tilt beyond which landmarks are not read
EDGE = 0.75  # of the image's tangent, beyond which distortion folds back
IN_VIEW = 0.5  # least probability of reading for a landmark that counts as in view
NOTHING = 1e-4  # practically zero, but above rounding errors of large sums
AT_ONCE = 2_000_000  # pairs of pose and landmark


@dataclass(frozen=True, eq=False)
class Sights:
    """Pairs of pose and visible landmark.

    Attributes:
        poses, landmarks: (K,) rows, in rising order of the poses.
        probability: (K,) that it is read.
        information: (K,6,6) on the left camera's position (m) and rotation (rad) in the map, of a landmark that is
            read.
    """

    poses: IntArray
    landmarks: IntArray
    probability: FloatArray
    information: FloatArray

    def information_at(self, count: int) -> FloatArray:
        """(P,6,6) information of all landmarks at each pose, weighted with the probability of reading."""
        total = np.zeros((count, 6, 6))
        np.add.at(total, self.poses, self.probability[:, None, None] * self.information)
        return total

    def in_view_at(self, count: int) -> IntArray:
        """(P,) landmarks in view at each pose."""
        return np.bincount(self.poses[self.probability >= IN_VIEW], minlength=count)


NOTHING_SEEN = Sights(np.zeros(0, int), np.zeros(0, int), np.zeros(0), np.zeros((0, 6, 6)))


def find_sights(
    states: FloatArray, landmarks: Sequence[MappedLandmark], rig: AnyRig, floor: FloorPlan | None
) -> Sights:
    """Landmarks visible from (P,3) x, y (m) and headings (rad) of the robot's base.

    Args:
        rig: with its T_base_left.
        floor: its walls occlude landmarks; None for an empty world.
    """
    assert rig.T_base_left is not None
    if not landmarks or not len(states):
        return NOTHING_SEEN
    at_once = max(1, AT_ONCE // len(landmarks))
    parts = [
        _sights(states[start : start + at_once], start, landmarks, rig, floor)
        for start in range(0, len(states), at_once)
    ]
    return Sights(*(np.concatenate([getattr(part, name) for part in parts]) for name in Sights.__dataclass_fields__))


def camera_poses(states: FloatArray, T_base_left: Pose) -> tuple[FloatArray, FloatArray]:
    """(P,3,3) and (P,3) of T_map_left for (P,3) states of the base."""
    c, s = np.cos(states[:, 2]), np.sin(states[:, 2])
    turn = np.zeros((len(states), 3, 3))
    turn[:, 0, 0], turn[:, 0, 1], turn[:, 1, 0], turn[:, 1, 1], turn[:, 2, 2] = c, -s, s, c, 1.0
    place = np.column_stack([states[:, :2], np.zeros(len(states))]) + turn @ T_base_left.t
    return turn @ T_base_left.R, place


def planar_covariances(information: FloatArray, states: FloatArray, T_base_left: Pose) -> FloatArray:
    """(P,3,3) of the base's x, y (m) and heading (rad), from (P,6,6) information on the left camera.

    Height and tilt have the prior of a robot on wheels (`PosePrior`); without landmarks, the covariance is huge.
    """
    return kernel.planar_covariances(information, base_to_camera(states, T_base_left), known_of_pose())


def known_of_pose() -> FloatArray:
    """(6,) prior information on a camera's pose: its height and tilt."""
    tilt, height = PosePrior.tilt_sigma**-2, PosePrior.height_sigma**-2
    return np.array([NOTHING, NOTHING, height, tilt, tilt, NOTHING])


def base_to_camera(states: FloatArray, T_base_left: Pose) -> FloatArray:
    """(P,3) from the base to the left camera, in the map."""
    return camera_poses(states, T_base_left)[1] - np.column_stack([states[:, :2], np.zeros(len(states))])


def planar_errors(covariances: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(P,) errors of the position (m), both axes together, and of the heading (rad), of (P,3,3) covariances."""
    return np.sqrt(covariances[:, 0, 0] + covariances[:, 1, 1]), np.sqrt(covariances[:, 2, 2])


def _sights(
    states: FloatArray, first: int, landmarks: Sequence[MappedLandmark], rig: AnyRig, floor: FloorPlan | None
) -> Sights:
    T = rig.T_base_left
    assert T is not None
    R, p = camera_poses(states, T)
    corners = np.array([m.corners_map for m in landmarks])
    normals = np.array([m.T_map_landmark.R[:, 2] for m in landmarks])
    middles = np.array([m.T_map_landmark.t for m in landmarks])
    sizes = np.array([m.size_m for m in landmarks])
    # Cheap first: near enough, in front of its face, before the camera.
    reach = rig.left.K[0, 0] * sizes / SMALLEST_PX
    widest = EDGE * rig.left.image_size[0] / rig.left.K[0, 0]
    rows, columns = np.nonzero(faced_landmarks(R, p, middles, normals, reach, (STEEPEST, NEAREST_M, widest)))
    if floor is not None and len(rows):
        clear = floor.sees(p[rows, :2], middles[columns, :2])
        rows, columns = rows[clear], columns[clear]
    if not len(rows):
        return NOTHING_SEEN
    pairs = Pairs(rows, columns, R, p, corners)
    way = middles[columns] - p[rows]
    facing = -np.einsum("nk,nk->n", way, normals[columns]) / np.maximum(np.linalg.norm(way, axis=1), 1e-9)
    tilt = np.arccos(facing.clip(-1, 1))
    cameras = [_camera(c.model, c.T_camera_left.R, c.T_camera_left.t) for c in mounted_cameras(rig)]
    sides = [seen_sides(camera, pairs) for camera in cameras]
    half = np.array([half_read_px(m.id.family) for m in landmarks])[columns]
    probability = np.max([np.where(side > 0, recognized(side, tilt, half), 0.0) for side in sides], axis=0)
    kept = probability > 0
    pairs = Pairs(rows[kept], columns[kept], R, p, corners)
    information = np.zeros((len(pairs.at), 6, 6))
    for camera, side in zip(cameras, sides, strict=True):
        add_information(camera, pairs, np.where(side > 0, corner_sigma_px(side) ** -2, 0.0)[kept], information)
    return Sights(pairs.at + first, pairs.of, probability[kept], information)


def _camera(camera: CameraModel, R: FloatArray, t: FloatArray) -> Camera:
    return Camera(lens_of(camera), R, t, camera.image_size, EDGE, NEAREST_M / 2)
