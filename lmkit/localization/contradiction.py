"""Causes for which most observations contradict the map: corner order, swapped cameras, units, another map.

Each cause is undone in turn, and the frames with most landmarks are located again.  The cause after which they agree
is named.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import combinations

import numpy as np

from lmkit.geometry.pose import Pose
from lmkit.geometry.rig import AnyRig, as_stereo, mounted_cameras
from lmkit.geometry.rig_plausibility import rig_warnings
from lmkit.kernels.square_pose import square_poses
from lmkit.localization.absolute_pose import locate_camera, locate_rig
from lmkit.localization.correspondences import CORNER_FLOOR_PX, Correspondences
from lmkit.localization.mirror import find_mirror
from lmkit.localization.rig_contradiction import Cause, find_rig_cause
from lmkit.model.estimate import PoseEstimate
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import LandmarkMap, MappedLandmark
from lmkit.model.observation import Detection
from lmkit.model.pose_status import PoseStatus
from lmkit.model.recording import RigFrame
from lmkit.units import unit_of_ratio

FRAMES = 8  # that are tested
AGREES, CONTRADICTS = 0.6, 0.5  # shares of the landmarks seen that a pose explains
OFF_SCALE, ALIKE = 0.12, 0.15  # logarithms of ratios: from 1, and among each other


Locate = Callable[[RigFrame], PoseEstimate]


def find_cause(frames: Sequence[RigFrame], rig: AnyRig, landmarks: LandmarkMap) -> Cause | None:
    """Cause of the contradiction, or None if the frames agree with the map, or have too few landmarks.

    Args:
        frames: of a recording, or of single frames; a frame may hold the first camera alone.
    """
    some = _telling(frames, landmarks)
    if not some:
        return None
    if _share(some, landmarks, lambda frame: _locate(frame, rig, landmarks)) > CONTRADICTS:
        return None
    of_rig = find_rig_cause(frames, rig, {m.id: m.size_m for m in landmarks})
    if of_rig is not None:
        return of_rig
    for cause, locate in _variants(some, rig, landmarks):
        if _share(some, landmarks, locate) > AGREES:
            return cause
    return Cause(
        "another_map",
        "the landmarks seen are in the map, but at other places: it is the map of another place, they were moved, "
        "or the map has other axes or units",
    )


def with_cause(
    estimate: PoseEstimate,
    seen: Sequence[Sequence[Detection]],
    rig: AnyRig,
    landmarks: LandmarkMap,
) -> PoseEstimate:
    """The estimate of one frame; warnings name what is unusual in the rig, and why no pose explains the landmarks.

    Mirrored images give no pose: the codes that they show may be in the map by chance.
    """
    texts = rig_warnings(rig, "the rig")
    frame = RigFrame(0.0, tuple(map(tuple, seen)))
    if 2 * len(estimate.inliers) < len({d.id for d in frame.detections}):
        mirror = find_mirror([frame], rig, landmarks)
        if mirror is not None:
            read = tuple(sorted(_mapped(frame, landmarks)))
            return PoseEstimate(PoseStatus.INCONSISTENT, outliers=read, warnings=(str(mirror), *texts))
    if estimate.status == PoseStatus.INCONSISTENT:
        cause = find_cause([frame], rig, landmarks)
        texts = texts if cause is None else (str(cause), *texts)
    return replace(estimate, warnings=(*estimate.warnings, *texts)) if texts else estimate


def _telling(frames: Sequence[RigFrame], landmarks: LandmarkMap) -> list[RigFrame]:
    """Frames with two or more mapped landmarks, most first; a single landmark cannot contradict the map."""
    counts = [(len(_mapped(frame, landmarks)), -k) for k, frame in enumerate(frames)]
    best = sorted((entry for entry in counts if entry[0] > 1), reverse=True)[:FRAMES]
    return [frames[-k] for _, k in best]


def _mapped(frame: RigFrame, landmarks: LandmarkMap) -> set[LandmarkId]:
    return {o.id for o in frame.detections if o.id in landmarks}


def _locate(frame: RigFrame, rig: AnyRig, landmarks: LandmarkMap) -> PoseEstimate:
    if not any(frame.seen[1:]):
        return locate_camera(frame.seen[0], rig.left, landmarks)
    return locate_rig(frame.seen, rig, landmarks)


def _share(frames: Sequence[RigFrame], landmarks: LandmarkMap, locate: Locate) -> float:
    """Share of the mapped landmarks seen that the frames' poses explain."""
    seen = sum(len(_mapped(frame, landmarks)) for frame in frames)
    return sum(len(locate(frame).inliers) for frame in frames) / seen


