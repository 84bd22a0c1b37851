"""Initialization of the joint fit: every camera alone, and the relative pose on which most pairs agree."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from lmkit.arrays import BoolArray, FloatArray, IntArray
from lmkit.calibration.bundle_adjustment import Solution
from lmkit.errors import InputError
from lmkit.geometry.camera import CameraModel
from lmkit.geometry.lens_models import LENS_MODELS, PINHOLE
from lmkit.geometry.rotations import rotation_angle, rotation_exp, rotation_log
from lmkit.model.observation import PairView

# A pair's own relative camera pose may differ from the others' by this much before the fit.
CONSENSUS_DEG = 1.0
CONSENSUS_SIGMA = 6.0
FITTED_DEG = 0.2  # the same once the cameras are known
GOOD_START = 0.002  # error of an equidistant camera's start, of the image's width, that needs no other
NEARLY_PINHOLE = 1.5  # the same over the pinhole camera's, of an equidistant camera near to it that is not fitted
EQUIDISTANT_VIEWS = 15  # for the start of an equidistant camera, which OpenCV fits slowly
# OpenCV's fisheye fit stops at steps of this share of the parameters; its own 1e-16 takes 2 to 8 times as long.
STARTED = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 100, 1e-6)


@dataclass(frozen=True, eq=False)
class Relation:
    """T_right_left from one pair alone.

    Attributes:
        R, t: rotation (3,3) and shift (3,), meters.
        board: R, t of T_left_board behind it.
        rms_px: reprojection error of each camera alone, the larger one.
    """

    R: FloatArray
    t: FloatArray
    board: tuple[FloatArray, FloatArray]
    rms_px: float


@dataclass(frozen=True)
class Consensus:
    """The relative pose on which most pairs agree.

    Attributes:
        relations: of every pair.
        agrees: (P,) whether it is within the limit of the rest.
        R, t: the median relative pose of those that agree.
    """

    relations: tuple[Relation, ...]
    agrees: BoolArray
    R: FloatArray
    t: FloatArray

    def off(self, k: int) -> tuple[float, float]:
        """Difference of pair k from the median, degrees and meters."""
        relation = self.relations[k]
        turned = float(np.rad2deg(rotation_angle(relation.R @ self.R.T)))
        return turned, float(np.linalg.norm(relation.t - self.t))


RADTAN = "radtan"  # Kalibr's name of k1 k2 p1 p2; asked for by name, never chosen
AUTO = "auto"
MODELS = (AUTO, *LENS_MODELS, RADTAN)


def models_by_camera(model: str, count: int) -> tuple[str, ...]:
    """Lens models of ``count`` cameras from one name for all of them, or one for each, separated by commas.

    Raises:
        InputError: an unknown name, or another number of names.
    """
    names = tuple(model.split(","))
    for name in names:
        if name not in MODELS:
            hint = f"choose {', '.join(MODELS)} (--model); separate the models of several cameras by commas"
            raise InputError("bad_model", f"model {name} is unknown", hint)
    if len(names) not in (1, count):
        raise InputError(
            "bad_model",
            f"model {model} names {len(names)} lens models for {count} cameras",
            "give one for all cameras (--model pinhole), or one for each (--model pinhole,fisheye)",
        )
    return names if len(names) == count else names * count


class CameraStarts:
    """Cameras of any lens model that explain the corners of one camera on its own, by OpenCV.

    Args:
        object_points: (N,3) corners of the board, meters.
        seen: of every image the corners' numbers and (M,2) pixels.
        image_size: (width, height).
    """

    def __init__(
        self, object_points: FloatArray, seen: Sequence[tuple[IntArray, FloatArray]], image_size: tuple[int, int]
    ) -> None:
        self._objects = [object_points[ids].astype(np.float32) for ids, _ in seen]
        self._images = [points.astype(np.float32) for _, points in seen]
        self._size = image_size

    def camera(self, model: str) -> CameraModel:
        """The camera of a lens model, or of `RADTAN`: ``pinhole`` with the four coefficients k1 k2 p1 p2 alone.

        Raises:
            InputError: no such camera explains the corners.
        """
        try:
            if model != RADTAN and LENS_MODELS[model].is_equidistant:
                return self._equidistant(model)
            pinhole = self._pinhole
            if model == RADTAN:
                return CameraModel(self._size, pinhole.K, pinhole.distortion[:4], PINHOLE.name)
            padded = np.pad(pinhole.distortion, (0, LENS_MODELS[model].fitted - len(pinhole.distortion)))
            return CameraModel(self._size, pinhole.K, padded, model)
        except (cv2.error, ValueError):
            raise _no_start(model) from None

    @cached_property
    def _pinhole(self) -> CameraModel:
        """With k1 k2 p1 p2 and a k3 of 0; the other models start from it."""
        threads = cv2.getNumThreads()
        cv2.setNumThreads(1)  # several threads sum in any order: the last bits would differ between runs
        try:
            _, K, D, _, _ = cv2.calibrateCamera(
                self._objects, self._images, self._size, None, None, flags=cv2.CALIB_FIX_K3
            )
        finally:
            cv2.setNumThreads(threads)
        return CameraModel(self._size, _plain(K), np.asarray(D, dtype=np.float64).ravel()[:5], PINHOLE.name)

    def _equidistant(self, model: str) -> CameraModel:
        """The equidistant camera that explains most of the corners, from several starts.

        A narrow lens is close to the pinhole camera of the same corners; if that camera's equidistant approximation
        explains them as well, nothing is fitted.  OpenCV's fit ends in an error or in a wrong camera if it starts
        far from the focal length; the approximation is its last start, and the result if that fails, too.

        Raises:
            InputError: no such camera explains the corners.
        """
        width, height = self._size
        some = np.unique(np.linspace(0, len(self._images) - 1, EQUIDISTANT_VIEWS).round().astype(int))
        objects, images = [self._objects[k] for k in some], [self._images[k] for k in some]
        starts: list[tuple[CameraModel, bool]] = [
            (CameraModel(self._size, _centered(f, width, height), np.zeros(4), model), True)
            for f in (width / 4, max(width, height) / np.pi)
        ]
        best: tuple[float, CameraModel] | None = None
        try:
            near = _equidistant_near(self._pinhole, model)
            error = _median_error(near, objects, images)
            if error <= min(GOOD_START * width, NEARLY_PINHOLE * _median_error(self._pinhole, objects, images)):
                return near
            starts += [(near, True), (near, False)]
        except (cv2.error, ValueError, np.linalg.LinAlgError):
            pass  # no pinhole camera is near: the lens is wide
        for start, is_fitted in starts:
            try:
                found = _fit_equidistant(objects, images, start) if is_fitted else start
            except (cv2.error, ValueError):
                continue
            error = _median_error(found, objects, images)
            if np.isfinite(error) and (best is None or error < best[0]):
                best = error, found
            if best is not None and best[0] <= GOOD_START * width:
                break
        if best is None:
            raise _no_start(model)
        return best[1]


def _fit_equidistant(objects: Sequence[FloatArray], images: Sequence[FloatArray], start: CameraModel) -> CameraModel:
    flags = 0
    for name in ("CALIB_RECOMPUTE_EXTRINSIC", "CALIB_FIX_SKEW", "CALIB_USE_INTRINSIC_GUESS"):
        flags |= _fisheye_flag(name)
    _, K, D, _, _ = cv2.fisheye.calibrate(
        [points.reshape(1, -1, 3).astype(np.float64) for points in objects],
        [points.reshape(1, -1, 2).astype(np.float64) for points in images],
        start.image_size,
        start.K.copy(),
        start.distortion.reshape(4, 1).copy(),
        flags=flags,
        criteria=STARTED,
    )
    return CameraModel(start.image_size, _plain(K), np.asarray(D, dtype=np.float64).ravel(), start.model)


def _equidistant_near(camera: CameraModel, model: str) -> CameraModel:
    """An equidistant approximation of a pinhole camera, with the same focal lengths and center.

    The angle's polynomial t (1 + k1 t^2 + k2 t^4), which is the distorted tangent over the lens's own range.
    """
    width, height = camera.image_size
    edge = camera.unproject(np.array([[0.0, (height - 1) / 2], [(width - 1) / 2, 0.0], [0.0, 0.0]]))
    reach = float(np.nanmax(np.arctan(np.linalg.norm(edge, axis=1))))
    angle = np.linspace(reach / 20, reach, 20)
    k1, k2, _, _, k3 = np.pad(camera.distortion, (0, 5))[:5]
    r = np.tan(angle)
    radius = r * (1 + k1 * r**2 + k2 * r**4 + k3 * r**6)
    share, *_ = np.linalg.lstsq(np.column_stack([angle**3, angle**5]), radius - angle, rcond=None)
    return CameraModel(camera.image_size, camera.K, np.array([*share, 0.0, 0.0]), model)


def _median_error(camera: CameraModel, objects: Sequence[FloatArray], images: Sequence[FloatArray]) -> float:
    """Error of the camera on the median image, px; infinite without a pose of the board."""
    poses = [
        board_poses(camera, o.astype(np.float64), i.astype(np.float64)) for o, i in zip(objects, images, strict=True)
    ]
    return float(np.median([found[0][2] if found else np.inf for found in poses]))


def _no_start(model: str) -> InputError:
    return InputError(
        "no_start",
        f"no {model} camera explains the corners of one camera",
        "check the board specification and take views with more tilt",
    )


def find_consensus(
    object_points: FloatArray, views: Sequence[PairView], left: CameraModel, right: CameraModel
) -> Consensus:
    """The relative pose on which most pairs agree, and which pairs do.

    Where a camera allows two poses of the board, the pair takes those that agree best with the others.

    Raises:
        InputError: the cameras do not reach all of the corners.
    """
    choices = _choices(object_points, views, left, right)
    first = np.array([options[0].R for options in choices])
    middle = first[_medoid(first)]
    relations = tuple(min(options, key=lambda c: rotation_angle(c.R @ middle.T)) for options in choices)
    middle = np.array([r.R for r in relations])[_medoid(np.array([r.R for r in relations]))]
    off = np.rad2deg([rotation_angle(r.R @ middle.T) for r in relations])
    limit = max(CONSENSUS_DEG, CONSENSUS_SIGMA * float(np.median(off)) / 0.6745)
    agrees = off <= limit
    agreeing = [r for r, ok in zip(relations, agrees, strict=True) if ok]
    for _ in range(5):
        middle = rotation_exp(np.median([rotation_log(r.R @ middle.T) for r in agreeing], axis=0)) @ middle
    return Consensus(relations, agrees, middle, np.median([r.t for r in agreeing], axis=0))


def agreement_with(
    object_points: FloatArray, views: Sequence[PairView], s: Solution, used: Sequence[int]
) -> Consensus:
    """How every pair's own relation compares with the fitted one; the limit comes from the pairs that were used."""
    choices = _choices(object_points, views, s.left, s.right)
    relations = tuple(min(options, key=lambda c: rotation_angle(c.R @ s.R.T)) for options in choices)
    off = np.rad2deg([rotation_angle(r.R @ s.R.T) for r in relations])
    limit = max(FITTED_DEG, CONSENSUS_SIGMA * float(np.median(off[list(used)])) / 0.6745)
    return Consensus(relations, off <= limit, s.R, s.t)


