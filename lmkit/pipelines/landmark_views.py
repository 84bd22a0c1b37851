"""Landmarks in stereo pairs, as views of one board each: what an ordinary drive says about a calibration."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import closing
from functools import partial
from pathlib import Path

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.detection.config import DetectOptions
from lmkit.detection.detector import detect_landmarks
from lmkit.geometry.camera import CameraModel
from lmkit.geometry.stereo_rig import StereoRig
from lmkit.io.images import read_image
from lmkit.model.families import MarkerFamily
from lmkit.model.observation import Detection, PairView
from lmkit.parallel import map_in_processes


def find_landmark_pairs(
    files: Sequence[tuple[Path, Path]],
    rig: StereoRig,
    family: MarkerFamily,
    on_pair: Callable[[int, int], None] = lambda done, total: None,
) -> tuple[FloatArray, list[PairView]]:
    """(4,3) corners of a landmark of its nominal size, and a view for each that both cameras of a pair read.

    Of a landmark of another size only the distance comes out wrong, not how the cameras' rows match.

    Raises:
        InputError: an image cannot be read.
    """
    views: list[PairView] = []
    jobs = [job for left, right in files for job in ((left, rig.left), (right, rig.right))]
    with closing(map_in_processes(partial(_look, family=family), jobs)) as looked:
        for done, (left_file, _) in enumerate(files, start=1):
            in_left, in_right = _once(next(looked)), _once(next(looked))
            views += [
                _view(f"{left_file.stem} code {code}", in_left[code], in_right[code])
                for code in sorted(in_left.keys() & in_right.keys())
            ]
            on_pair(done, len(files))
    return family.object_points(family.side_mm / 1000), views


def _look(job: tuple[Path, CameraModel], family: MarkerFamily) -> list[Detection]:
    file, camera = job
    return list(detect_landmarks(read_image(file), DetectOptions((family,), camera=camera)))


def _once(seen: Sequence[Detection]) -> dict[int, Detection]:
    """Detections by id, without those that are there twice."""
    count = Counter(o.code for o in seen)
    return {o.code: o for o in seen if count[o.code] == 1}


def _view(name: str, left: Detection, right: Detection) -> PairView:
    ids = np.arange(4)
    return PairView(name, ids, left.corners, ids, right.corners, _noise(left), _noise(right))


def _noise(o: Detection) -> float | None:
    return None if o.covariance is None else float(np.sqrt(np.trace(o.covariance) / 8))
