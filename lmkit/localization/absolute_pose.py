"""`locate_rig`: the pose of a rig of one or more cameras from all corners of all landmarks in view.

1. Every landmark alone gives two poses (a square seen by one camera has a second pose; IPPE, Collins and
   Bartoli 2014).  All of them, transformed into the map, are hypotheses.
2. Each hypothesis is fitted to its own landmark in all cameras, then to all landmarks that it
   nearly explains, so one wrong code cannot determine the start.
3. Hypotheses that are still different are refined on all corners of the landmarks they explain,
   weighted by the corners' own covariance (these three steps: `kernels/pose_search.py`).
4. The likelihood ratio of the best pose to the next distinct pose decides whether
   the status is ``ok`` or ``ambiguous``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from lmkit.arrays import BoolArray, FloatArray, widest_sigma
from lmkit.errors import InputError
from lmkit.geometry.camera import CameraModel
from lmkit.geometry.pose import Pose
from lmkit.geometry.rig import AnyRig, cameras_carried, mounted_cameras
from lmkit.kernels.pose_search import Search
from lmkit.localization.correspondences import CORNER_FLOOR_PX, NO_SHIFT, NO_TURN, Correspondences
from lmkit.localization.pose_prior import PosePrior
from lmkit.model.estimate import PoseEstimate
from lmkit.model.landmark_map import LandmarkMap
from lmkit.model.observation import Detection
from lmkit.model.pose_status import PoseStatus

SAME_TURN_RAD = np.deg2rad(2.0)
SAME_PLACE_M = 0.05
LISTED_BELOW = 25.0  # log likelihood ratio of alternatives that are listed
MOST_LISTED = 3
# Iterations: with its own landmark, with all that it nearly explains, and to convergence.
TOWARDS_NEAR, TO_THE_END = 2, 8
FIRST = np.zeros(1, dtype=np.int64)


@dataclass(frozen=True)
class LocateOptions:
    """Options of `locate_rig` and `locate_camera`.

    Attributes:
        corner_floor_px: standard deviation added to every corner's own, for errors of calibration and of paper
            that is not flat.
        ambiguous_below: log likelihood ratio under which a second pose makes the answer ambiguous.
        far_m, far_rad: a pose is imprecise if poses this far away explain the corners almost as well: far and small
            landmarks leave a valley of poses instead of two.
        outlier_sigma: a landmark is explained when the root mean square of its eight corner
            coordinates stays under this many standard deviations.
        gate_share: before refinement, a landmark is explained when its corners are projected to within this
            share of its side.
        prior: prior knowledge of the pose.
    """

    corner_floor_px: float = CORNER_FLOOR_PX
    ambiguous_below: float = 5.0
    far_m: float = 0.5
    far_rad: float = np.deg2rad(5.0)
    outlier_sigma: float = 4.5
    gate_share: float = 0.25
    prior: PosePrior | None = None


def locate_rig(
    seen: Sequence[Sequence[Detection]],
    rig: AnyRig,
    landmarks: LandmarkMap,
    options: LocateOptions | None = None,
    carried: Sequence[Pose] = (),
) -> PoseEstimate:
    """Pose of the rig's first (left) camera in the map; `PoseEstimate.T_map_base` gives the pose of the robot.

    If all mapped landmarks in one camera are outliers, the rig's extrinsics are wrong.  With three or more cameras,
    the cameras that agree give the pose, and ``outlier_cameras`` names the others.

    Args:
        seen: detections in the image of every camera, corners in pixels as delivered.
        carried: T_left_left of every camera from the rig at its exposure, where they do not expose together; as of
            `RigFrame`.

    Raises:
        InputError: not as many lists of detections as the rig has cameras.
    """
    mounted = mounted_cameras(rig)
    if len(seen) != len(mounted):
        raise InputError(
            "wrong_image_count",
            f"detections of {len(seen)} images for a rig of {len(mounted)} cameras",
            "give one list of detections per camera, in the order of the rig; a list may be empty",
        )
    options = options or LocateOptions()
    cameras = [
        (detections, camera.model, camera.T_camera_left.R, camera.T_camera_left.t)
        for detections, camera in zip(seen, cameras_carried(rig, carried), strict=True)
    ]
    estimate, blind = _locate(cameras, landmarks, options)
    if estimate.status != PoseStatus.INCONSISTENT:
        return estimate
    if len(seen) == 2 and all(seen):
        swapped = [(seen[1], *cameras[0][1:]), (seen[0], *cameras[1][1:])]
        if _locate(swapped, landmarks, options)[0].T_map_camera is not None:
            return PoseEstimate(PoseStatus.SWAPPED, outliers=estimate.outliers)
    if blind:
        believed = [((), *camera[1:]) if k in blind else camera for k, camera in enumerate(cameras)]
        again, _ = _locate(believed, landmarks, options)
        doubted = {d.id for k in blind for d in seen[k] if landmarks.find(d.id) is not None}
        outliers = tuple(sorted({*again.outliers, *(doubted - set(again.inliers))}))
        if again.T_map_camera is not None:
            return replace(again, outliers=outliers, outlier_cameras=tuple(mounted[k].name for k in sorted(blind)))
    return estimate


def possible_poses(seen: Sequence[Sequence[Detection]], rig: AnyRig, landmarks: LandmarkMap) -> list[Pose]:
    """The pose of `locate_rig` and its alternatives, the most likely first, without covariances."""
    options = LocateOptions()
    corners = Correspondences.of_rig(seen, rig, landmarks, options.corner_floor_px)
    if not len(corners):
        return []
    search = pose_search(options.outlier_sigma, options.gate_share)
    poses, chi2, cost = corners.search(search, None)
    inliers: BoolArray = chi2[0] < search.limit if len(poses) else np.zeros(len(corners), dtype=bool)
    if not inliers.all():
        estimate = locate_rig(seen, rig, landmarks, options)
        best = [] if estimate.T_map_camera is None else [estimate.T_map_camera]
        return best + [pose for pose, _ in estimate.alternatives]
    return [poses.pose(k) for k in (0, *listed_poses((cost - cost[0]).tolist()))]


def locate_camera(
    observations: Sequence[Detection],
    camera: CameraModel,
    landmarks: LandmarkMap,
    options: LocateOptions | None = None,
) -> PoseEstimate:
    """The pose of a single camera in the map."""
    return _locate([(observations, camera, NO_TURN, NO_SHIFT)], landmarks, options or LocateOptions())[0]


_Camera = tuple[Sequence[Detection], CameraModel, FloatArray, FloatArray]


def _locate(
    cameras: Sequence[_Camera], landmarks: LandmarkMap, options: LocateOptions
) -> tuple[PoseEstimate, frozenset[int]]:
    """The estimate, and the minority of cameras in which every mapped landmark is an outlier."""
    seen = Correspondences(cameras, landmarks, options.corner_floor_px)
    if not len(seen):
        return PoseEstimate(PoseStatus.NO_LANDMARKS, outliers=tuple(sorted(seen.twice))), frozenset()
    search = pose_search(options.outlier_sigma, options.gate_share)
    poses, chi2, cost = seen.search(search, options.prior)
    if not len(poses):
        everything = tuple(sorted({*seen.ids, *seen.twice}))
        return PoseEstimate(PoseStatus.INCONSISTENT, outliers=everything), frozenset()
    inliers: BoolArray = chi2[0] < search.limit
    ids, explained = set(seen.ids), seen.ids_of(inliers)
    looking = [k for k, camera in enumerate(seen.cameras) if camera.rows.stop > camera.rows.start]
    blind = frozenset(k for k in looking if not inliers[seen.cameras[k].rows].any())
    if blind or 2 * len(explained) < len(ids) or (len(ids) > 1 and len(explained) < 2):
        minority = blind if 2 * len(blind) < len(looking) else frozenset[int]()
        return PoseEstimate(PoseStatus.INCONSISTENT, outliers=tuple(sorted(ids | seen.twice))), minority
    covariance = seen.covariance(poses, inliers, options.prior)
    # Largest distance of a pose that explains the images almost as well: along the least certain direction.
    reach = math.sqrt(2 * options.ambiguous_below)
    far_m, far_rad = options.far_m / reach, options.far_rad / reach
    ratios = (cost - cost[0]).tolist()
    wide = widest_sigma(covariance[:3, :3], far_m) > far_m or widest_sigma(covariance[3:, 3:], far_rad) > far_rad
    rivaled = len(ratios) > 1 and ratios[1] < options.ambiguous_below
    pixels = seen.chi2_and_pixels(poses.only(FIRST))[1][0][inliers]
    estimate = PoseEstimate(
        status=PoseStatus.AMBIGUOUS if rivaled else PoseStatus.IMPRECISE if wide else PoseStatus.OK,
        T_map_camera=poses.pose(0),
        covariance=covariance,
        inliers=tuple(sorted(explained)),
        outliers=tuple(sorted((ids - explained) | seen.twice)),
        alternatives=tuple((poses.pose(k), ratios[k]) for k in listed_poses(ratios)),
        reprojection_error_px=math.sqrt(2 * float(pixels @ pixels) / len(pixels)),
    )
    return estimate, frozenset()


def listed_poses(ratios: Sequence[float]) -> list[int]:
    """Numbers of the alternatives to list, of the log likelihood ratios of all poses."""
    return [k for k in range(1, min(len(ratios), 1 + MOST_LISTED)) if ratios[k] < LISTED_BELOW]


@lru_cache(maxsize=8)
def pose_search(outlier_sigma: float, gate_share: float) -> Search:
    """Settings of the search."""
    return Search(
        gate_share,
        8 * outlier_sigma**2,
        LISTED_BELOW,
        float(SAME_TURN_RAD),
        SAME_PLACE_M,
        TOWARDS_NEAR,
        TO_THE_END,
    )