def start_solution(consensus: Consensus, rows: IntArray, left: CameraModel, right: CameraModel) -> Solution:
    """The start of a joint fit of the pairs ``rows``."""
    boards = [consensus.relations[int(k)].board for k in rows]
    return Solution(
        left,
        right,
        consensus.R,
        consensus.t,
        np.zeros(2),
        np.array([R for R, _ in boards]),
        np.array([t for _, t in boards]),
    )


def _choices(
    object_points: FloatArray, views: Sequence[PairView], left: CameraModel, right: CameraModel
) -> list[list[Relation]]:
    """All relative poses that each pair's board allows; a far outlier if it allows none.

    Raises:
        InputError: that is so for half of the pairs or more.
    """
    choices: list[list[Relation]] = []
    for view in views:
        seen_left = board_poses(left, object_points[view.ids_left], view.left)
        seen_right = board_poses(right, object_points[view.ids_right], view.right)
        choices.append([_relation(a, b) for a in seen_left for b in seen_right] or [_NOWHERE])
    if 2 * sum(options[0] is _NOWHERE for options in choices) >= len(choices):
        raise _no_start(left.model)
    return choices


_NOWHERE = Relation(np.diag([-1.0, -1.0, 1.0]), np.zeros(3), (np.eye(3), np.array([0, 0, 1.0])), np.inf)
_BoardPose = tuple[FloatArray, FloatArray, float]


