"""Causes for which the two cameras of a pair contradict each other, from landmarks that both see; without a map.

Each camera alone gives the position of a landmark from its printed size.  The right camera's image of it is predicted
from the left camera's position.  If the prediction is wrong, each cause is undone in turn, and the one with which it
fits is named.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.geometry.camera import CameraModel
from lmkit.geometry.pose import Pose
from lmkit.geometry.rectification import rectified_rig
from lmkit.geometry.rig import AnyRig, as_stereo, mounted_cameras
from lmkit.geometry.stereo_rig import StereoRig
from lmkit.kernels.square_pose import square_poses
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.observation import Detection
from lmkit.model.recording import RigFrame
from lmkit.units import unit_of_ratio

LEAST_PAIRS = 4  # landmarks seen in both cameras, over all frames
MOST_FRAMES = 60
OFF = 0.01  # of the image's diagonal: a prediction that misses by more
CONTRADICTS, AGREES = 0.5, 0.8  # shares of predictions that fit
OFF_SCALE = 0.15  # logarithm of a ratio
# Sizes are doubted from this deviation on, if this many views show it at this significance.
DOUBTED_SIZE, LEAST_VIEWS, SURE_SIGMA = 0.03, 12, 5.0


@dataclass(frozen=True)
class Cause:
    """Cause for which cameras contradict each other, or a map.

    Attributes:
        code: short stable name, e.g. ``corner_order``.
        text: what is wrong, and what to do, in words.
    """

    code: str
    text: str

    def __str__(self) -> str:
        return self.text


@dataclass(frozen=True, eq=False)
class _Seen:
    """Corners (N,4,2) of landmarks in both images, and their sizes (N,)."""

    left: FloatArray
    right: FloatArray
    sizes: FloatArray

    @property
    def swapped(self) -> _Seen:
        return _Seen(self.right, self.left, self.sizes)


def find_rig_cause(frames: Sequence[RigFrame], rig: AnyRig, sizes: Mapping[LandmarkId, float]) -> Cause | None:
    """Cause of the contradiction, or None if the cameras agree, share too few landmarks, or no cause explains it.

    Args:
        frames: of a recording, or of single frames, in the order of time.
        sizes: sides of the landmarks, meters; others are left out.
    """
    if len(mounted_cameras(rig)) != 2:
        return None
    stereo = as_stereo(rig, "the rig")
    seen = _seen_by_both(frames, sizes)
    if len(seen.sizes) < LEAST_PAIRS:
        return None
    share = _share(seen, stereo)
    if share < CONTRADICTS:
        # With far landmarks, undoing a wrong cause may also fit; the predictions of the true one are the best.
        undone = [(_misses(other, with_rig), cause) for cause, other, with_rig in _variants(seen, stereo)]
        fitting = [(float(np.median(off)), cause) for off, cause in undone if np.mean(off < OFF) > AGREES]
        if fitting:
            return min(fitting, key=lambda fit: fit[0])[1]
    return _shifted(frames, stereo, sizes, share)


def size_doubt(frames: Sequence[RigFrame], rig: AnyRig, sizes: Mapping[LandmarkId, float]) -> str | None:
    """A sentence if landmarks have another size than stated, according to the cameras' baseline; else None.

    A size that is wrong by some percent scales the map, and no residual shows it.

    Args:
        frames, sizes: as of :func:`find_rig_cause`.
    """
    if len(mounted_cameras(rig)) != 2:
        return None
    stereo = as_stereo(rig, "the rig")
    seen = _seen_by_both(frames, sizes)
    if len(seen.sizes) < LEAST_VIEWS:
        return None
    by_size, by_baseline = _places(seen.left, seen.sizes, stereo.left), _triangulated(seen, stereo)
    ratios = (by_baseline / by_size)[:, 2]
    ratios = ratios[np.isfinite(ratios) & (ratios > 0)]
    if len(ratios) < LEAST_VIEWS:
        return None
    middle = float(np.median(ratios))
    sigma = 1.25 * 1.4826 * float(np.median(np.abs(ratios - middle))) / np.sqrt(len(ratios))
    if abs(middle - 1) < max(DOUBTED_SIZE, SURE_SIGMA * sigma):
        return None
    stated = float(np.median(seen.sizes))
    return (
        f"with the rig's baseline, landmarks measure {1000 * middle * stated:.0f} mm, not the {1000 * stated:.0f} mm "
        "stated: check their size (--size, or in the map), or the rig's baseline"
    )


def _triangulated(seen: _Seen, rig: StereoRig) -> FloatArray:
    """(N,3) centers in the left camera's frame, where the rays of both cameras pass nearest to each other."""
    ends = []
    for corners, camera in ((seen.left, rig.left), (seen.right, rig.right)):
        flat = camera.unproject(corners.mean(axis=1))
        ends.append(np.column_stack([flat, np.ones(len(flat))]))
    T = rig.T_right_left.inverse()
    a, b, t = ends[0], ends[1] @ T.R.T, T.t
    aa, bb, ab = (np.sum(p * q, axis=1) for p, q in ((a, a), (b, b), (a, b)))
    with np.errstate(all="ignore"):
        along = (bb * (a @ t) - ab * (b @ t)) / (aa * bb - ab**2)
    return np.asarray(a * along[:, None])


