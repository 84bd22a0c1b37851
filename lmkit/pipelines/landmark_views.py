"""Landmarks in stereo pairs as views of small boards, to check a calibration with an ordinary recording."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.detection.config import DetectOptions
from lmkit.detection.detector import detect_landmarks
from lmkit.geometry.camera import CameraModel
from lmkit.geometry.stereo_rig import StereoRig
from lmkit.io.images import read_image
from lmkit.model.families import MarkerFamily, family_named
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.observation import Detection, PairView
from lmkit.model.recording import RigFrame
from lmkit.parallel import map_in_processes


def find_landmark_pairs(
    files: Sequence[tuple[Path, Path]],
    rig: StereoRig,
    family: MarkerFamily,
    on_pair: Callable[[int, int], None] = lambda done, total: None,
) -> tuple[FloatArray, list[PairView]]:
    """(4,3) corners of a landmark of nominal size, and one view per landmark that both cameras of a pair read.

    For a landmark of another size only the distance is wrong, not the row error between the cameras.

    Raises:
        InputError: an image cannot be read.
    """
    views: list[PairView] = []
    jobs = [job for left, right in files for job in ((left, rig.left), (right, rig.right))]
    with closing(map_in_processes(partial(_look, family=family), jobs)) as looked:
        for done, (left_file, _) in enumerate(files, start=1):
            views += [view for _, view in _views(left_file.stem, next(looked), next(looked))]
            on_pair(done, len(files))
    return family.object_points(family.side_mm / 1000), views


def _look(job: tuple[Path, CameraModel], family: MarkerFamily) -> list[Detection]:
    file, camera = job
    return list(detect_landmarks(read_image(file), DetectOptions((family,), camera=camera)))


def recorded_landmark_pairs(
    frames: Sequence[RigFrame], camera: int, sizes_m: Mapping[LandmarkId, float], most: int
) -> tuple[FloatArray, list[PairView]]:
    """(4S,3) corners of each landmark size, meters, and views that the first camera and another one share.

    Args:
        camera: index of the other camera in the rig.
        sizes_m: side of each landmark; landmarks without one are skipped.
        most: views at most, evenly over the recording.
    """
    seen = [
        (id_, view)
        for frame in frames
        for id_, view in _views(frame.name, frame.seen[0], frame.seen[camera])
        if id_ in sizes_m
    ]
    spaced = np.linspace(0, len(seen) - 1, min(most, len(seen))).astype(int)
    kept = [seen[k] for k in spaced.tolist()]
    kinds = sorted({(id_.family, sizes_m[id_]) for id_, _ in kept})
    points = [family_named(family).object_points(size_m) for family, size_m in kinds]
    starts = {kind: 4 * k for k, kind in enumerate(kinds)}
    views = []
    for id_, view in kept:
        ids = view.ids_left + starts[id_.family, sizes_m[id_]]
        views.append(replace(view, ids_left=ids, ids_right=ids))
    return np.concatenate(points) if points else np.zeros((0, 3)), views


def _views(name: str, left: Sequence[Detection], right: Sequence[Detection]) -> list[tuple[LandmarkId, PairView]]:
    """Landmarks detected exactly once in both images."""
    in_left, in_right = _once(left), _once(right)
    both = sorted(in_left.keys() & in_right.keys())
    return [(id_, _view(f"{name} code {id_.code}", in_left[id_], in_right[id_])) for id_ in both]


def _once(seen: Sequence[Detection]) -> dict[LandmarkId, Detection]:
    """Detections by id, without ids detected twice."""
    count = Counter(o.id for o in seen)
    return {o.id: o for o in seen if count[o.id] == 1}


def _view(name: str, left: Detection, right: Detection) -> PairView:
    ids = np.arange(4)
    return PairView(name, ids, left.corners, ids, right.corners, _noise(left), _noise(right))


def _noise(o: Detection) -> float | None:
    return None if o.covariance is None else float(np.sqrt(np.trace(o.covariance) / 8))
