"""Inputs of 10 MB for each kind of file: CPU seconds and memory until a command answers or refuses.

Usage: ``python tools/large_inputs.py [NAME...]``.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from command_cases import write_inputs

BYTES = 10_000_000
MOST_S, MOST_MIB = 10.0, 1024  # to refuse, and of any answer
MOVED = "--rig rig.yaml --map map.yaml --odometry odometry.csv"


def rows(head: str, row: Callable[[int], str]) -> str:
    """A table of that size."""
    width = len(row(10**5)) + 1
    return head + "\n" + "\n".join(map(row, range(BYTES // width))) + "\n"


LANDMARK = "- {{code: {}, family: aruco_original, size_m: 0.1, position: [0, 0, 0], quaternion: [0, 0, 0, 1]}}"
WPILIB = (
    '{{"ID": {}, "pose": {{"translation": {{"x": 1, "y": 2, "z": 1}}, '
    '"rotation": {{"quaternion": {{"W": 1, "X": 0, "Y": 0, "Z": 0}}}}}}}}'
)
CASES: dict[str, tuple[str, str, Callable[[], str]]] = {
    "trajectory": (
        "big.tum",
        "evaluate big.tum big.tum",
        lambda: rows("#", lambda k: f"{k / 10} {k % 99} 0 0 0 0 0 1"),
    ),
    "odometry": (
        "odometry.csv",
        f"track --detections detections.csv {MOVED}",
        lambda: rows("time_s,forward_mps,turn_radps", lambda k: f"{k / 1000},0.1,0.01"),
    ),
    "detections": (
        "detections.csv",
        f"track --detections detections.csv {MOVED}",
        lambda: rows("time_s,camera,code,x0,y0,x1,y1,x2,y2,x3,y3", lambda k: f"{k // 9},left,1,1,1,9,1,9,9,1,x"),
    ),
    "readings": (
        "readings.csv",
        "locate --readings readings.csv --map map.yaml",
        lambda: rows("time_s,code,range_m,bearing_rad", lambda k: f"{k // 3},{k % 9},2,x"),
    ),
    "map in YAML": (
        "map.yaml",
        "map map.yaml",
        lambda: rows("format: lmkit-map/1\nframe: map\nlandmarks:", LANDMARK.format),
    ),
    "map in JSON": (
        "map.yaml",
        "map map.yaml",
        lambda: '{"format": "lmkit-map/1", "landmarks": [' + "0," * (BYTES // 2),
    ),
    "deep YAML": ("rig.yaml", "convert rig.yaml --to ros -o out", lambda: "[" * BYTES),
    "aliases": (
        "rig.yaml",
        "convert rig.yaml --to ros -o out",
        lambda: "a: &a [1]\nb: [" + "*a," * (BYTES // 3) + "1]",
    ),
    "rig": ("rig.yaml", "convert rig.yaml --to ros -o out", lambda: "format: lmkit-rig/1\nleft: " + "x" * BYTES),
    "one line": ("odometry.csv", f"track --detections detections.csv {MOVED}", lambda: "time_s," + "9" * BYTES),
    "SVG path": (
        "floor.svg",
        "map map.yaml --floor floor.svg --scale 0.01 --plan out.png",
        lambda: f'<svg xmlns="http://www.w3.org/2000/svg"><path d="M0 0{"h1v1" * (BYTES // 4)}"/></svg>',
    ),
    "SVG shapes": (
        "floor.svg",
        "map map.yaml --floor floor.svg --scale 0.01 --plan out.png",
        lambda: (
            '<svg xmlns="http://www.w3.org/2000/svg">' + '<rect width="9" height="9"/>' * (BYTES // 28) + "</svg>"
        ),
    ),
    "DXF lines": (
        "floor.dxf",
        "map map.yaml --floor floor.dxf --scale 0.01 --plan out.png",
        lambda: (
            rows(
                "0\nSECTION\n2\nENTITIES",
                lambda k: f"0\nLINE\n8\n0\n10\n{k % 999}\n20\n{k % 777}\n11\n{k % 555}\n21\n9",
            )
            + "0\nENDSEC\n0\nEOF\n"
        ),
    ),
    "DXF no end": (
        "floor.dxf",
        "map map.yaml --floor floor.dxf --plan out.png",
        lambda: "0\nSECTION\n" * (BYTES // 10),
    ),
    "DXF binary": (
        "floor.dxf",
        "map map.yaml --floor floor.dxf --scale 0.01 --plan out.png",
        lambda: "AutoCAD Binary DXF\r\n\x1a\0" + "\0\0SECTION\0" * (BYTES // 10),
    ),
    "DXF in bounds": (
        "floor.dxf",
        "map map.yaml --floor floor.dxf --scale 0.01 --plan out.png",
        lambda: (
            "0\nSECTION\n2\nENTITIES\n"
            + "".join(
                f"0\nLINE\n8\n{'WALL' * 12}\n10\n{k % 999}\n20\n{k % 777}\n11\n{k % 555}\n21\n9\n"
                for k in range(100_000)
            )
            + "0\nENDSEC\n0\nEOF\n"
        ),
    ),
    "bag": ("big.bag", "unbag big.bag -o out", lambda: "#ROSBAG V2.0\n" + "x" * BYTES),
    "MCAP": ("big.mcap", "unbag big.mcap -o out", lambda: "\x89MCAP0\r\n" + "x" * BYTES),
    "KITTI": (
        "big.txt",
        "evaluate big.txt big.txt",
        lambda: rows("", lambda k: f"1 0 0 {k / 10} 0 1 0 0 0 0 1 0"),
    ),
    "EuRoC": (
        "big.csv",
        "evaluate big.csv big.csv",
        lambda: rows(
            "#timestamp [ns],x,y,z,q_w,q_x,q_y,q_z", lambda k: f"{1520530308 * 10**9 + k * 10**7},{k},0,0,1,0,0,0"
        ),
    ),
    "evo": (
        "big.tum",
        "evaluate big.tum truth.tum --align rigid --json",
        lambda: rows("# timestamp tx ty tz qx qy qz qw", lambda k: f"{k / 10:.4f},{k % 99},0,0,0,0,0,2"),
    ),
    "WPILib": (
        "big.json",
        "map big.json",
        lambda: '{"tags": [' + ",".join(map(WPILIB.format, range(BYTES // len(WPILIB)))) + '], "field": {}}',
    ),
    "map.txt": (
        "map.txt",
        "map map.txt --family aruco5x5_1000 --size 0.1m",
        lambda: rows("", lambda k: f"{k} 1 2 3 90 0 90 0.001 10 {k + 1}"),
    ),
    "fmap": (
        "big.fmap",
        "map big.fmap",
        lambda: (
            '{"fiducials": ['
            + '{"family": "36h11", "id": 1, "size": 165.1, "transform": []},' * (BYTES // 66)
            + "{}]}"
        ),
    ),
    "scans": (
        "scans.csv",
        "locate --scans scans.csv --map map.yaml",
        lambda: rows("time_s,angle_rad,range_m", lambda k: f"{k // 360},{k % 360 / 60},2.5"),
    ),
    "gyro": (
        "gyro.csv",
        f"track --detections detections.csv {MOVED} --gyro gyro.csv",
        lambda: rows("time_s,rate_radps", lambda k: f"{k / 1000},0.01"),
    ),
    "ROS map": (
        "ros.yaml",
        "map map.yaml --floor ros.yaml --plan out.png",
        lambda: "image: floor.png\nresolution: 0.1\nnote: " + "x" * BYTES,
    ),
    "ROS image": (
        "floor.pgm",
        "map map.yaml --floor floor_pgm.yaml --plan out.png",
        lambda: "P5\n3000 3333\n255\n" + "\xfe\0" * (BYTES // 2),
    ),
    "OpenCV XML": (
        "rig.yaml",
        "convert rig.yaml --to ros -o out",
        lambda: "<?xml version='1.0'?><opencv_storage>" + "<M1>1</M1>" * (BYTES // 10) + "</opencv_storage>",
    ),
    "form": (
        "form.csv",
        "map form.csv --room 8x5m -o out.yaml",
        lambda: rows("code,wall", lambda k: f"{k % 256},north"),
    ),
    "template": (
        "template.toml",
        "generate --code 3 --template template.toml -o out.svg",
        lambda: 'format = "lmkit-template/1"\n' + "[[texts]]\n" * (BYTES // 10),
    ),
    "image": ("left.png", "detect left.png", lambda: "\x89PNG\r\n" + "x" * BYTES),
}


def main() -> int:
    """Exit code 1 where one case takes too long or too much memory, or ends in an internal error."""
    worst = 0
    with tempfile.TemporaryDirectory() as root:
        folder = Path(root)
        write_inputs(folder, images=False)
        (folder / "floor_pgm.yaml").write_text("image: floor.pgm\nresolution: 0.05\norigin: [0, 0, 0]\nnegate: 0\n")
        for title, (name, words, make) in CASES.items():
            if sys.argv[1:] and title not in sys.argv[1:]:
                continue
            before = (folder / name).read_bytes() if (folder / name).exists() else b""
            (folder / name).write_text(make(), encoding="latin-1")
            process = subprocess.Popen(
                [sys.executable, "-m", "lmkit", *words.split()], cwd=folder, stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE, text=True,
            )  # fmt: skip
            assert process.stderr is not None
            answer = process.stderr.read().strip()
            _, status, used = os.wait4(process.pid, 0)
            seconds, memory, code = (
                used.ru_utime + used.ru_stime,
                used.ru_maxrss >> 10,
                os.waitstatus_to_exitcode(status),
            )
            worst |= (code == 2 and seconds > MOST_S) or memory > MOST_MIB or code not in (0, 1, 2)
            print(f"{title:12s} {code:3d} {seconds:6.2f} s {memory:5d} MiB  {answer[-110:]}", flush=True)
            (folder / name).write_bytes(before)
    return int(worst)


if __name__ == "__main__":
    sys.exit(main())
