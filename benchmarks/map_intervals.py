"""Whether surveyed maps err as their covariances say: landmarks, poses, and all landmarks of a map together.

    uv run --extra benchmark python benchmarks/map_intervals.py
        [--seeds 20] [--first 1] [--seconds 32] [--hz 2.5] [--made quick] [--cameras 2] [--rig-off 0]
        [--no-odometry] [--errors 1] [--keep FOLDER]
    uv run --extra benchmark python benchmarks/map_intervals.py --drive ../shared/data/drive

Every simulated recording is one round of a robot through a room with eight landmarks; the survey knows the landmark
that was seen most.  ``--made``: ``corners`` (as the detector is measured to find them), ``quick`` images, or
``cameras`` (with the mosaic, noise, sharpening and JPEG of kinds that served no fit).  ``--rig-off`` turns the right
camera of the rig file about each axis, standard deviation in degrees.  ``--drive``: the rendered recording.
``--no-odometry``: by images alone.  ``--errors``: factor of the corners' errors, whose stated covariances stay.
``--keep``: recordings are read from that folder, and written to it where it lacks them.

Errors of the landmarks of one map are correlated: all are relative to one landmark.  So the mean of their NEES
varies far more than that of as many independent ones: ``honest`` is its range, 2.5 to 97.5 %, by the map's own joint
covariance.  ``joint`` is the NEES of all places together over their number, which has no such common part.
``swelling``: px by which corners stand too far out along width and height, as the survey finds them, and the median
over all detections by the truth.  ``size``: by how much the map is larger than the truth.
"""

from __future__ import annotations

import argparse
import pickle
import sys
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from scipy.stats import chi2

from lmkit.arrays import FloatArray
from lmkit.detection.config import DetectOptions
from lmkit.detection.detector import detect_landmarks
from lmkit.geometry.pose import Pose
from lmkit.geometry.rig import AnyRig, T_map_cameras, mounted_cameras
from lmkit.geometry.rotations import rotation_log
from lmkit.mapping.bundle_adjustment import Anchor
from lmkit.mapping.survey import solve_recording, survey_of
from lmkit.mapping.survey_results import Survey
from lmkit.model.landmark_map import LandmarkMap
from lmkit.model.observation import Detection
from lmkit.model.palette import srgb_to_linear
from lmkit.model.recording import Gyro, Odometry, RigFrame
from lmkit.odometry.wheel_odometry import MotionModel
from lmkit.simulation.cameras import HELD_OUT_KINDS, draw_chain
from lmkit.simulation.photograph import ImagingChain, black_body_rgb, count_electrons, develop
from lmkit.simulation.robot_course import RobotCourse
from lmkit.simulation.site import turned

LANDMARKS, FIRST_S, DRAWS = 8, 1.0, 2000


@dataclass(frozen=True, eq=False)
class Drive:
    """A recording and its truth: what is seen, T_map_left of every frame, the landmarks as they are mounted."""

    frames: Sequence[RigFrame]
    rig: AnyRig
    motion: MotionModel
    poses: Sequence[Pose]
    landmarks: LandmarkMap


@dataclass(frozen=True)
class Errors:
    """Mean NEES of one map: of landmarks' places and whole poses and of the rig's poses, each over its dimension.

    Attributes:
        honest: 2.5 and 97.5 % of the first, were the map's joint covariance true.
        joint: NEES of all places together over their number.
        tail: chance of a larger joint NEES.
        inside: share of landmarks' places in their 95 % ellipsoids.
        rms_mm: of the places.
        swelling, true_swelling: (2,) px, as the survey finds it, and by the truth.
        size: of the map over the true one, less 1.
    """

    places: float
    honest: tuple[float, float]
    six: float
    rig: float
    joint: float
    tail: float
    inside: float
    rms_mm: float
    landmarks: int
    swelling: FloatArray
    true_swelling: FloatArray
    size: float


