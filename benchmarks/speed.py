"""Times of whole tasks on one thread, beside the figures before compiled kernels.

    uv run python benchmarks/speed.py [ROW ...] [--where]

Each row is run `n` times in this process; whole commands run in processes of their own, by the processor time of the
process, but for `lmkit demo`, which keeps all cores busy and is timed by the clock on the wall.
The table gives the median and the spread from the 10th to the 90th percentile, and beside a task that another library
does too, the median time of that library on the same input.  `before` was measured before the
kernels came, on the same kind of machine; `LMKIT_KERNELS=numpy` shows what the numpy definitions alone take.
`--where` runs each row once more under a profiler and lists the functions with most time of their own.  Detection
beside ArUco is in `detection_speed.py`, its cost against what is in the image in `detection_cost.py`.
"""

from __future__ import annotations

import argparse
import cProfile
import os
import pstats

for _variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")

import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path

import cv2
import numpy as np
from detection_cost import QUIET_PX, sheet

from lmkit.arrays import ByteArray
from lmkit.calibration.stereo import calibrate_stereo
from lmkit.detection.boards import detect_board
from lmkit.detection.detector import detect_landmarks
from lmkit.geometry.planar import planar_pose
from lmkit.geometry.pose import Pose
from lmkit.io.floor_plan import read_floor
from lmkit.io.landmark_map import map_to_yaml
from lmkit.io.rig import rig_to_yaml
from lmkit.kernels.load import describe
from lmkit.localization.absolute_pose import locate_rig
from lmkit.mapping.survey import survey_frames
from lmkit.model.board import BoardSpec
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import LandmarkMap, MappedLandmark, wall_pose
from lmkit.model.observation import Detection, PairView
from lmkit.planning.coverage import Demand
from lmkit.planning.mounting_sites import MountingOptions
from lmkit.planning.placement import place_landmarks
from lmkit.simulation.observations import look
from lmkit.simulation.photograph import ImagingChain, photograph
from lmkit.simulation.recording import T_BASE_LEFT, make_drive
from lmkit.simulation.scene import board_panel, board_poses, make_rig, studio
from lmkit.tracking.planar_stereo_filter import RigFilter
from lmkit.tracking.spatial_stereo_filter import PoseFilter

HERE = Path(__file__).resolve().parent
RIG = replace(make_rig(), T_base_left=T_BASE_LEFT)
NOISE_PX = 0.15
PROFILERS: list[cProfile.Profile] = []  # of the row that is profiled
LISTED = 8


@dataclass(frozen=True)
class Row:
    """One line of the table: what is timed, the figure before, the seconds of each run, and those of a peer."""

    name: str
    before: str
    run: Callable[[], Iterator[float]]
    peer: str = ""
    run_peer: Callable[[], Iterator[float]] | None = None


def timed(work: Callable[[], object], clock: Callable[[], float] = time.process_time) -> float:
    """Seconds of this process's own time, so that a busy machine does not matter, or by another clock."""
    start = clock()
    if PROFILERS:
        PROFILERS[-1].runcall(work)
    else:
        work()
    return clock() - start


@lru_cache(maxsize=1)
def four_in_view() -> tuple[LandmarkMap, list[tuple[list[Detection], list[Detection]]]]:
    """Four landmarks around a robot's view, 50 poses, corners with noise."""
    mounted = [
        MappedLandmark(LandmarkId("lm8", k), 0.18, wall_pose([4.0, 0.7 * k - 1.05, 1.2], np.pi)) for k in range(4)
    ]
    landmarks, rng, seen = LandmarkMap(mounted), np.random.default_rng(1), []
    while len(seen) < 50:
        state = np.array([rng.uniform(0.5, 1.5), rng.uniform(-0.4, 0.4), rng.uniform(-0.1, 0.1)])
        pair = look(landmarks, RIG, planar_pose(state), NOISE_PX, rng)
        if all(len(side) == 4 for side in pair):
            seen.append(pair)
    return landmarks, seen


def locate_four() -> Iterator[float]:
    """Both cameras, with covariance and every other pose that the corners allow."""
    landmarks, seen = four_in_view()
    for left, right in [*seen[:3], *seen]:
        yield timed(lambda left=left, right=right: locate_rig((left, right), RIG, landmarks))


def opencv_locate() -> Iterator[float]:
    """The left camera alone: `solvePnP` of all corners, no covariance."""
    landmarks, seen = four_in_view()
    corners_of = {m.id: m.corners_map for m in landmarks}

    def work(left: list[Detection]) -> None:
        points = np.concatenate([corners_of[o.id] for o in left])
        pixels = np.concatenate([o.corners for o in left])
        cv2.solvePnP(points, pixels, RIG.left.K, RIG.left.distortion)

    for left, _ in [*seen[:3], *seen]:
        yield timed(lambda left=left: work(left))