def _relation(in_left: _BoardPose, in_right: _BoardPose) -> Relation:
    (Rl, tl, rms_left), (Rr, tr, rms_right) = in_left, in_right
    R = Rr @ Rl.T
    return Relation(R, tr - R @ tl, (Rl, tl), max(rms_left, rms_right))


def board_poses(camera: CameraModel, object_points: FloatArray, points: FloatArray) -> list[_BoardPose]:
    """R, t of the board in one camera and its error, the likelier pose first: a small flat board may allow two."""
    rays = camera.unproject(points)
    if not np.isfinite(rays).all():
        return []
    identity = np.eye(3)
    _, rvecs, tvecs, _ = cv2.solvePnPGeneric(object_points, rays, identity, None, flags=cv2.SOLVEPNP_IPPE)
    poses: list[_BoardPose] = []
    for rvec, tvec in zip(rvecs, tvecs, strict=True):
        if not (np.isfinite(rvec).all() and np.isfinite(tvec).all()):
            continue
        better = cv2.solvePnPRefineLM(object_points, rays, identity, None, rvec, tvec)
        rvec, tvec = (np.asarray(vector, dtype=np.float64).ravel() for vector in better)
        R = rotation_exp(rvec)
        left_over = points - camera.project(object_points @ R.T + tvec)
        poses.append((R, tvec, float(np.sqrt(np.mean(np.sum(left_over**2, axis=1))))))
    return poses


def _medoid(rotations: FloatArray) -> int:
    """The rotation whose median angle to the others is least."""
    trace = np.einsum("aij,bij->ab", rotations, rotations)
    return int(np.median(np.arccos(np.clip((trace - 1) / 2, -1, 1)), axis=1).argmin())


def _fisheye_flag(name: str) -> int:
    """OpenCV 5 keeps these flags in cv2, OpenCV 4 in cv2.fisheye; their numbers differ."""
    home = cv2.fisheye if hasattr(cv2.fisheye, name) else cv2
    return int(getattr(home, name))


def _centered(f: float, width: int, height: int) -> FloatArray:
    return np.array([[f, 0, (width - 1) / 2], [0, f, (height - 1) / 2], [0, 0, 1.0]])


def _plain(K: np.ndarray) -> FloatArray:
    return np.array([[K[0, 0], 0, K[0, 2]], [0, K[1, 1], K[1, 2]], [0, 0, 1.0]])