def simulated(seed: int, seconds: float, hz: float, made: str, cameras: int) -> Drive:
    course = RobotCourse(seed, seconds + FIRST_S, LANDMARKS, cameras=cameras)
    rng = np.random.default_rng([seed, 21])
    chain = draw_chain(rng, HELD_OUT_KINDS, 0.0, mounted_cameras(course.rig)[0].model.image_size)
    T_base_left = course.rig.T_base_left
    assert T_base_left is not None
    frames, poses = [], []
    for time_s in np.arange(FIRST_S, FIRST_S + seconds, 1 / hz).tolist():
        T = course.T_map_base(time_s)
        poses.append(T @ T_base_left)
        if made == "corners":
            seen: Sequence[Sequence[Detection]] = course.corners(T)
        else:
            models = [camera.model for camera in mounted_cameras(course.rig)]
            images = course.images(T)
            if made == "cameras":
                images = tuple(processed(image, chain, rng) for image in images)
            seen = [detect_landmarks(i, DetectOptions(camera=m)) for i, m in zip(images, models, strict=True)]
        frames.append(RigFrame(time_s, tuple(map(tuple, seen)), ""))
    motion = MotionModel(Odometry(*course.wheels.T), Gyro(*course.gyro.T))
    return Drive(frames, course.rig, motion, poses, course.landmarks)


def processed(image: np.ndarray, chain: ImagingChain, rng: np.random.Generator) -> np.ndarray:
    """A quick image as a camera's sensor and processing leave it."""
    light_k = chain.light.temperature_k
    received = srgb_to_linear(np.arange(256) / 255)[image[:, :, ::-1]] * black_body_rgb(light_k)
    return develop(count_electrons(received, chain.sensor, rng), chain.development, light_k)


def rendered(folder: Path) -> Drive:
    """The rendered recording; its code that is mounted twice is not in the true map."""
    from locate import read_truth, true_map, true_rig

    from lmkit.geometry.stereo_rig import StereoRig
    from lmkit.io.recording_tables import read_gyro, read_odometry
    from lmkit.model.landmark import LM8
    from lmkit.pipelines.detect_recording import see_drive

    truth = read_truth(folder)
    body, cameras = truth["body_T_left"], true_rig(truth)
    T_base_left = Pose.from_quaternion("base", "left", body["position"], body["quaternion_xyzw"])
    rig = StereoRig(cameras.left, cameras.right, cameras.T_right_left, T_base_left)
    images = folder / "images"
    frames = list(see_drive([f"{images}/*_L.jpg", f"{images}/*_R.jpg"], rig, (LM8,), truth["timing"]["camera_hz"]))
    mounted = LandmarkMap([m for room in truth["maps"] for m in true_map(truth, int(room))])
    motion = MotionModel(read_odometry(folder / "odometry.csv"), read_gyro(folder / "gyro.csv"))
    poses = [
        Pose.from_quaternion("map", "left", world["position"], world["quaternion_xyzw"])
        for world in (pair["T_world_left"] for pair in truth["pairs"])
    ]
    return Drive(frames, rig, motion, poses, mounted)


def with_errors(drive: Drive, factor: float) -> Drive:
    """The recording with so many times its corners' errors."""
    frames = []
    for frame, pose in zip(drive.frames, drive.poses, strict=True):
        seen = []
        cameras = zip(frame.seen, T_map_cameras(drive.rig, pose), mounted_cameras(drive.rig), strict=True)
        for some, T_map_camera, camera in cameras:
            mounted = [(one, drive.landmarks.find(one.id)) for one in some]
            T = T_map_camera.inverse()
            true = [(one, camera.model.project(T.apply(m.corners_map))) for one, m in mounted if m is not None]
            seen.append(tuple(replace(one, corners=at + factor * (one.corners - at)) for one, at in true))
        frames.append(replace(frame, seen=tuple(seen)))
    return replace(drive, frames=frames)


def surveyed(drive: Drive, rig: AnyRig, by_images: bool = False) -> Errors | None:
    """The survey that knows the landmark seen most; None where that placed fewer than two others."""
    seen = Counter(o.id for frame in drive.frames for o in frame.detections if drive.landmarks.find(o.id))
    anchor = drive.landmarks.find(seen.most_common(1)[0][0])
    assert anchor is not None
    sizes = {o.id: anchor.size_m for frame in drive.frames for o in frame.detections}
    anchors = {anchor.id: Anchor(anchor, None)}
    solved = solve_recording(drive.frames, rig, sizes, anchors, None if by_images else drive.motion)
    return judged(survey_of(solved, anchors), drive, {anchor.id}, solved.problem.swelling)