def live_wheels() -> Iterator[float]:
    """Each observation of a filter on wheels, a recording of a minute at 5 Hz."""
    drive = make_drive(1)
    filter_, rows = RigFilter(drive.landmarks, drive.rig), 0
    odometry = drive.odometry
    for frame in drive.frames:
        while rows < len(odometry.times_s) and odometry.times_s[rows] <= frame.time_s:
            filter_.wheels.add_odometry(
                float(odometry.times_s[rows]), float(odometry.forward_m[rows]), float(odometry.turn_rad[rows])
            )
            rows += 1
        yield timed(lambda frame=frame: filter_.observe(frame.time_s, frame.seen))


def live_poses() -> Iterator[float]:
    """Each observation of a filter on visual odometry, a recording of a minute at 5 Hz."""
    drive = make_drive(1)
    odometry = drive.visual_odometry(1)
    filter_ = PoseFilter(drive.landmarks, drive.rig)
    for k, frame in enumerate(drive.frames):
        filter_.add_odometry(float(odometry.times_s[k]), odometry.pose(k, "odometry", "base"))
        yield timed(lambda frame=frame: filter_.observe(frame.time_s, frame.seen))


def survey() -> Iterator[float]:
    """100 landmarks, 500 frames, no odometry; from observations alone, with covariances."""
    drive = make_drive(3, seconds=100.0, hz=5.0, count=100)
    sizes = {m.id: m.size_m for m in drive.landmarks}
    for _ in range(3):
        yield timed(lambda: survey_frames(drive.frames, drive.rig, sizes, {}))


@lru_cache(maxsize=1)
def board_views() -> tuple[BoardSpec, list[PairView]]:
    """30 pairs of 640 x 480 pixels, corners with noise."""
    rig, board, rng = make_rig(), BoardSpec("chessboard", 9, 6, 25.0), np.random.default_rng(1)
    points, ids, views = board.object_points, np.arange(54), []
    for k, pose in enumerate(board_poses(1, rig, board, 30)):
        left = pose.apply(points)
        right = left @ rig.T_right_left.R.T + rig.T_right_left.t
        corners = [camera.project(p) for camera, p in ((rig.left, left), (rig.right, right))]
        noisy = [pixels + rng.normal(0, 0.1, pixels.shape) for pixels in corners]
        views.append(PairView(f"{k:02d}", ids, noisy[0], ids, noisy[1]))
    return board, views


def calibrate() -> Iterator[float]:
    """Corners given; three lens models compared on pairs left out."""
    board, views = board_views()
    for _ in range(3):
        yield timed(lambda: calibrate_stereo(views, board, (640, 480)))


def opencv_calibrate() -> Iterator[float]:
    """One lens model: each camera for itself, then everything together."""
    board, views = board_views()
    objects = [board.object_points.astype(np.float32)] * len(views)
    left, right = (
        [np.float32(side) for side in sides] for sides in zip(*((v.left, v.right) for v in views), strict=True)
    )

    def work() -> None:
        size = (640, 480)
        _, K1, D1, _, _ = cv2.calibrateCamera(objects, left, size, None, None)
        _, K2, D2, _, _ = cv2.calibrateCamera(objects, right, size, None, None)
        cv2.stereoCalibrate(objects, left, right, K1, D1, K2, D2, size, flags=cv2.CALIB_USE_INTRINSIC_GUESS)

    for _ in range(3):
        yield timed(work)


@lru_cache(maxsize=1)
def board_images() -> tuple[BoardSpec, list[ByteArray]]:
    """Eight pairs of 1280 x 720 pixels, rendered, with lens distortion, blur and noise."""
    rig, board, rng = make_rig((1280, 720), 900.0), BoardSpec("chessboard", 9, 6, 25.0), np.random.default_rng(1)
    T_right_left = Pose("camera", "camera", rig.T_right_left.R, rig.T_right_left.t)
    images = []
    for pose in board_poses(1, rig, board, 8):
        scene = studio([board_panel(board, Pose("map", "board", pose.R, pose.t))])
        at_left = Pose.identity("map", "camera")
        for camera, at in ((rig.left, at_left), (rig.right, at_left @ T_right_left.inverse())):
            images.append(photograph(scene, camera, at, ImagingChain(), rng))
    return board, images


def corners() -> Iterator[float]:
    """Each image, whose board is found."""
    board, images = board_images()
    assert all(detect_board(image, board) is not None for image in images)
    for image in images:
        yield timed(lambda image=image: detect_board(image, board))


