"""Every command with a small valid input, and the inputs that tests damage."""

from __future__ import annotations

import json
import random
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
from bag_files import write_bag
from command_line import Answer, run_command
from harmed_files import NUMBERS, PIECES, harm_bytes, harm_document, harm_table, harm_text


def write_inputs(folder: Path, images: bool = True) -> None:
    """One small valid file of every kind.

    Args:
        images: images, prints, corners and a bag as well; they take seconds.
    """
    from lmkit.demos.example_files import FLOOR
    from lmkit.geometry.rig import as_stereo
    from lmkit.io.external_maps import map_to_tagslam, map_to_wpilib
    from lmkit.io.kalibr import rig_to_camchain
    from lmkit.io.landmark_map import map_to_yaml
    from lmkit.io.opencv_rig import rig_to_opencv_yaml
    from lmkit.io.recording_tables import detections_to_csv, gyro_to_csv, odometry_to_csv
    from lmkit.io.rig import rig_to_yaml
    from lmkit.io.ros_camera_info import rig_to_camera_infos
    from lmkit.io.trajectory import poses_to_tum
    from lmkit.simulation.recording import make_drive

    drive = make_drive(3, seconds=8.0, size_m=(8.0, 5.0))
    rig = as_stereo(drive.rig, "a test")
    left, right = rig_to_camera_infos(rig)
    readings = [
        f"{time_s:.3f},{r.id.code},{r.range_m:.4f},{r.bearing_rad:.5f}"
        for time_s, seen in drive.readings(3)
        for r in seen
    ]
    poses = poses_to_tum([(float(t), drive.pose(k)) for k, t in enumerate(drive.times_s)])
    room = np.full((50, 80), 254, np.uint8)
    room[[0, -1]] = room[:, [0, -1]] = 0
    run = "sources: [left.png, right.png]\nrig: rig.yaml\nmap: map.yaml\nto: [stdout]\n"
    thresholds = "negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.2\n"
    (folder / "ros").mkdir()
    texts = {
        "rig.yaml": rig_to_yaml(rig),
        "map.yaml": map_to_yaml(drive.landmarks),
        "floor.yaml": FLOOR.format(8.0, 5.0),
        "detections.csv": detections_to_csv(drive.frames),
        "odometry.csv": odometry_to_csv(drive.odometry),
        "gyro.csv": gyro_to_csv(drive.gyro),
        "truth.tum": poses,
        "truth2.tum": poses,
        "readings.csv": "\n".join(["time_s,code,range_m,bearing_rad", *readings]) + "\n",
        "form.csv": "code,wall,left_m,height_m\n1,north,1.0,1.2\n2,east,0.5,1.2\n3,west,2,1.2\n",
        "rig_opencv.yml": rig_to_opencv_yaml(rig),
        "rig_kalibr.yaml": rig_to_camchain(rig)[0],
        "ros/left.yaml": left,
        "ros/right.yaml": right,
        "map_tagslam.yaml": map_to_tagslam(drive.landmarks),
        "map_wpilib.json": map_to_wpilib(drive.landmarks, (8.0, 5.0)),
        "run.yaml": f"format: lmkit-run/1\n{run}",
        "template.toml": (Path(__file__).parents[1] / "templates" / "a4.toml").read_text(),
        "floor.dxf": _drawing(),
        "camera.json": json.dumps(
            {
                "resolution": {"width": 1280.0, "height": 720.0},
                "cameraIntrinsics": {"rows": 3, "cols": 3, "data": [700.0, 0, 640, 0, 700, 360, 0, 0, 1]},
                "distCoeffs": {"rows": 1, "cols": 8, "data": [0.05, -0.07, 0, 0, 0.01, 0, 0, 0]},
            }
        ),
        "floor_ros.yaml": f"image: floor.png\nresolution: 0.1\norigin: [0, 0, 0]\n{thresholds}",
        "floor.svg": '<svg xmlns="http://www.w3.org/2000/svg" width="800" height="500"><rect x="1" y="1" width="790" '
        'height="490"/><g transform="translate(1 2)"><path d="M100 100h90v-30z"/></g></svg>',
    }
    for name, text in texts.items():
        (folder / name).write_text(text)
    cv2.imwrite(str(folder / "floor.png"), room)
    if images:
        _write_images(folder)


