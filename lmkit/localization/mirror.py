"""Mirrored images: their landmarks are read, with full confidence, as codes with the gaps in reverse order.

A single landmark cannot show this.  With a map it can be detected: after codes and corners are mirrored back, more
detections are in the map, and agree with it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

from lmkit.geometry.rig import AnyRig, mounted_cameras
from lmkit.localization.absolute_pose import locate_camera, locate_rig
from lmkit.localization.rig_contradiction import Cause
from lmkit.model.landmark import FAMILIES
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import LandmarkMap
from lmkit.model.observation import Detection
from lmkit.model.recording import RigFrame

FRAMES = 8  # that are tested
LEAST = 2  # landmarks that a frame must show
AGREES = 0.6  # share of the mirrored landmarks that a pose explains
AXIS_OF = {"left to right": 0, "upside down": 1}  # image axis along which pixels are reversed
CORNERS = [1, 0, 3, 2]  # of the upright landmark


def find_mirror(frames: Sequence[RigFrame], rig: AnyRig, landmarks: LandmarkMap) -> Cause | None:
    """The cause that the images are mirrored; None if they are not, or have too few landmarks.

    Args:
        frames: of a recording, or of single frames; a frame may hold the first camera alone.
    """
    known = {m.id for m in landmarks}
    gains = []
    for k, frame in enumerate(frames):
        seen = {d.id for d in frame.detections}
        back = {mirrored_id(id_) for id_ in seen} & known
        if len(back) >= LEAST:
            gains.append((len(back) - len(seen & known), len(back), -k))
    some = [frames[-k] for gain, _, k in sorted(gains, reverse=True)[:FRAMES] if gain >= 0]
    if not some or _share(some, rig, landmarks) > 1 - AGREES:
        return None
    for way in AXIS_OF:
        if _share([_mirrored(frame, rig, way) for frame in some], rig, landmarks) > AGREES:
            return Cause(
                "mirrored_images",
                f"the images are mirrored ({way}): their landmarks read as other codes; mirrored back, they agree "
                "with the map. Turn off the camera's mirror or selfie mode, or flip the images back",
            )
    return None


def mirrored_id(id_: LandmarkId) -> LandmarkId | None:
    """Id as which this landmark is read in a mirrored image; None if it is not read."""
    family = FAMILIES.get(id_.family)
    code = None if family is None else family.mirrored_code(id_.code)
    return None if code is None else LandmarkId(id_.family, code)


def _share(frames: Sequence[RigFrame], rig: AnyRig, landmarks: LandmarkMap) -> float:
    """Share of the landmarks seen, but at least two of each frame, that the frames' poses explain."""
    total = sum(max(len({d.id for d in frame.detections}), LEAST) for frame in frames)
    explained = 0
    for frame in frames:
        alone = not any(frame.seen[1:])
        found = locate_camera(frame.seen[0], rig.left, landmarks) if alone else locate_rig(frame.seen, rig, landmarks)
        explained += len(found.inliers) if len(found.inliers) >= LEAST else 0
    return explained / total


def _mirrored(frame: RigFrame, rig: AnyRig, way: str) -> RigFrame:
    """The frame with detections mirrored back."""
    sizes = [camera.model.image_size for camera in mounted_cameras(rig)]
    seen = tuple(tuple(_flipped(detections, size, way)) for detections, size in zip(frame.seen, sizes, strict=False))
    return replace(frame, seen=seen)


def _flipped(detections: Sequence[Detection], image_size: tuple[int, int], way: str) -> Iterator[Detection]:
    axis = AXIS_OF[way]
    for detection in detections:
        id_ = mirrored_id(detection.id)
        if id_ is not None:
            corners = detection.corners[CORNERS]
            corners[:, axis] = image_size[axis] - 1 - corners[:, axis]
            yield replace(detection, id=id_, corners=corners, covariance=None)