def true_swelling(drive: Drive) -> FloatArray:
    """(2,) median distance of corners outside their places along width and height, px."""
    outside = []
    for frame, pose in zip(drive.frames, drive.poses, strict=True):
        cameras = zip(frame.seen, T_map_cameras(drive.rig, pose), mounted_cameras(drive.rig), strict=True)
        for seen, T_map_camera, camera in cameras:
            for one in seen:
                m = drive.landmarks.find(one.id)
                if m is not None:
                    true = camera.model.project(T_map_camera.inverse().apply(m.corners_map))
                    off = (one.corners - true) * [[[-1], [1], [1], [-1]], [[-1], [-1], [1], [1]]]
                    directions = true[[1, 3]] - true[0]
                    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
                    outside.append((off * directions[:, None]).sum(axis=2).mean(axis=1))
    return np.asarray(np.median(outside, axis=0))


def judged(found: Survey, drive: Drive, known: set, swelling: FloatArray) -> Errors | None:
    rows, errors = [], []
    for k, m in enumerate(found.bundle.landmarks):
        true = drive.landmarks.find(m.id)
        if true is not None and m.id not in known:
            rows.append(k)
            errors.append(_between(m.T_map_landmark, true.T_map_landmark))
    if len(rows) < 2:
        return None
    e = np.array(errors)
    place = (6 * np.array(rows)[:, None] + np.arange(3)).ravel()
    C = found.bundle.joint[np.ix_(place, place)]
    whole = [found.bundle.joint[6 * k : 6 * k + 6, 6 * k : 6 * k + 6] for k in rows]
    own = np.array([one[:3, :3] for one in whole])
    nees = _nees(e[:, :3], own)
    joint = float(_nees(e[None, :, :3].reshape(1, -1), C[None])[0])
    poses = [
        _between(pose, drive.poses[row]) for row, pose in zip(found.rows, found.bundle.left_poses(), strict=True)
    ]
    drawn = np.random.default_rng(0).multivariate_normal(np.zeros(len(C)), C, DRAWS).reshape(DRAWS, -1, 3)
    means = np.mean([_nees(drawn[:, k], np.broadcast_to(own[k], (DRAWS, 3, 3))) for k in range(len(own))], axis=0) / 3
    return Errors(
        float(nees.mean() / 3),
        (float(np.percentile(means, 2.5)), float(np.percentile(means, 97.5))),
        float(_nees(e, np.array(whole)).mean() / 6),
        float(_nees(np.array(poses), found.bundle.covariances).mean() / 6),
        joint / len(C),
        float(chi2.sf(joint, len(C))),
        float((nees < chi2.ppf(0.95, 3)).mean()),
        1000 * float(np.sqrt((e[:, :3] ** 2).sum(axis=1).mean())),
        len(rows),
        swelling,
        true_swelling(drive),
        _size(found, drive),
    )


def _size(found: Survey, drive: Drive) -> float:
    """Factor by which the landmarks lie further apart than in truth, fitted to maps turned alike, less 1."""
    both = [(m, drive.landmarks.find(m.id)) for m in found.bundle.landmarks]
    places = np.array([(m.T_map_landmark.t, true.T_map_landmark.t) for m, true in both if true is not None])
    mine, true = (places - places.mean(axis=0)).transpose(1, 0, 2)
    return float(np.linalg.svd(mine.T @ true, compute_uv=False).sum() / (true**2).sum()) - 1


def _between(found: Pose, true: Pose) -> FloatArray:
    return np.concatenate([found.t - true.t, rotation_log(found.R @ true.R.T)])


def _nees(errors: FloatArray, covariances: FloatArray) -> FloatArray:
    solved = np.linalg.solve(covariances, errors[..., None])[..., 0]
    return np.asarray((errors * solved).sum(axis=1))


def line(name: str, one: Errors) -> str:
    low, high = one.honest
    swelling = " of ".join(" / ".join(f"{px:.3f}" for px in both) for both in (one.swelling, one.true_swelling))
    return (
        f"| {name} | {one.landmarks} | {one.places:.2f} ({low:.2f} to {high:.2f}) | {one.six:.2f} | {one.rig:.2f} | "
        f"{one.joint:.2f} ({one.tail:.2f}) | {100 * one.inside:.0f} | {one.rms_mm:.1f} | {swelling} |"
    )


