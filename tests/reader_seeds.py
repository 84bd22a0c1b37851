"""A small valid text for each reader of text files, for tests that harm it."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import yaml
from PIL import Image

from lmkit.geometry.stereo_rig import StereoRig
from lmkit.io.any_rig import read_any_rig
from lmkit.io.board_corners import read_corners
from lmkit.io.external_maps import map_to_tagslam, map_to_wpilib, read_any_map
from lmkit.io.floor_plan import read_floor
from lmkit.io.kalibr import rig_to_camchain
from lmkit.io.landmark_map import map_to_yaml
from lmkit.io.manifest import read_manifest
from lmkit.io.marker_maps import MarkerDefaults
from lmkit.io.measured_map import FormDefaults, read_measured_map
from lmkit.io.opencv_rig import rig_to_opencv_yaml
from lmkit.io.readings import read_readings
from lmkit.io.recording_tables import read_detections, read_gyro, read_odometry
from lmkit.io.rig import rig_to_yaml
from lmkit.io.ros_camera_info import read_camera_infos, rig_to_camera_infos
from lmkit.io.scans import read_scans
from lmkit.io.svg_lines import read_svg_lines
from lmkit.io.template import load_template
from lmkit.io.trajectory import read_trajectory, read_two_trajectories
from lmkit.simulation.recording import make_drive
from lmkit.simulation.scene import make_rig

Seed = tuple[str, Callable[[Path], object]]
CAMERA_INFO = {
    "k": "camera_matrix",
    "d": "distortion_coefficients",
    "r": "rectification_matrix",
    "p": "projection_matrix",
}


def reader_seeds(folder: Path) -> dict[str, Seed]:
    """A valid text for each reader by file name, and the reader."""
    rig: StereoRig = make_rig()
    landmarks = make_drive(0, seconds=3).landmarks
    left, right = rig_to_camera_infos(rig)
    (folder / "right.yaml").write_text(right)
    pose = "0.5 1 2 3 0 0 0 1\n0.7 1 2 3 0 0 0 1\n"
    corners = "1,2,3,4,5,6,7,8"
    floor = "format: lmkit-floor/1\nwalls:\n- {from: [0, 0], to: [4, 0]}\n- {from: [4, 0], to: [0, 3]}\n"
    template = (Path(__file__).parents[1] / "templates" / "a4.toml").read_text()
    drawing = (
        '<svg xmlns="http://www.w3.org/2000/svg" width="400" height="300"><rect width="100%" height="100%"/>'
        '<g transform="translate(1 2) rotate(90)"><line x1="0" y1="0" x2="9" y2="0"/><path d="M0 0h9v-3z"/>'
        '<polygon points="0,0 4,0 4,3"/></g></svg>'
    )
    printed = {"page": 1, "code": 137, "family": "lm8", "version": 1, "size_mm": 180.0, "centre_mm": [109.9, 105.9]}
    manifest = json.dumps(
        {
            "format": "lmkit-prints/1",
            "lmkit": "0",
            "template": "a4",
            "paper_mm": [[210.0, 297.0]],
            "landmarks": [printed],
        }
    )
    return _rig_seeds(folder) | _map_seeds() | _table_seeds() | _floor_seeds(folder) | {
        "floor.svg": (drawing, read_svg_lines),
        "rig.yaml": (rig_to_yaml(rig), read_any_rig),
        "opencv.yaml": (rig_to_opencv_yaml(rig), read_any_rig),
        "kalibr.yaml": (rig_to_camchain(rig)[0], read_any_rig),
        "left.yaml": (left, lambda path: read_camera_infos(path, folder / "right.yaml")),
        "map.yaml": (map_to_yaml(landmarks), read_any_map),
        "tagslam.yaml": (map_to_tagslam(landmarks), read_any_map),
        "field.json": (map_to_wpilib(landmarks, (8.0, 5.0)), read_any_map),
        "floor.yaml": (floor, read_floor),
        "template.toml": (template, lambda path: load_template(str(path))),
        "corners.json": (
            '{"format": "lmkit-corners/1", "board": "chessboard:9x6:25mm", "image_size": [640, 480], "pairs": []}',
            read_corners,
        ),
        "manifest.json": (manifest, read_manifest),
        "poses.tum": (pose, read_trajectory),
        "odometry.csv": ("time_s,x_m,y_m,heading_rad\n0,1,2,3\n1,2,3,4\n", read_odometry),
        "gyro.csv": ("time_s,rate_radps\n0,1\n1,2\n", read_gyro),
        "detections.csv": (
            f"time_s,camera,code,x0,y0,x1,y1,x2,y2,x3,y3\n0,left,3,{corners}\n",
            lambda path: read_detections(path, ["lm8"]),
        ),
        "readings.csv": ("time_s,code,range_m,bearing_rad\n0,3,1.5,0.1\n", lambda p: read_readings(p, ["lm8"])),
    }  # fmt: skip


def _rig_seeds(folder: Path) -> dict[str, Seed]:
    """Rigs of other programs: messages of ROS 2, chains through an IMU, FileStorage in XML and JSON."""
    rig: StereoRig = make_rig()
    info = yaml.safe_load(rig_to_camera_infos(rig)[0])
    echo = f"height: {info['image_height']}\nwidth: {info['image_width']}\ndistortion_model: plumb_bob\n"
    echo += "".join(f"{key}: {info[name]['data']}\n" for key, name in CAMERA_INFO.items())
    chain = yaml.safe_load(rig_to_camchain(rig)[0])
    for name, x in (("cam0", 0.0), ("cam1", 0.1)):
        chain[name].pop("T_cn_cnm1", None)
        chain[name]["T_imu_cam"] = [[1, 0, 0, x], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
    lens = {"k2": -0.1, "k3": 0.01, "k4": 0.0, "k5": 0.0, "mu": 400.0, "mv": 400.0, "u0": 320.0, "v0": 240.0}
    camodocal = {
        "model_type": "KANNALA_BRANDT",
        "image_width": 640,
        "image_height": 480,
        "projection_parameters": lens,
    }
    seeds: dict[str, Seed] = {
        "camodocal.yaml": (yaml.safe_dump(camodocal), read_any_rig),
        "echo.yaml": (echo, read_any_rig),
        "openvins.yaml": (yaml.safe_dump(chain), read_any_rig),
    }
    for suffix in (".xml", ".json"):
        storage = cv2.FileStorage(suffix, cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
        for key, value in (("M1", rig.left.K), ("M2", rig.right.K), ("R", np.eye(3)), ("T", [[-0.1], [0], [0]])):
            storage.write(key, np.array(value, dtype=np.float64))
        storage.write("D1", np.zeros((1, 5)))
        storage.write("D2", np.zeros((1, 5)))
        storage.write("image_width", 640)
        storage.write("image_height", 480)
        seeds[f"stored{suffix}"] = (str(storage.releaseAndGetString()), read_any_rig)
    return seeds


def _map_seeds() -> dict[str, Seed]:
    """Maps of apriltag_ros, Limelight, fiducial_slam and marker_mapper."""
    tag = {"family": "apriltag3_36h11_classic", "id": 1, "size": 165.1, "transform": np.eye(4).ravel().tolist()}
    placed = "{id: 2, size: 0.5, x: 1.0, y: 0.0, z: 0.0, qw: 1.0, qx: 0.0, qy: 0.0, qz: 0.0}"
    marker = "{ id:7, corners:[ [ 1., -0.1, 1.6 ], [ 1., 0.1, 1.6 ], [ 1., 0.1, 1.4 ], [ 1., -0.1, 1.4 ] ] }"
    mapper = "%YAML:1.0\n---\naruco_bc_dict: ARUCO\naruco_bc_mInfoType: 1\naruco_bc_markers:\n"
    fiducials = "11 -0.5 0.8 2.0 180.0 -0.0 0.0 0.001 10\n12 1 2 3 90 0 90 0.001 10 11\n"
    return {
        "tags.yaml": (f"tag_bundles: [{{name: a, layout: [{placed}]}}]\n", read_any_map),
        "field.fmap": (json.dumps({"fiducials": [tag], "type": "frc"}), read_any_map),
        "map.txt": (fiducials, lambda path: read_any_map(path, MarkerDefaults("aruco5x5_1000", 0.1))),
        "mapper.yml": (f"{mapper}   - {marker}\n", read_any_map),
    }


def _table_seeds() -> dict[str, Seed]:
    """Trajectories of KITTI and EuRoC, scans, and forms."""
    euroc = "#timestamp [ns],p_x [m],p_y [m],p_z [m],q_w [],q_x [],q_y [],q_z []\n"
    euroc += "1520530308250000000,1,2,3,1,0,0,0\n1520530308350000000,1,2,3,1,0,0,0\n"
    form = "code,x_m,y_m,facing_deg,height_m\n3,1,2,90,1.2\n"
    return {
        "kitti.txt": ("1 0 0 1 0 1 0 2 0 0 1 3\n" * 2, lambda path: read_two_trajectories(path, path)),
        "euroc.csv": (euroc, read_trajectory),
        "scans.csv": ("time_s,angle_min_rad,angle_step_rad\n0,-1,0.1,2,2.1,inf\n", read_scans),
        "form.csv": (form, lambda path: read_measured_map(path, (), FormDefaults("lm8"))),
    }


def _floor_seeds(folder: Path) -> dict[str, Seed]:
    """A map of ROS, and a drawing of a CAD program (R12)."""
    Image.new("L", (40, 30), 254).save(folder / "map.png")
    pairs = (
        "0 SECTION 2 HEADER 9 $ACADVER 1 AC1009 9 $INSUNITS 70 6 0 ENDSEC 0 SECTION 2 BLOCKS 0 BLOCK 8 0 2 B 70 0 "
        "10 0.0 20 0.0 30 0.0 3 B 0 LINE 8 0 10 0.0 20 0.0 11 1.0 21 0.0 0 ENDBLK 0 ENDSEC 0 SECTION 2 ENTITIES "
        "0 LINE 8 WALL 10 0.0 20 0.0 11 6.0 21 4.0 0 ARC 8 DOOR 10 1.0 20 1.0 40 0.9 50 0 51 90 "
        "0 INSERT 8 DOOR 2 B 10 3.0 20 1.0 41 2.0 50 30.0 0 ENDSEC 0 EOF"
    )
    return {
        "plan.dxf": ("\n".join(pairs.split()) + "\n", lambda path: read_floor(path, 1.0)),
        "ros.yaml": ("image: map.png\nresolution: 0.1\norigin: [1, 2, 0.3]\nnegate: 0\nmode: scale\n", read_floor),
    }
