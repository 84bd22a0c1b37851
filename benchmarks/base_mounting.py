"""Places of cameras on a simulated robot, found by `lmkit.calibrate_base`: errors, and intervals that hold.

    uv run python benchmarks/base_mounting.py [--robots 12] [--cameras 1,5]

Every robot has one or five cameras that share no view, and drives 60 s of figures of eight, or of rounds in one
direction, through a room with 24 landmarks; corners err by 0.15 px, wheels by 8 % and 10 %, with slips in every
second recording.  The height of the first camera is given.
"""

from __future__ import annotations

import argparse

import numpy as np

from lmkit.geometry.pose import Pose
from lmkit.geometry.rig import MountedCamera, Rig
from lmkit.geometry.rotations import rotation_exp, rotation_log
from lmkit.mapping.base_mounting import find_base_mounting
from lmkit.odometry.wheel_odometry import MotionModel
from lmkit.simulation.recording import T_BASE_LEFT, WheelErrors, make_drive
from lmkit.simulation.scene import make_rig


def looking_around(rng: np.random.Generator, count: int) -> tuple[Rig, list[Pose]]:
    """Cameras in a ring, tilted a little, and their places on the base."""
    model, places, cameras = make_rig().left, [], []
    for k in range(count):
        yaw = 2 * np.pi * k / count + rng.uniform(-0.2, 0.2)
        turn = rotation_exp(np.array([[0, 0, yaw], rng.normal(0, 0.05, 3)]))
        arm = np.array([0.15 * np.cos(yaw), 0.15 * np.sin(yaw), rng.uniform(0.6, 1.0)]) + rng.normal(0, 0.02, 3)
        places.append(Pose("base", "left", turn[0] @ turn[1] @ T_BASE_LEFT.R, arm))
        T = places[k].inverse() @ places[0]
        own = Pose.identity("camera", "left") if k == 0 else Pose("camera", "left", T.R, T.t)
        cameras.append(MountedCamera(f"camera{k}", model, own))
    return Rig(tuple(cameras), places[0]), places


def row(count: int, eights: bool, robots: int) -> str:
    """One row of the table."""
    errors, scaled = [], []
    for seed in range(robots):
        rig, places = looking_around(np.random.default_rng([seed, 9]), count)
        made = make_drive(seed, seconds=60, rig=rig, count=24, eights=eights, errors=WheelErrors(slips=seed % 2))
        motion, height = MotionModel(made.odometry, made.gyro), float(places[0].t[2])
        found = find_base_mounting(made.frames, rig, made.landmarks, motion, height)
        for camera, T in zip(found.cameras, places, strict=True):
            off = np.concatenate([camera.T_base_camera.t - T.t, rotation_log(camera.T_base_camera.R @ T.R.T)])
            errors.append(off)
            scaled.append(off / np.sqrt(np.diag(camera.covariance)))
    rms = np.sqrt(np.mean(np.square(errors), axis=0))
    within = 100 * np.mean(np.abs(scaled) < 1.96, axis=0)
    mm, deg = 1000 * rms[:3], np.rad2deg(rms[3:])
    return (
        f"| {count} | {'eights' if eights else 'rounds'} | {robots} | {mm[0]:.1f} / {mm[1]:.1f} / {mm[2]:.1f} mm | "
        f"{deg[0]:.3f} / {deg[1]:.3f} / {deg[2]:.3f} deg | {' / '.join(f'{w:.0f}' for w in within)} |"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robots", type=int, default=12)
    parser.add_argument("--cameras", default="1,5", help="numbers of cameras, one or more")
    given = parser.parse_args()
    print("| cameras | path | robots | rms x / y / z | rms about x / y / z | within 95 %, each of the six |")
    print("|---|---|---|---|---|---|")
    for count in map(int, given.cameras.split(",")):
        for eights in (True, False):
            print(row(count, eights, given.robots), flush=True)


if __name__ == "__main__":
    main()