def summary(all_: Sequence[Errors]) -> str:
    def mean(values: Sequence[float] | FloatArray, digits: int = 2) -> str:
        low, high = np.percentile(values, [10, 90])
        error = np.std(values) / np.sqrt(len(values))
        return f"{np.mean(values):.{digits}f} ± {error:.{digits}f} ({low:.{digits}f} to {high:.{digits}f})"

    fits = np.mean([one.honest[0] < one.places < one.honest[1] for one in all_])
    tails = np.mean([one.tail > 0.05 for one in all_])
    inside = np.average([one.inside for one in all_], weights=[one.landmarks for one in all_])
    found, true = (np.array([getattr(one, name) for one in all_]) for name in ("swelling", "true_swelling"))
    return (
        f"{len(all_)} maps, {sum(one.landmarks for one in all_)} landmarks: NEES/3 {mean([o.places for o in all_])}, "
        f"in the honest range {100 * fits:.0f} %; NEES/6 {mean([o.six for o in all_])}; "
        f"poses NEES/6 {mean([o.rig for o in all_])}; joint {mean([o.joint for o in all_])}, "
        f"{100 * tails:.0f} % below the 95 % limit; places inside 95 % ellipsoids {100 * inside:.0f} %; "
        f"rms {np.sqrt(np.mean([o.rms_mm**2 for o in all_])):.1f} mm; swelling along width {mean(found[:, 0], 3)} of "
        f"{mean(true[:, 0], 3)} px, along height {mean(found[:, 1], 3)} of {mean(true[:, 1], 3)} px, "
        f"found less true rms {np.sqrt(((found - true) ** 2).mean()):.3f} px; "
        f"size {mean(100 * np.array([o.size for o in all_]), 3)} %"
    )


def kept(folder: Path | None, seed: int, given: argparse.Namespace) -> Drive:
    """A simulated recording, read if it was made before."""
    if folder is None:
        return simulated(seed, given.seconds, given.hz, given.made, given.cameras)
    path = folder / f"{given.made}-{given.cameras}-{given.hz:g}-{given.seconds:g}-{seed}.pickle"
    if not path.exists():
        folder.mkdir(parents=True, exist_ok=True)
        path.write_bytes(pickle.dumps(simulated(seed, given.seconds, given.hz, given.made, given.cameras)))
    drive = pickle.loads(path.read_bytes())
    assert isinstance(drive, Drive)
    return drive


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=32.0)
    parser.add_argument("--hz", type=float, default=2.5)
    parser.add_argument("--made", choices=["corners", "quick", "cameras"], default="quick")
    parser.add_argument("--cameras", type=int, default=2)
    parser.add_argument("--rig-off", type=float, default=0.0)
    parser.add_argument("--no-odometry", action="store_true")
    parser.add_argument("--errors", type=float, default=1.0)
    parser.add_argument("--drive", type=Path)
    parser.add_argument("--keep", type=Path)
    given = parser.parse_args()
    cv2.setNumThreads(1)
    columns = "NEES/3 (honest) | NEES/6 | poses, NEES/6 | joint (tail) | inside, % | rms mm | swelling px"
    print(f"| recording | landmarks | {columns} |")
    print("|---|---|---|---|---|---|---|---|---|")
    if given.drive:
        drive = rendered(given.drive)
        one = surveyed(drive, drive.rig, given.no_odometry)
        assert one is not None
        print(line("rendered", one))
        return
    all_ = []
    for seed in range(given.first, given.first + given.seeds):
        drive = kept(given.keep, seed, given)
        if given.errors != 1:
            drive = with_errors(drive, given.errors)
        off = np.random.default_rng([seed, 22]).normal(0, given.rig_off, 3)
        rig = turned(drive.rig, off) if given.rig_off else drive.rig
        if (errors := surveyed(drive, rig, given.no_odometry)) is not None:
            all_.append(errors)
            print(line(str(seed), errors), flush=True)
    print(summary(all_))


if __name__ == "__main__":
    sys.exit(main())