def _shifted(
    frames: Sequence[RigFrame], rig: StereoRig, sizes: Mapping[LandmarkId, float], share: float
) -> Cause | None:
    """The cause that each left image is paired with the right one of another frame."""
    if share > AGREES or len(frames) < 2 * LEAST_PAIRS:
        return None
    for by, other in ((1, "next"), (-1, "previous")):
        first, second = (frames[:-by], frames[by:]) if by > 0 else (frames[-by:], frames[:by])
        pairs = [(a.seen[0], b.seen[1]) for a, b in zip(first, second, strict=True) if len(a.seen) > 1]
        seen = _seen(pairs[:: 1 + len(pairs) // MOST_FRAMES], sizes)
        if len(seen.sizes) >= LEAST_PAIRS and _share(seen, rig) > max(AGREES, share + 0.2):
            return Cause(
                "shifted_pairs",
                f"left images fit the right images of the {other} frame: the pairs are shifted by one; pair images "
                "of the same time",
            )
    return None


def _seen_by_both(frames: Sequence[RigFrame], sizes: Mapping[LandmarkId, float]) -> _Seen:
    some = frames[:: 1 + len(frames) // MOST_FRAMES]
    return _seen([(frame.seen[0], frame.seen[1]) for frame in some if len(frame.seen) > 1], sizes)


def _seen(
    pairs: Sequence[tuple[Sequence[Detection], Sequence[Detection]]], sizes: Mapping[LandmarkId, float]
) -> _Seen:
    rows = []
    for left, right in pairs:
        others = {d.id: d for d in right}
        for d in left:
            if d.id in others and d.id in sizes:
                rows.append((d.corners, others[d.id].corners, sizes[d.id]))
    return _Seen(
        np.array([row[0] for row in rows]).reshape(-1, 4, 2),
        np.array([row[1] for row in rows]).reshape(-1, 4, 2),
        np.array([row[2] for row in rows], dtype=np.float64),
    )


def _places(corners: FloatArray, sizes: FloatArray, camera: CameraModel) -> FloatArray:
    """(N,3) centers in the camera's frame, by the printed size."""
    rays = camera.unproject(corners.reshape(-1, 2)).reshape(-1, 4, 2)
    with np.errstate(all="ignore"):
        return np.asarray(square_poses(rays, sizes)[1][:, 0])


def _share(seen: _Seen, rig: StereoRig) -> float:
    """Share of the landmarks that the right camera sees at the places predicted from the left one."""
    return float(np.mean(_misses(seen, rig) < OFF))


def _misses(seen: _Seen, rig: StereoRig) -> FloatArray:
    """(N,) distance of each landmark in the right image from its prediction by the left, in image diagonals."""
    places = rig.T_right_left.apply(_places(seen.left, seen.sizes, rig.left))
    ahead = np.isfinite(places).all(axis=1) & (places[:, 2] > 0)
    predicted = rig.right.project(np.where(ahead[:, None], places, (0.0, 0.0, 1.0)))
    with np.errstate(all="ignore"):
        off = np.linalg.norm(predicted - seen.right.mean(axis=1), axis=1)
    return np.asarray(np.where(ahead & np.isfinite(off), off, np.inf) / np.hypot(*rig.right.image_size))


def _variants(seen: _Seen, rig: StereoRig) -> Iterator[tuple[Cause, _Seen, StereoRig]]:
    """Causes, with observations and rig after each is undone."""
    yield (
        Cause(
            "swapped_cameras",
            "left and right are swapped: give the left camera's images or detections first; if they are first, both "
            "cameras' images are mirrored",
        ),
        seen.swapped,
        rig,
    )
    T = rig.T_right_left
    yield (
        Cause("rig_inverted", "T_right_left of the rig is inverted (the right camera's pose): write its inverse"),
        seen,
        replace(rig, T_right_left=Pose("right", "left", T.R.T, -T.R.T @ T.t)),
    )
    yield (
        Cause("rig_sign", "t of the rig's T_right_left has the wrong sign: its x must be negative"),
        seen,
        replace(rig, T_right_left=Pose("right", "left", T.R, -T.t)),
    )
    yield Cause(
        "rectified_images",
        "the images are rectified, but the rig is of the original images: give the rig of the rectified images "
        "(lmkit rectify writes it), or the original images",
    ), seen, rectified_rig(rig)  # fmt: skip
    yield from _rescaled(seen, rig)


def _rescaled(seen: _Seen, rig: StereoRig) -> Iterator[tuple[Cause, _Seen, StereoRig]]:
    """Causes of a baseline that differs from the one by printed sizes."""
    T = rig.T_right_left
    left, right = (_places(c, seen.sizes, m) for c, m in ((seen.left, rig.left), (seen.right, rig.right)))
    between = right - left @ T.R.T
    with np.errstate(all="ignore"):
        ratio = float(np.median(between @ T.t) / (T.t @ T.t))
    if not np.isfinite(ratio) or ratio <= 0 or abs(np.log(ratio)) < OFF_SCALE:
        return
    size_m = float(np.median(seen.sizes))
    unit, scaled = unit_of_ratio(1 / ratio), replace(rig, T_right_left=Pose("right", "left", T.R, ratio * T.t))
    if not unit and _is_rectified(rig):
        yield Cause(
            "rectified_rig",
            "the rig is of rectified images, but the images are not rectified: rectify them, or give the rig of the "
            "original images",
        ), seen, scaled  # fmt: skip
    text = (
        f"with the printed size of the landmarks, the baseline is {1000 * ratio * rig.baseline_m:.3g} mm, in the rig "
        f"{1000 * rig.baseline_m:.6g} mm{unit}; with the rig's baseline, landmarks of {1000 * size_m:.0f} mm measure "
        f"{1000 * size_m / ratio:.0f} mm: check the rig's t (meters) and the landmarks' size"
    )
    yield Cause("rig_units", text), seen, scaled


def _is_rectified(rig: StereoRig) -> bool:
    plain = not (rig.left.distortion.any() or rig.right.distortion.any())
    return plain and bool(np.allclose(rig.T_right_left.R, np.eye(3), atol=1e-6))