def _drawing() -> str:
    """A DXF drawing (R12): a room, an arc and a block."""
    corners = [(0, 0), (800, 0), (800, 500), (0, 500), (0, 0)]
    walls = "".join(f"0 LINE 8 WALL 10 {a[0]} 20 {a[1]} 11 {b[0]} 21 {b[1]} " for a, b in pairwise(corners))
    block = "0 BLOCK 8 0 2 B 70 0 10 0 20 0 30 0 3 B 0 LINE 8 0 10 0 20 0 11 90 21 0 0 ENDBLK"
    pairs = f"0 SECTION 2 BLOCKS {block} 0 ENDSEC 0 SECTION 2 ENTITIES {walls}"
    pairs += "0 ARC 8 DOOR 10 100 20 100 40 90 50 0 51 90 0 INSERT 8 WALL 2 B 10 300 20 100 50 30 0 ENDSEC 0 EOF"
    return "\n".join(pairs.split()) + "\n"


def _write_images(folder: Path) -> None:
    from lmkit.demos.example_files import write_example_files
    from lmkit.simulation.scene import make_rig

    write_example_files(folder / "example", board_pairs=5, seconds=2.0)
    for name in ("left.png", "right.png", "boards"):
        shutil.move(folder / "example" / name, folder / name)
    shutil.rmtree(folder / "example")
    boards = (folder / "boards/left", folder / "boards/right", "--board", "chessboard:9x6:25mm")
    for words in (
        ("generate", "--code", 5, "--bare", "--dpi", 60, "-o", folder / "landmark.png"),
        ("generate", "--code", 5, "-o", folder / "landmark.pdf"),
        ("calibrate", *boards, "--save-corners", folder / "corners.json", "--jobs", 1),
    ):
        answer = run_command(*words)
        assert answer.code == 0, answer.err
    write_bag(folder / "drive", make_rig(image_size=(64, 48)))


@dataclass(frozen=True)
class Case:
    """A command line that works.

    Attributes:
        words: names of ``files`` stand for the files.
        files: names of the files that the command reads.
        weight: how often the case is tried; slow ones rarely.
        folder: of images that the command reads as well.
    """

    words: str
    files: tuple[str, ...] = ()
    weight: float = 1.0
    folder: str = ""

    @property
    def name(self) -> str:
        """The command, and what distinguishes this case from others."""
        return " ".join(self.words.split()[:4])


