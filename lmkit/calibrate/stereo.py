"""`calibrate_stereo`: from the corners of a board in stereo pairs to a rig, and how good it is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from lmkit.arrays import FloatArray
from lmkit.calibrate.problem import POSE, FitOptions, PairView, Solution, StereoProblem, intrinsics_vector
from lmkit.calibrate.rectify import epipolar_errors
from lmkit.errors import InputError
from lmkit.model.board import BoardSpec
from lmkit.model.camera import CameraModel
from lmkit.model.pose import Pose, rotation_angle, rotation_exp, rotation_log
from lmkit.model.stereo_rig import StereoRig

MIN_PAIRS = 3
ADVISED_PAIRS = 10
FOLDS = 5
# A pair's own relation of the eyes may differ from the others' by this much before the fit.
CONSENSUS_DEG = 1.0
CONSENSUS_SIGMA = 6.0
BAD_RMS_RATIO = 4.0
DISTORTION_COUNT = {"pinhole": 5, "rational": 8, "fisheye": 4}


@dataclass(frozen=True)
class CalibrationWarning:
    """Something the user should know.

    Attributes:
        code: short stable name.
        message: what, and what to do.
        pairs: names of the pairs concerned.
    """

    code: str
    message: str
    pairs: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class StereoCalibration:
    """A calibrated rig and the evidence for it.

    Attributes:
        rig: the result, with the covariance of T_right_left.
        rms_px, rms_left_px, rms_right_px: reprojection error of the fit.
        held_out_epipolar_px: mean |dy| after rectification of pairs that the fit had not seen
            (5 folds); None with fewer than five pairs.
        used: the pairs of the fit.
        residuals: per used pair, observed minus projected pixels, left (N,2) and right (M,2).
        rejected: (pair, reason).
        warnings: in order of weight.
        baseline_sigma_m: standard deviation of the baseline.
        warp_m: (2,) bow of the board.
    """

    rig: StereoRig
    rms_px: float
    rms_left_px: float
    rms_right_px: float
    held_out_epipolar_px: float | None
    used: tuple[PairView, ...]
    residuals: tuple[tuple[FloatArray, FloatArray], ...]
    rejected: tuple[tuple[str, str], ...]
    warnings: tuple[CalibrationWarning, ...]
    baseline_sigma_m: float
    warp_m: FloatArray


def calibrate_stereo(
    views: Sequence[PairView],
    board: BoardSpec,
    image_size: tuple[int, int],
    model: str = "pinhole",
    rejected: Sequence[tuple[str, str]] = (),
) -> StereoCalibration:
    """Calibrate a rig jointly from all pairs that agree with each other.

    Args:
        views: pairs in which both eyes see the board.
        image_size: (width, height), the same for both eyes.
        model: ``pinhole``, ``rational`` or ``fisheye``.
        rejected: pairs lost before, with reasons; they are passed on.

    Raises:
        InputError: too few pairs, or they do not agree on any rig.
    """
    _require(views, rejected)
    turned_away = list(rejected)
    warnings: list[CalibrationWarning] = []
    object_points = board.object_points
    left = _start_camera(object_points, [(v.ids_left, v.left) for v in views], image_size, model)
    right = _start_camera(object_points, [(v.ids_right, v.right) for v in views], image_size, model)

    kept, disagreeing = _consensus(object_points, views, left, right)
    for view, degrees, millimetres in disagreeing:
        turned_away.append((view.name, f"its eyes stand {degrees:.1f} deg and {millimetres:.1f} mm off the others'"))
    _require(kept, turned_away)

    solution = _fit(object_points, kept, left, right)
    kept, bad = _split_by_rms(object_points, kept, solution)
    if bad:
        turned_away += [(view.name, f"reprojection error {rms:.2f} px, far above the rest") for view, rms in bad]
        _require(kept, turned_away)
        solution = _fit(object_points, kept, solution.left, solution.right)

    off = tuple(sorted([view.name for view, _, _ in disagreeing] + [view.name for view, _ in bad]))
    if off:
        message = (
            f"{len(off)} of {len(views)} pairs do not fit the rig that the others show: it was moved between them, "
            "their two pictures belong to different moments, or are blurred; take them again"
        )
        warnings.append(CalibrationWarning("pairs_disagree", message, off))

    problem = StereoProblem(object_points, kept)
    residuals = problem.residuals(solution)
    left_all = np.concatenate([pair[0] for pair in residuals])
    right_all = np.concatenate([pair[1] for pair in residuals])
    held_out = _held_out(object_points, kept, solution)
    if len(kept) < ADVISED_PAIRS:
        warnings.append(CalibrationWarning("few_pairs", f"only {len(kept)} pairs; take {ADVISED_PAIRS} to 30"))
    warnings += _coverage_warnings(kept, image_size)
    assert solution.covariance_globals is not None
    at = 2 * len(intrinsics_vector(solution.left))
    covariance = solution.covariance_globals[at : at + POSE, at : at + POSE]
    # Ours is rotation, shift; a rig's is shift, rotation.
    order = [3, 4, 5, 0, 1, 2]
    covariance = covariance[np.ix_(order, order)]
    direction = solution.t / np.linalg.norm(solution.t)
    rig = StereoRig(
        solution.left, solution.right, Pose("right", "left", solution.R, solution.t), covariance=covariance
    )
    return StereoCalibration(
        rig=rig,
        rms_px=_rms(np.concatenate([left_all, right_all])),
        rms_left_px=_rms(left_all),
        rms_right_px=_rms(right_all),
        held_out_epipolar_px=held_out,
        used=tuple(kept),
        residuals=tuple(residuals),
        rejected=tuple(turned_away),
        warnings=tuple(warnings),
        baseline_sigma_m=float(np.sqrt(direction @ covariance[:3, :3] @ direction)),
        warp_m=solution.warp,
    )


def _rms(residuals: FloatArray) -> float:
    """Root mean square distance over points, as OpenCV reports it."""
    return float(np.sqrt(np.mean(np.sum(residuals**2, axis=1))))


def _require(views: Sequence[PairView], rejected: Sequence[tuple[str, str]]) -> None:
    if len(views) >= MIN_PAIRS:
        return
    first = f"; first rejected: {rejected[0][0]}: {rejected[0][1]}" if rejected else ""
    raise InputError(
        "too_few_pairs",
        f"only {len(views)} usable pairs of {len(views) + len(rejected)}, at least {MIN_PAIRS} are needed{first}",
        "check the board specification, take 10 to 30 pairs with the whole board sharp in both eyes",
    )


def _start_camera(
    object_points: FloatArray,
    seen: Sequence[tuple[np.ndarray, FloatArray]],
    image_size: tuple[int, int],
    model: str,
) -> CameraModel:
    """One eye on its own; a start for the joint fit."""
    objects = [object_points[ids].astype(np.float32) for ids, _ in seen]
    images = [points.astype(np.float32) for _, points in seen]
    width, height = image_size
    try:
        if model == "fisheye":
            f = width / 4
            K = np.array([[f, 0, (width - 1) / 2], [0, f, (height - 1) / 2], [0, 0, 1.0]])
            flags = 0
            for name in ("CALIB_RECOMPUTE_EXTRINSIC", "CALIB_FIX_SKEW", "CALIB_USE_INTRINSIC_GUESS"):
                flags |= _fisheye_flag(name)
            _, K, D, _, _ = cv2.fisheye.calibrate(
                [o.reshape(1, -1, 3).astype(np.float64) for o in objects],
                [i.reshape(1, -1, 2).astype(np.float64) for i in images],
                image_size,
                K,
                np.zeros((4, 1)),
                flags=flags,
            )
            return CameraModel(image_size, _plain(K), np.asarray(D, dtype=np.float64).ravel(), model)
        _, K, D, _, _ = cv2.calibrateCamera(objects, images, image_size, None, None, flags=cv2.CALIB_FIX_K3)
        distortion = np.asarray(D, dtype=np.float64).ravel()[:5]
        padded = np.pad(distortion, (0, DISTORTION_COUNT[model] - len(distortion)))
        return CameraModel(image_size, _plain(K), padded, model)
    except (cv2.error, ValueError):
        raise InputError(
            "no_start",
            f"no {model} camera explains the corners of one eye",
            "check the board specification and take views with more tilt",
        ) from None


def _fisheye_flag(name: str) -> int:
    """OpenCV 5 keeps these flags in cv2, OpenCV 4 in cv2.fisheye; their numbers differ."""
    home = cv2.fisheye if hasattr(cv2.fisheye, name) else cv2
    return int(getattr(home, name))


def _plain(K: np.ndarray) -> FloatArray:
    return np.array([[K[0, 0], 0, K[0, 2]], [0, K[1, 1], K[1, 2]], [0, 0, 1.0]])


_PoseArrays = tuple[FloatArray, FloatArray]


def _board_poses(camera: CameraModel, object_points: FloatArray, points: FloatArray) -> list[_PoseArrays]:
    """R, t of the board in one camera, likelier one first: a small flat board may have a twin pose."""
    rays = camera.unproject(points)
    eye = np.eye(3)
    _, rvecs, tvecs, _ = cv2.solvePnPGeneric(object_points, rays, eye, None, flags=cv2.SOLVEPNP_IPPE)
    poses: list[_PoseArrays] = []
    for rvec, tvec in zip(rvecs, tvecs, strict=True):
        better = cv2.solvePnPRefineLM(object_points, rays, eye, None, rvec, tvec)
        rvec, tvec = (np.asarray(vector, dtype=np.float64).ravel() for vector in better)
        poses.append((rotation_exp(rvec), tvec))
    return poses


def _relations(
    object_points: FloatArray, views: Sequence[PairView], left: CameraModel, right: CameraModel
) -> tuple[FloatArray, FloatArray, list[_PoseArrays]]:
    """T_right_left as each pair alone shows it, (P,3,3) and (P,3), and T_left_board behind it.

    Where an eye allows two poses, the pair takes those that agree best with the other pairs.
    """
    choices: list[list[tuple[FloatArray, FloatArray, _PoseArrays]]] = []
    for view in views:
        seen_left = _board_poses(left, object_points[view.ids_left], view.left)
        seen_right = _board_poses(right, object_points[view.ids_right], view.right)
        choices.append([(Rr @ Rl.T, tr - Rr @ Rl.T @ tl, (Rl, tl)) for Rl, tl in seen_left for Rr, tr in seen_right])
    first = np.array([options[0][0] for options in choices])
    middle = first[_medoid(first)]
    nearest = [min(options, key=lambda c: rotation_angle(c[0] @ middle.T)) for options in choices]
    return np.array([c[0] for c in nearest]), np.array([c[1] for c in nearest]), [c[2] for c in nearest]


def _medoid(rotations: FloatArray) -> int:
    """The rotation whose median angle to the others is least."""
    between = np.array([[rotation_angle(a @ b.T) for b in rotations] for a in rotations])
    return int(np.median(between, axis=1).argmin())


def _consensus(
    object_points: FloatArray, views: Sequence[PairView], left: CameraModel, right: CameraModel
) -> tuple[list[PairView], list[tuple[PairView, float, float]]]:
    """Pairs that agree with the rotation most others show, and the rest with how far they are off."""
    rotations, translations, _ = _relations(object_points, views, left, right)
    middle = rotations[_medoid(rotations)]
    off = np.rad2deg([rotation_angle(R @ middle.T) for R in rotations])
    limit = max(CONSENSUS_DEG, CONSENSUS_SIGMA * float(np.median(off)) / 0.6745)
    shift = np.linalg.norm(translations - np.median(translations[off <= limit], axis=0), axis=1) * 1000
    kept = [view for view, degrees in zip(views, off, strict=True) if degrees <= limit]
    gone = [(v, float(d), float(s)) for v, d, s in zip(views, off, shift, strict=True) if d > limit]
    return kept, gone


def _fit(object_points: FloatArray, views: Sequence[PairView], left: CameraModel, right: CameraModel) -> Solution:
    rotations, translations, poses = _relations(object_points, views, left, right)
    middle = rotations[_medoid(rotations)]
    for _ in range(5):
        middle = rotation_exp(np.median([rotation_log(R @ middle.T) for R in rotations], axis=0)) @ middle
    start = Solution(
        left,
        right,
        middle,
        np.median(translations, axis=0),
        np.zeros(2),
        np.array([R for R, _ in poses]),
        np.array([t for _, t in poses]),
    )
    problem = StereoProblem(object_points, views)
    flat = problem.solve(start, FitOptions(warp=False))
    return problem.solve(flat, FitOptions())


def _split_by_rms(
    object_points: FloatArray, views: Sequence[PairView], solution: Solution
) -> tuple[list[PairView], list[tuple[PairView, float]]]:
    residuals = StereoProblem(object_points, views).residuals(solution)
    rms = np.array([_rms(np.concatenate(pair)) for pair in residuals])
    bad = rms > BAD_RMS_RATIO * np.median(rms)
    kept = [view for view, is_bad in zip(views, bad, strict=True) if not is_bad]
    gone = [(view, float(r)) for view, r, is_bad in zip(views, rms, bad, strict=True) if is_bad]
    return kept, gone


def _held_out(object_points: FloatArray, views: Sequence[PairView], solution: Solution) -> float | None:
    """Mean |dy| after rectification over pairs left out, five folds, every fold fitted without them."""
    if len(views) < FOLDS:
        return None
    errors = []
    for fold in range(FOLDS):
        seen = [view for index, view in enumerate(views) if index % FOLDS != fold]
        unseen = [view for index, view in enumerate(views) if index % FOLDS == fold]
        keep = [index for index in range(len(views)) if index % FOLDS != fold]
        start = Solution(
            solution.left,
            solution.right,
            solution.R,
            solution.t,
            solution.warp,
            solution.rotations[keep],
            solution.translations[keep],
        )
        fitted = StereoProblem(object_points, seen).solve(start, FitOptions())
        rig = StereoRig(fitted.left, fitted.right, Pose("right", "left", fitted.R, fitted.t))
        for view in unseen:
            _, in_left, in_right = np.intersect1d(view.ids_left, view.ids_right, return_indices=True)
            errors.append(np.abs(epipolar_errors(rig, view.left[in_left], view.right[in_right])))
    return float(np.mean(np.concatenate(errors)))


def _coverage_warnings(views: Sequence[PairView], image_size: tuple[int, int]) -> list[CalibrationWarning]:
    """Names the eyes whose pictures are not filled: outside the corners seen, distortion is a guess."""
    found = []
    for eye in ("left", "right"):
        points = np.concatenate([getattr(view, eye) for view in views])
        cells = np.floor(points / np.array(image_size) * 5).clip(0, 4).astype(int)
        filled = len({(int(x), int(y)) for x, y in cells}) / 25
        if filled < 0.6:
            message = (
                f"the board covers only {100 * filled:.0f} % of the {eye} picture; add views that reach its corners"
            )
            found.append(CalibrationWarning("coverage", message))
    return found