def opencv_corners() -> Iterator[float]:
    """`findChessboardCornersSB` with the accuracy that calibration needs."""
    board, images = board_images()

    def work(image: ByteArray) -> None:
        gray = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
        cv2.findChessboardCornersSB(gray, board.inner_corners, flags=cv2.CALIB_CB_ACCURACY)

    for image in images:
        yield timed(lambda image=image: work(image))


def in_a_grid(faces: list[ByteArray]) -> ByteArray:
    """640 x 480 pixels with up to 64 papers, slightly blurred and noisy."""
    rng = np.random.default_rng(0)
    image = np.full((480, 640, 3), 110.0)
    for k, face in enumerate(faces):
        row, column = divmod(k, 8)
        height, width = face.shape[:2]
        image[60 * row + 6 :, 80 * column + 15 :][:height, :width] = face
    noisy = cv2.GaussianBlur(image, (0, 0), 0.7) + rng.normal(0, 2.0, image.shape)
    return np.clip(np.round(noisy), 0, 255).astype(np.uint8)


def detect_many(count: int) -> Iterator[float]:
    """Landmarks of 30 px, all of them read."""
    image = in_a_grid([sheet("lm8", 3 * k + 1, 30) for k in range(count)])
    assert len(detect_landmarks(image)) == count
    for _ in range(10):
        yield timed(lambda: detect_landmarks(image))


def aruco_many(count: int) -> Iterator[float]:
    """ArUco markers of that size in their places."""
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_250)
    edge = [QUIET_PX] * 4
    faces = [cv2.aruco.generateImageMarker(dictionary, 3 * k + 1, 30) for k in range(count)]
    image = in_a_grid(
        [
            cv2.cvtColor(cv2.copyMakeBorder(f, *edge, cv2.BORDER_CONSTANT, value=255), cv2.COLOR_GRAY2BGR)
            for f in faces
        ]
    )
    detector = cv2.aruco.ArucoDetector(dictionary)
    for _ in range(11):
        yield timed(lambda: detector.detectMarkers(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)))


def place() -> Iterator[float]:
    """Landmarks placed on the office floor, 30 x 20 m, as `lmkit plan place` does by default."""
    floor = read_floor(HERE / "floors" / "office.yaml")
    yield timed(lambda: place_landmarks(floor, [], RIG, 0.25, Demand(), MountingOptions("lm8")))


def of_children() -> float:
    """Processor time of all processes that were started and have ended, seconds."""
    times = os.times()
    return times.children_user + times.children_system


def command(*arguments: str, cwd: str, clock: Callable[[], float] = of_children) -> float:
    """One `lmkit` process; it may find nothing (exit code 1)."""

    def run() -> None:
        code = "from lmkit.cli.main import main; main()"
        ended = subprocess.run([sys.executable, "-c", code, *arguments], check=False, capture_output=True, cwd=cwd)
        assert ended.returncode in (0, 1), ended.stderr.decode()

    return timed(run, clock)


def generate() -> Iterator[float]:
    """`lmkit generate` of 256 codes as one PDF, read back before it is written."""
    for _ in range(2):
        with tempfile.TemporaryDirectory() as folder:
            yield command("generate", "--codes", "0-255", "-o", "all.pdf", cwd=folder)


def demo() -> Iterator[float]:
    """`lmkit demo`, on all cores."""
    with tempfile.TemporaryDirectory() as folder:
        yield command("demo", cwd=folder, clock=time.perf_counter)


def aruco_command() -> Iterator[float]:
    """A Python process that imports OpenCV, reads an image and looks for ArUco markers."""
    code = (
        "import cv2; aruco = cv2.aruco; dictionary = aruco.getPredefinedDictionary(aruco.DICT_4X4_250); "
        "aruco.ArucoDetector(dictionary).detectMarkers(cv2.imread('left.png', 0))"
    )
    with tempfile.TemporaryDirectory() as folder:
        write_inputs(Path(folder))
        for _ in range(8):
            yield timed(lambda: subprocess.run([sys.executable, "-c", code], check=True, cwd=folder), of_children)


def detect_command() -> Iterator[float]:
    """`lmkit detect one.png` as a whole process, 640 x 480."""
    with tempfile.TemporaryDirectory() as folder:
        write_inputs(Path(folder))
        for _ in range(8):
            yield command("detect", "left.png", cwd=folder)


def locate_command() -> Iterator[float]:
    """`lmkit locate` of one pair as a whole process, 640 x 480."""
    with tempfile.TemporaryDirectory() as folder:
        write_inputs(Path(folder))
        for _ in range(8):
            yield command("locate", "left.png", "right.png", "--rig", "rig.yaml", "--map", "map.yaml", cwd=folder)