_MOVED = "--odometry odometry.csv --gyro gyro.csv"
_PLACE = "--floor floor.yaml --rig rig.yaml --error 20cm"
CASES = (
    Case("locate --readings readings.csv --map map.yaml --json", ("readings.csv", "map.yaml"), 2),
    Case("locate left.png right.png --rig rig.yaml --map map.yaml --plan out/p.svg",
         ("left.png", "right.png", "rig.yaml", "map.yaml"), 0.2),
    Case("locate --mono left.png --rig rig.yaml --map map.yaml --json", ("left.png", "rig.yaml", "map.yaml"), 0.3),
    Case(f"track --detections detections.csv --rig rig.yaml --map map.yaml {_MOVED} --json",
         ("detections.csv", "rig.yaml", "map.yaml", "odometry.csv", "gyro.csv"), 2),
    Case("track --detections detections.csv --rig rig.yaml --map map.yaml --plan out/p.svg --report out/r.html "
         "--csv out/t.csv", ("detections.csv", "rig.yaml", "map.yaml"), 2),
    Case("track --detections detections.csv --rig rig.yaml --map map.yaml --odometry truth.tum",
         ("detections.csv", "rig.yaml", "map.yaml", "truth.tum")),
    Case(f"track --live --detections detections.csv --rig rig.yaml --map map.yaml {_MOVED}",
         ("detections.csv", "rig.yaml", "map.yaml", "odometry.csv", "gyro.csv")),
    Case(f"track --readings readings.csv --map map.yaml {_MOVED} --json",
         ("readings.csv", "map.yaml", "odometry.csv", "gyro.csv"), 2),
    Case(f"track --live --readings readings.csv --map map.yaml {_MOVED}",
         ("readings.csv", "map.yaml", "odometry.csv", "gyro.csv")),
    Case(f"survey --detections detections.csv --rig rig.yaml {_MOVED} -o out/m.yaml --plan out/p.svg",
         ("detections.csv", "rig.yaml", "odometry.csv", "gyro.csv")),
    Case("survey --detections detections.csv --rig rig.yaml --known map.yaml -o out/m.yaml --json",
         ("detections.csv", "rig.yaml", "map.yaml")),
    Case(f"survey --readings readings.csv {_MOVED} -o out/m.yaml", ("readings.csv", "odometry.csv", "gyro.csv")),
    Case("evaluate truth.tum truth2.tum --align scale --json", ("truth.tum", "truth2.tum"), 2),
    Case("map map.yaml --floor floor.yaml --plan out/p.svg -o out/m.yaml", ("map.yaml", "floor.yaml")),
    Case("map map.yaml --floor floor_ros.yaml --plan out/p.png", ("floor_ros.yaml", "floor.png")),
    Case("map map.yaml --floor floor.svg --scale 0.01 --plan out/p.png", ("floor.svg",)),
    Case("map map.yaml --floor floor.dxf --scale 0.01 --layers WALL --plan out/p.svg", ("floor.dxf",)),
    Case("map form.csv --room 8x5m --sigma 10mm,1deg -o out/m.yaml", ("form.csv",), 2),
    Case("plan coverage --floor floor.yaml --map map.yaml --rig rig.yaml --plan out/p.png",
         ("floor.yaml", "map.yaml", "rig.yaml"), 0.3),
    Case("plan route 1,1 6,3 --floor floor.yaml --map map.yaml --rig rig.yaml --csv out/r.csv --plan out/p.svg",
         ("floor.yaml", "map.yaml", "rig.yaml"), 0.3),
    Case(f"plan place {_PLACE} --map map.yaml --no-prints --patience 0 -o out/plan", ("floor.yaml", "rig.yaml"), 0.1),
    Case("convert rig.yaml --to kalibr -o out/k.yaml", ("rig.yaml",)),
    Case("convert rig.yaml --to ros -o out/ros", ("rig.yaml",)),
    Case("convert rig_opencv.yml --to lmkit -o out/r.yaml", ("rig_opencv.yml",)),
    Case("convert camera.json --to lmkit -o out/r.yaml", ("camera.json",)),
    Case("convert rig_kalibr.yaml --to opencv -o out/r.yaml", ("rig_kalibr.yaml",)),
    Case("convert ros --to lmkit -o out/r.yaml", ("ros/left.yaml", "ros/right.yaml")),
    Case("convert map_tagslam.yaml --to map -o out/m.yaml", ("map_tagslam.yaml",)),
    Case("convert map_wpilib.json --to tagslam -o out/m.yaml", ("map_wpilib.json",)),
    Case("convert map.yaml --to wpilib -o out/m.json", ("map.yaml",)),
    Case("convert truth.tum --to bag -o out/b.bag", ("truth.tum",)),
    Case("rectify left.png right.png --rig rig.yaml -o out/rect", ("left.png", "right.png", "rig.yaml"), 0.3),
    Case("detect left.png --json --annotate out/a --csv out/d.csv", ("left.png",), 0.2),
    Case("verify landmark.png --size 180mm --json", ("landmark.png",), 0.1),
    Case("verify landmark.pdf --certificate out/c.pdf", ("landmark.pdf", "landmark.pdf.json"), 0.1),
    Case("board chessboard:9x6:20mm -o out/b.svg"),
    Case("generate --code 3 --template template.toml -o out/g.svg", ("template.toml",), 0.3),
    Case("calibrate --corners corners.json -o out/r.yaml --report out/r.html", ("corners.json",), 0.3),
    Case("calibrate boards/left boards/right --check rig.yaml --board chessboard:9x6:25mm", ("rig.yaml",), 0.1,
         "boards"),
    Case("unbag drive -o out/bag", ("drive/drive.db3", "drive/metadata.yaml")),
    Case("run run.yaml --check", ("run.yaml", "rig.yaml", "map.yaml", "left.png", "right.png")),
    Case("run left.png right.png --hz 5 --rig rig.yaml --map map.yaml --to stdout --seconds 1",
         ("left.png", "rig.yaml", "map.yaml"), 0.05),
    Case("simulate --pairs 1 --boards 0 --landmarks 3 -o out/sim", (), 0.1),
    Case("generate --measured 179.2x179.0 --code 123 --map map.yaml --force", ("map.yaml",)),
)  # fmt: skip


