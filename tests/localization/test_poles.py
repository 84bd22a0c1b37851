"""Poles in laser scans: found, identified and located by; the source paper's own experiment."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import run_command

from lmkit.detection.scan_poles import ScanNoise, find_poles
from lmkit.errors import InputError
from lmkit.geometry.planar import wrap_heading
from lmkit.io.landmark_map import map_to_yaml, read_map
from lmkit.io.scans import read_scans, scans_to_csv
from lmkit.localization.pole_association import PosePriorPlanar, associate_poles
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import LandmarkMap, MappedLandmark, wall_pose
from lmkit.model.pose_status import PoseStatus
from lmkit.model.scan import POLE, LaserScan, ScannedPole, ScannerMount
from lmkit.pipelines.locate_scans import ScanSettings
from lmkit.simulation.recording import WheelErrors, make_drive
from lmkit.simulation.scanner import ScannedScene, ScannerModel, room_walls, scatter_clutter
from lmkit.tracking.laser_scans import track_scans

PAPER_POLES, PAPER_SCANNER = ((4.0, 2.0), (4.0, -1.0)), ScannerMount(0.160, 0.007)
FIVE = ((1.0, 1.0), (9.0, 1.5), (8.0, 6.5), (2.0, 5.5), (5.0, 7.0))
ROOM = (10.0, 8.0)


def poles(places: tuple[tuple[float, float], ...], diameter_m: float = 0.11) -> LandmarkMap:
    return LandmarkMap(
        [MappedLandmark(LandmarkId(POLE, k), diameter_m, wall_pose([*p, 0.0], 0.0)) for k, p in enumerate(places)]
    )


def at_base(scan: LaserScan) -> list[ScannedPole]:
    return [pole.seen_from_base(PAPER_SCANNER) for pole in find_poles(scan, [0.055])]


def test_a_pole_is_found_where_it_is_at_every_step_and_across_the_seam() -> None:
    landmarks, rng = poles(((3.0, 0.0),)), np.random.default_rng(1)
    scene = ScannedScene.of(landmarks, room_walls((12, 12), (-6, -6)))
    squared = []
    for step in (0.25, 0.5, 1.0):
        for heading in np.linspace(-math.pi, math.pi, 25):
            state = np.array([rng.uniform(-1, 1), rng.uniform(-1, 1), heading])
            (found,) = find_poles(scene.scan(state, ScannerModel(math.radians(step)), rng), [0.055])
            off = np.array([3.0, 0.0]) - state[:2]
            e = np.array([found.range_m - np.hypot(*off), found.bearing_rad - math.atan2(off[1], off[0]) + heading])
            e[1] = wrap_heading(e[1])
            squared.append(e @ np.linalg.solve(found.covariance, e))
    assert 0.3 < np.mean(squared) / 2 < 1.3
    assert np.mean(np.array(squared) < 5.99) > 0.9


def test_walls_and_things_of_other_widths_are_no_poles() -> None:
    rng = np.random.default_rng(2)
    scene = ScannedScene(room_walls(ROOM), np.zeros((0, 3)), np.array([[3.0, 3.0, 0.2], [6.0, 3.0, 0.01]]))
    assert not find_poles(scene.scan(np.array([4.5, 4.0, 0.3]), ScannerModel(), rng), [0.055])


@pytest.mark.parametrize("tables", [0, 6])
def test_poles_are_identified_by_their_distances_among_legs(tables: int) -> None:
    landmarks, located = poles(FIVE), 0
    for seed in range(12):
        rng = np.random.default_rng(seed)
        scene = ScannedScene.of(landmarks, room_walls(ROOM), scatter_clutter(rng, tables, ROOM))
        state = np.array([rng.uniform(3, 7), rng.uniform(2, 5), rng.uniform(-3, 3)])
        scan = scene.scan(state, ScannerModel(), rng, PAPER_SCANNER)
        found = associate_poles(at_base(scan), landmarks, None, scan, PAPER_SCANNER).estimate
        if found.status == PoseStatus.OK:
            assert found.pose is not None
            assert np.hypot(found.pose.x_m - state[0], found.pose.y_m - state[1]) < 0.05
            located += 1
    assert located >= (12 if tables == 0 else 8)


def test_two_poles_alike_are_ambiguous_until_the_pose_is_roughly_known() -> None:
    landmarks, rng = poles(PAPER_POLES), np.random.default_rng(3)
    scene = ScannedScene.of(landmarks, room_walls((8, 8), (-2, -4)))
    state = np.array([1.0, 0.5, 0.1])
    scan = scene.scan(state, ScannerModel(), rng, PAPER_SCANNER)
    found = at_base(scan)
    assert associate_poles(found, landmarks, None, None, PAPER_SCANNER).estimate.status != PoseStatus.OK
    rough = PosePriorPlanar(state + np.array([0.3, -0.3, 0.1]), np.diag([0.5, 0.5, 0.3]) ** 2)
    answer = associate_poles(found, landmarks, rough, scan, PAPER_SCANNER).estimate
    assert answer.status == PoseStatus.OK and answer.pose is not None
    assert np.hypot(answer.pose.x_m - 1.0, answer.pose.y_m - 0.5) < 0.03


def test_poles_of_two_diameters_need_no_rough_pose() -> None:
    a, b = poles(PAPER_POLES, 0.11), poles(PAPER_POLES, 0.3)
    landmarks, rng = LandmarkMap([next(iter(a)), list(b)[1]]), np.random.default_rng(4)
    scene = ScannedScene.of(landmarks, room_walls((8, 8), (-2, -4)))
    scan = scene.scan(np.array([1.0, 0.5, 0.1]), ScannerModel(math.radians(0.25), range_m=0.005), rng)
    answer = associate_poles(find_poles(scan, [0.055, 0.15]), landmarks, None, scan)
    assert {i.code for i in answer.estimate.inliers} <= {0, 1}
    assert answer.estimate.status != PoseStatus.AMBIGUOUS


def test_reflectors_before_a_wall_are_found_by_their_brightness() -> None:
    landmarks, rng = poles(((9.95, 4.0),)), np.random.default_rng(5)
    scene = replace(ScannedScene.of(landmarks, room_walls(ROOM)), bright=True)
    scan = scene.scan(np.array([5.0, 4.0, 0.0]), ScannerModel(), rng)
    assert not find_poles(scan, [0.055])
    (found,) = find_poles(scan, [0.055], ScanNoise(bright_from=500.0))
    assert found.range_m == pytest.approx(4.95, abs=0.04)


def test_the_command_gives_the_robots_pose_from_a_file(tmp_path: Path) -> None:
    landmarks, rng = poles(FIVE), np.random.default_rng(6)
    scene = ScannedScene.of(landmarks, room_walls(ROOM))
    state = np.array([4.0, 3.0, 2.0])
    scan = scene.scan(state, ScannerModel(), rng, PAPER_SCANNER, 12.5)
    (tmp_path / "scans.csv").write_text(scans_to_csv([scan]))
    (tmp_path / "map.yaml").write_text(map_to_yaml(landmarks))
    at = ["locate", "--scans", str(tmp_path / "scans.csv"), "--map", str(tmp_path / "map.yaml"), "--json"]
    answer = json.loads(run_command(*at, "--scanner", "0.16m,7mm").out)
    assert answer["status"] == "ok" and answer["ids"] == [f"pole:{k}" for k in range(5)]
    assert answer["position"] == pytest.approx(state[:2], abs=0.03)
    assert answer["heading_rad"] == pytest.approx(2.0, abs=0.01)
    assert run_command(*at, "--scanner", "0.16m").code == 2


def test_a_pole_in_a_map_needs_no_quaternion(tmp_path: Path) -> None:
    entry = "  - {code: 1, family: pole, size_m: 0.11, position: [4, 2, 0]}"
    (tmp_path / "map.yaml").write_text(f"format: lmkit-map/1\nframe: map\nlandmarks:\n{entry}\n")
    assert next(iter(read_map(tmp_path / "map.yaml"))).T_map_landmark.t[:2] == pytest.approx([4.0, 2.0])


def test_a_file_of_beams_reads_as_its_scans(tmp_path: Path) -> None:
    rows = ["time_s,angle_rad,range_m,intensity", *(f"1.5,{-0.1 + 0.01 * k:.4f},{2 + k},7" for k in range(20))]
    (tmp_path / "beams.csv").write_text("\n".join(rows) + "\n")
    (scan,) = read_scans(tmp_path / "beams.csv")
    assert scan.step_rad == pytest.approx(0.01) and scan.ranges_m[3] == 5.0 and scan.intensities is not None


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("time_s,angle_rad,range_m\n1,-90,2\n1,-89,2\n1,-88,2\n", "bad_scan"),
        ("time_s,angle_rad,range_m\n1,0.1,2000\n", "bad_scan"),
        ("x,y\n1,2\n", "bad_header"),
        ("time_s,angle_min_rad,angle_step_rad,r0,r1,r2\n", "no_scans"),
    ],
)
def test_wrong_files_are_refused(tmp_path: Path, text: str, code: str) -> None:
    (tmp_path / "scans.csv").write_text(text)
    with pytest.raises(InputError) as error:
        read_scans(tmp_path / "scans.csv")
    assert error.value.code == code


def test_beams_of_a_direction() -> None:
    scan = LaserScan(0.0, -math.pi, math.radians(1), np.ones(360))
    clockwise = LaserScan(0.0, math.pi, -math.radians(1), np.ones(360))
    assert scan.beam_at(0.0) == 180 and clockwise.beam_at(0.0) == 180
    assert scan.beam_at(math.radians(190)) == 10 and clockwise.beam_at(math.radians(90)) == 90
    assert LaserScan(0.0, -0.5, 0.01, np.ones(101)).beam_at(1.0) is None


@pytest.mark.slow
@pytest.mark.parametrize("live", [False, True])
def test_a_robot_is_tracked_while_its_scanner_rotates(tmp_path: Path, live: bool) -> None:
    made = make_drive(5, seconds=25, errors=WheelErrors(noise_per_root_m=0.01))
    landmarks, rng, model = poles(FIVE), np.random.default_rng(7), ScannerModel(math.radians(0.5))
    scene = ScannedScene.of(landmarks, room_walls(ROOM), np.array([[4.0, 2.5, 0.055], [3.0, 3.5, 0.05]]))
    scans = [scene.scan(s, model, rng, PAPER_SCANNER, t) for s, t in zip(made.truth, made.times_s, strict=True)]
    found = track_scans(scans, made.odometry, made.gyro, landmarks, ScanSettings(mount=PAPER_SCANNER), live=live)
    truth = dict(zip(made.times_s.tolist(), made.truth, strict=True))
    off = [np.hypot(*(T.t[:2] - truth[t][:2])) for t, T in zip(found.times_s.tolist(), found.poses, strict=True)]
    assert len(off) > 0.9 * len(scans)
    assert np.sqrt(np.mean(np.square(off))) < (0.03 if live else 0.02)


def test_poles_are_carried_to_the_end_of_a_slow_scan() -> None:
    motion, pole = np.array([0.1, 0.0, 0.2]), ScannedPole(3.0, 0.1, np.eye(2), 0.05, 3, 0, 0.0)
    moved = pole.carried(motion)
    c, s = math.cos(0.2), math.sin(0.2)
    assert np.array([[c, -s], [s, c]]) @ moved.point + motion[:2] == pytest.approx(pole.point)


def test_a_scan_without_any_echo_is_read_again(tmp_path: Path) -> None:
    path = tmp_path / "scans.csv"
    scans = [LaserScan(time_s, -0.2, 0.1, np.full(5, range_m)) for time_s, range_m in ((0.0, np.nan), (0.5, 2.0))]
    path.write_text(scans_to_csv(scans))
    assert [scan.ranges_m.tolist() for scan in read_scans(path)] == [
        pytest.approx([np.nan] * 5, nan_ok=True),
        [2.0] * 5,
    ]


def test_scans_come_out_of_a_bag(tmp_path: Path) -> None:
    pytest.importorskip("rosbags")
    from rosbags.rosbag2 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    kind, types = "sensor_msgs/msg/LaserScan", store.types
    with Writer(tmp_path / "bag", version=8) as writer:
        topic = writer.add_connection("/scan", kind, typestore=store)
        for k in range(2):
            header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](k, 500_000_000), "laser")
            ranges = np.array([0.05, 1.0, 2.0, np.inf, 40.0], dtype=np.float32)
            message = types[kind](
                header, -0.2, 0.2, 0.1, 0.001, 0.1, 0.1, 30.0, ranges, np.zeros(0, dtype=np.float32)
            )
            writer.write(topic, k, store.serialize_cdr(message, kind))
    scans = read_scans(tmp_path / "bag")
    assert [scan.time_s for scan in scans] == [0.5, 1.5] and scans[0].end_s == pytest.approx(0.504)
    assert np.isfinite(scans[0].ranges_m).tolist() == [False, True, True, False, False]
    with pytest.raises(InputError):
        read_scans(tmp_path / "bag", "/other")
