"""One small simulated file of every kind, to try lmkit without hardware; the examples of the docs use them."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np

from lmkit.geometry.pose import Pose
from lmkit.geometry.rig import as_stereo
from lmkit.geometry.stereo_rig import StereoRig
from lmkit.io.files import write_file
from lmkit.io.images import decode_image
from lmkit.io.landmark_map import map_to_yaml
from lmkit.io.recording_tables import detections_to_csv, gyro_to_csv, odometry_to_csv
from lmkit.io.rig import rig_to_yaml
from lmkit.io.trajectory import poses_to_tum
from lmkit.model.board import BoardSpec
from lmkit.simulation.photograph import ImagingChain, photograph
from lmkit.simulation.recording import HEIGHT_M, Drive, make_drive
from lmkit.simulation.scene import Scene, board_panel, board_poses, furnish_room, studio
from lmkit.visualization.overlay import encode_png

BOARD = BoardSpec("chessboard", 9, 6, 25.0)
ROOM_M = (8.0, 5.0)
FILM_HZ, RESTING = 5.0, 2  # frames of the film, a second and at each place
FLOOR = """format: lmkit-floor/1
walls:
  - {{from: [0, 0], to: [{0}, 0]}}
  - {{from: [{0}, 0], to: [{0}, {1}]}}
  - {{from: [{0}, {1}], to: [0, {1}]}}
  - {{from: [0, {1}], to: [0, 0]}}
places:
  dock: {{position: [1, 1], heading_deg: 90}}
"""


def write_example_files(
    folder: str | os.PathLike[str], *, board_pairs: int = 6, seconds: float = 30.0, overwrite: bool = False
) -> list[Path]:
    """Write a simulated room as files: one stereo pair, a rig, a map, a floor plan, board images and a recording.

    All files are simulated: images with blur and noise, corners and odometry with realistic errors.

    Args:
        folder: created if missing.
        board_pairs: stereo pairs of a calibration board (``chessboard:9x6:25mm``), and a film of the same, in which
            the board rests at each place and both cameras are side by side.
        seconds: length of the recording, at 5 frames a second.
        overwrite: replace existing files.

    Returns:
        The files: left.png, right.png, rig.yaml, map.yaml, floor.yaml, boards/left/*.png, boards/right/*.png,
        boards.avi, detections.csv, odometry.csv, gyro.csv, truth.tum.

    Raises:
        InputError: a file exists, or cannot be written.

    Examples:
        >>> import lmkit
        >>> len(lmkit.write_example_files("room", board_pairs=0, seconds=2))
        9
    """
    recording = make_drive(3, seconds, size_m=ROOM_M)
    rig = as_stereo(recording.rig, "the example")
    rng = np.random.default_rng(3)
    room = furnish_room(rng, recording.landmarks, (*ROOM_M, HEIGHT_M))
    seen = max(range(len(recording.frames)), key=lambda k: _readable(recording, k))
    truth = [(float(t), recording.pose(k)) for k, t in enumerate(recording.times_s)]
    files: dict[str, bytes | str] = {
        "rig.yaml": rig_to_yaml(recording.rig),
        "map.yaml": map_to_yaml(recording.landmarks),
        "floor.yaml": FLOOR.format(*ROOM_M),
        "detections.csv": detections_to_csv(recording.frames),
        "odometry.csv": odometry_to_csv(recording.odometry),
        "gyro.csv": gyro_to_csv(recording.gyro),
        "truth.tum": poses_to_tum(truth),
    }
    boards: list[tuple[bytes, bytes]] = []
    left, right = _photograph(room, rig, recording.pose(seen) @ _base_left(rig), rng)
    files |= {"left.png": left, "right.png": right}
    for k, pose in enumerate(board_poses(3, rig, BOARD, board_pairs) if board_pairs else []):
        scene = studio([board_panel(BOARD, Pose("map", "board", pose.R, pose.t))])
        left, right = _photograph(scene, rig, Pose.identity("map", "left"), rng)
        boards.append((left, right))
        files |= {f"boards/left/{k:02d}.png": left, f"boards/right/{k:02d}.png": right}
    if board_pairs:
        files["boards.avi"] = _film(boards)
    written = []
    for name, data in files.items():
        write_file(Path(folder) / name, data, overwrite)
        written.append(Path(folder) / name)
    return written


def _film(pairs: Sequence[tuple[bytes, bytes]]) -> bytes:
    """AVI of pairs of PNG images, side by side, each for as long as the guided calibration waits for rest."""
    frames = [np.hstack([decode_image(side, "example") for side in pair]) for pair in pairs]
    height, width = frames[0].shape[:2]
    with TemporaryDirectory() as folder:
        path = Path(folder) / "film.avi"
        writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), FILM_HZ, (width, height))
        for frame in frames:
            for _ in range(RESTING):
                writer.write(frame)
        writer.release()
        return path.read_bytes()


def _readable(recording: Drive, k: int) -> tuple[int, float]:
    """Landmarks in view of both cameras in frame k, and the sum of their sizes."""
    frame = recording.frames[k]
    both = {d.code for d in frame.seen[0]} & {d.code for d in frame.seen[1]}
    return len(both), float(sum(np.ptp(d.corners, axis=0).max() for d in frame.seen[0]))


def _base_left(rig: StereoRig) -> Pose:
    assert rig.T_base_left is not None
    return rig.T_base_left


def _photograph(scene: Scene, rig: StereoRig, T_map_left: Pose, rng: np.random.Generator) -> tuple[bytes, bytes]:
    """PNG of both cameras."""
    images = []
    for camera, pose in ((rig.left, T_map_left), (rig.right, rig.T_map_right(T_map_left))):
        image = photograph(scene, camera, Pose("map", "camera", pose.R, pose.t), ImagingChain(), rng)
        images.append(encode_png(image))
    return images[0], images[1]