def harmed(name: str, data: bytes, rng: random.Random, others: Mapping[str, bytes]) -> bytes:
    """The bytes of a file with something wrong."""
    kind = rng.random()
    if kind < 0.05:
        return rng.choice((b"", b"\0" * 100, b"\n", bytes(rng.randrange(256) for _ in range(500))))
    if kind < 0.1:
        return others[rng.choice(sorted(others))]
    suffix = Path(name).suffix
    if suffix in (".png", ".pdf", ".db3") or kind < 0.15:
        return harm_bytes(data, rng)
    text = data.decode("utf-8")
    if suffix in (".csv", ".tum") and kind < 0.8:
        return harm_table(text, rng).encode()
    if suffix in (".yaml", ".yml", ".json") and kind < 0.8:
        return harm_document(text, rng).encode("utf-8", "surrogatepass")
    return harm_text(text, rng).encode("utf-8", "surrogatepass")


def run_unharmed(case: Case, folder: Path, inputs: Mapping[str, bytes]) -> Answer:
    """Run a case unchanged in its folder, the working folder; its files are restored, and others are removed."""
    before = set(folder.iterdir())
    try:
        return run_command(*case.words.split())
    finally:
        _restore(case, folder, inputs, before)


def _restore(case: Case, folder: Path, inputs: Mapping[str, bytes], before: set[Path]) -> None:
    for name in case.files:
        (folder / name).write_bytes(inputs[name])
    for path in set(folder.iterdir()) - before:
        shutil.rmtree(path) if path.is_dir() else path.unlink()


def run_harmed(case: Case, folder: Path, inputs: Mapping[str, bytes], rng: random.Random) -> tuple[Answer, str]:
    """Run a case with one or two damaged files, or with a damaged option; the files are restored.

    Args:
        folder: contains the inputs; the working folder.

    Returns:
        the answer, and what was changed.
    """
    before = set(folder.iterdir())
    words = case.words.split()
    changed: list[str] = []
    if not case.files or rng.random() < 0.15:
        k = rng.randrange(1, len(words))
        words[k] = rng.choice(("", str(rng.choice(NUMBERS)), rng.choice(PIECES).replace("\0", ""), words[k] * 2, "-"))
        changed.append(f"word {k} {words[k]!r}")
    else:
        for name in rng.sample(case.files, min(len(case.files), rng.choice((1, 1, 1, 2)))):
            (folder / name).write_bytes(harmed(name, inputs[name], rng, inputs))
            changed.append(name)
    try:
        return run_command(*words), " ".join([*words, "|", *changed])
    finally:
        keep = folder.parent / "failed"
        if keep.is_dir():  # the tool keeps the files of the last case
            for name in case.files:
                shutil.copy(folder / name, keep / Path(name).name)
        _restore(case, folder, inputs, before)