def _variants(frames: Sequence[RigFrame], rig: AnyRig, landmarks: LandmarkMap) -> Iterator[tuple[Cause, Locate]]:
    """Causes, and for each a function that locates frames with the cause undone."""
    cameras = len(mounted_cameras(rig))
    if cameras == 2:
        yield (
            Cause("swapped_cameras", "left and right are swapped: give the left camera's images or detections first"),
            lambda frame: locate_rig(frame.seen[::-1], rig, landmarks),
        )
    for order in ((3, 2, 1, 0), (2, 3, 0, 1), (1, 2, 3, 0), (3, 0, 1, 2), (0, 3, 2, 1), (2, 1, 0, 3), (1, 0, 3, 2)):
        text = (
            "the corners of the detections are in another order: write them clockwise from the landmark's top left "
            f"corner, that is, the present ones in the order {', '.join(map(str, order))}"
        )
        yield Cause("corner_order", text), partial(_locate_reordered, order, rig, landmarks)
    ratio = _map_ratio(frames, rig, landmarks)
    if ratio is not None and abs(np.log(ratio)) > OFF_SCALE:
        text = (
            f"with their printed size, landmarks are {ratio:.3g} times as far apart as in the map: check the "
            f"positions' units{unit_of_ratio(1 / ratio)}"
        )
        yield Cause("map_units", text), partial(_locate_in, _positions_scaled(landmarks, ratio), rig)
        text = f"the landmarks are {1 / ratio:.3g} times as large as in the map: check size_m{unit_of_ratio(ratio)}"
        yield Cause("map_sizes", text), partial(_locate_in, _sizes_scaled(landmarks, 1 / ratio), rig)
    if cameras == 2:
        stereo = as_stereo(rig, "the rig")
        T = stereo.T_right_left
        back = replace(stereo, T_right_left=Pose("right", "left", T.R.T, -T.R.T @ T.t))
        yield (
            Cause(
                "rig_inverted",
                "T_right_left of the rig is inverted: write its inverse",
            ),
            lambda frame: _locate(frame, back, landmarks),
        )
    if cameras > 1:
        key, all_of_them = ("T_right_left", "both") if cameras == 2 else ("cameras", "all")
        yield (
            Cause(
                "rig_contradicts",
                f"each camera alone agrees with the map, {all_of_them} together do not: check the rig's {key} "
                "(meters, direction, order of the cameras)",
            ),
            lambda frame: locate_camera(frame.seen[0], rig.left, landmarks),
        )


def _locate_reordered(order: tuple[int, ...], rig: AnyRig, landmarks: LandmarkMap, frame: RigFrame) -> PoseEstimate:
    return _locate(_reordered(frame, order), rig, landmarks)


def _reordered(frame: RigFrame, order: tuple[int, ...]) -> RigFrame:
    rows = list(order)

    def turned(detection: Detection) -> Detection:
        return replace(detection, corners=detection.corners[rows], covariance=None)

    return RigFrame(frame.time_s, tuple(tuple(map(turned, camera)) for camera in frame.seen), frame.name)


def _map_ratio(frames: Sequence[RigFrame], rig: AnyRig, landmarks: LandmarkMap) -> float | None:
    """Ratio of distances between landmarks, by printed size over map; None if the ratios differ."""
    logs: list[float] = []
    for frame in frames:
        seen = Correspondences([(frame.seen[0], rig.left, np.eye(3), np.zeros(3))], landmarks, CORNER_FLOOR_PX)
        if len(seen) < 2:
            continue
        centers = square_poses(seen.rays, np.array([m.size_m for m in seen.landmarks]))[1][:, 0]
        mapped = np.array([m.T_map_landmark.t for m in seen.landmarks])
        for a, b in combinations(range(len(seen)), 2):
            apart, known = (float(np.linalg.norm(points[a] - points[b])) for points in (centers, mapped))
            if apart > 0 and known > 0:
                logs.append(float(np.log(apart / known)))
    if len(logs) < 3:
        return None
    low, middle, high = np.percentile(logs, [25, 50, 75])
    return float(np.exp(middle)) if high - low < 2 * ALIKE else None


def _locate_in(landmarks: LandmarkMap, rig: AnyRig, frame: RigFrame) -> PoseEstimate:
    return _locate(frame, rig, landmarks)


def _positions_scaled(landmarks: LandmarkMap, factor: float) -> LandmarkMap:
    def scaled(m: MappedLandmark) -> MappedLandmark:
        T = m.T_map_landmark
        return replace(m, T_map_landmark=Pose(T.to_frame, T.from_frame, T.R, factor * T.t), covariance=None)

    return LandmarkMap([scaled(m) for m in landmarks])


def _sizes_scaled(landmarks: LandmarkMap, factor: float) -> LandmarkMap:
    return LandmarkMap([replace(m, size_m=factor * m.size_m, covariance=None) for m in landmarks])