def write_inputs(folder: Path) -> None:
    """A rig, a map, and a pair of noisy images without landmarks: what is timed is mostly loading."""
    (folder / "rig.yaml").write_text(rig_to_yaml(RIG))
    mounted = MappedLandmark(LandmarkId("lm8", 1), 0.18, wall_pose([4.0, 0.0, 1.2], np.pi))
    (folder / "map.yaml").write_text(map_to_yaml(LandmarkMap([mounted])))
    image = np.random.default_rng(0).integers(90, 160, (480, 640, 3)).astype(np.uint8)
    image = cv2.GaussianBlur(image, (0, 0), 2.0)
    for name in ("left.png", "right.png"):
        cv2.imwrite(str(folder / name), image)


ROWS = {
    "locate": Row(
        "locate, 4 landmarks in two cameras", "3.1 ms", locate_four, "OpenCV, solvePnP, one camera", opencv_locate
    ),
    "live-wheels": Row("live step, wheels", "2.1 ms", live_wheels),
    "live-poses": Row("live step, poses", "2.8 ms", live_poses),
    "survey": Row("survey, 100 landmarks x 500 frames", "11 s", survey),
    "calibrate": Row(
        "calibrate, 30 pairs 640x480, corners given",
        "3.4 s",
        calibrate,
        "OpenCV, joint fit, one model",
        opencv_calibrate,
    ),
    "corners": Row(
        "corners of a chessboard, an image of 1280x720", "0.71 s", corners, "OpenCV, SB, accurate", opencv_corners
    ),
    "one": Row("detect, 1 landmark of 30 px", "", partial(detect_many, 1), "ArUco", partial(aruco_many, 1)),
    "many": Row("detect, 64 landmarks of 30 px", "", partial(detect_many, 64), "ArUco", partial(aruco_many, 64)),
    "place": Row("plan place, office 30 x 20 m", "51 s", place),
    "generate": Row("generate 256 codes, proven", "9 to 20 s", generate),
    "demo": Row("`lmkit demo`", "32 to 45 s", demo),
    "detect-command": Row(
        "`lmkit detect one.png`, whole process", "", detect_command, "OpenCV, ArUco", aruco_command
    ),
    "locate-command": Row("`lmkit locate`, whole process", "", locate_command),
}
COMMANDS = ("generate", "demo", "detect-command", "locate-command")  # processes of their own


def answer(seconds: float) -> str:
    return f"{seconds:.2f} s" if seconds >= 1 else f"{1000 * seconds:.2f} ms"


def print_where(row: Row) -> None:
    """The functions with the largest share of a row's time; a kernel's time is its wrapper's."""
    PROFILERS.append(cProfile.Profile())
    list(row.run())
    found = pstats.Stats(PROFILERS.pop()).get_stats_profile()
    ranked = sorted(found.func_profiles.items(), key=lambda entry: -entry[1].tottime)
    print(f"\n{row.name}")
    for name, entry in ranked[:LISTED]:
        place = f" {Path(entry.file_name).stem}.py:{entry.line_number}" if entry.line_number else ""
        print(f"  {100 * entry.tottime / max(found.total_tt, 1e-9):4.1f} %  {name}{place}, {entry.ncalls} calls")


def main(names: list[str], where: bool) -> None:
    cv2.setNumThreads(1)
    print(f"{describe()}\n")
    print(
        "| task | before | now (median) | 10th to 90th percentile | n | peer | peer (median) |\n" + 7 * "|---" + "|"
    )
    for name in names or list(ROWS):
        row = ROWS[name]
        runs = np.array(list(row.run()))
        low, high = np.percentile(runs, [10, 90])
        now, spread = answer(float(np.median(runs))), f"{answer(low)} to {answer(high)}"
        peer = "" if row.run_peer is None else answer(float(np.median(list(row.run_peer()))))
        print(f"| {row.name} | {row.before} | {now} | {spread} | {len(runs)} | {row.peer} | {peer} |", flush=True)
    for name in names or list(ROWS):
        if where and name not in COMMANDS:
            print_where(ROWS[name])


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Times of whole tasks on one thread.")
    parser.add_argument("rows", nargs="*", metavar="ROW", help=f"all, or some of: {', '.join(ROWS)}")
    parser.add_argument("--where", action="store_true", help="list the functions that take most of a row's time")
    arguments = parser.parse_args()
    rows = arguments.rows
    if unknown := [name for name in rows if name not in ROWS]:
        parser.error(f"no row {unknown[0]!r}; the rows are {', '.join(ROWS)}")
    main(rows, arguments.where)
