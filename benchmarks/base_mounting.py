"""Places of cameras on a simulated robot, found by `lmkit.calibrate_base`: errors, and how many intervals hold.

    uv run python benchmarks/base_mounting.py [--robots 12] [--cameras 1,5] [--late 0.15]

Every robot has one or five cameras that share no view, and drives 60 s of figures of eight, or of rounds in one
direction, through a room with 24 landmarks, or 40 s of eights and then twice round on the spot to each side; corners
err by 0.15 px, wheels by 8 % and 10 % and 1 cm per root of a meter that they travel, with slips in every second
recording.  The height of the first camera is given.  With --late, the stamps of every camera but the first are off by
up to so many seconds, and the clocks are found as well.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

import numpy as np

from lmkit.geometry.pose import Pose
from lmkit.geometry.rig import MountedCamera, Rig, with_time_offsets
from lmkit.geometry.rotations import rotation_exp, rotation_log
from lmkit.mapping.base_mounting import find_base_mounting
from lmkit.odometry.wheel_odometry import MotionModel
from lmkit.simulation.recording import T_BASE_LEFT, WheelErrors, make_drive
from lmkit.simulation.scene import make_rig

PATHS = {"eights": (60.0, 0), "rounds": (60.0, 0), "eights and spins": (40.0, 2)}  # seconds, spins to each side
TRACK_M = 0.3


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


def row(count: int, path: str, seeds: Sequence[int], late_s: float) -> str:
    """One row of the table."""
    errors, scaled, clocks = [], [], []
    seconds, spins = PATHS[path]
    for seed in seeds:
        rng = np.random.default_rng([seed, 9])
        rig, places = looking_around(rng, count)
        offsets = rng.uniform(-late_s, late_s, count - 1).tolist()
        wheels = WheelErrors(slips=seed % 2, track_m=TRACK_M)
        timed = with_time_offsets(rig, offsets)
        made = make_drive(seed, seconds, rig=timed, count=24, eights=path != "rounds", errors=wheels, spins=spins)
        motion, height = MotionModel(made.odometry, made.gyro), float(places[0].t[2])
        found = find_base_mounting(made.frames, rig, made.landmarks, motion, height)
        for camera, T in zip(found.cameras, places, strict=True):
            off = np.concatenate([camera.T_base_camera.t - T.t, rotation_log(camera.T_base_camera.R @ T.R.T)])
            errors.append(off)
            scaled.append(off / np.sqrt(np.diag(camera.covariance)))
        for camera, offset in zip(found.cameras[1:], offsets, strict=True):
            assert camera.clock is not None
            clocks.append([camera.clock.offset_s - offset, camera.clock.sigma_s])
    rms = np.sqrt(np.mean(np.square(errors), axis=0))
    within = 100 * np.mean(np.abs(scaled) < 1.96, axis=0)
    mm, deg = 1000 * rms[:3], np.rad2deg(rms[3:])
    clock = np.array(clocks).reshape(-1, 2)
    by_clock = "-"
    if len(clock):
        share = 100 * np.mean(np.abs(clock[:, 0]) < 1.96 * clock[:, 1])
        by_clock = f"{1000 * np.sqrt(np.mean(clock[:, 0] ** 2)):.2f} ms, {share:.0f}"
    return (
        f"| {count} | {path} | {len(seeds)} | {mm[0]:.1f} / {mm[1]:.1f} / {mm[2]:.1f} mm | "
        f"{deg[0]:.3f} / {deg[1]:.3f} / {deg[2]:.3f} deg | {' / '.join(f'{w:.0f}' for w in within)} | {by_clock} |"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robots", type=int, default=12)
    parser.add_argument("--cameras", default="1,5", help="numbers of cameras, one or more")
    parser.add_argument("--first", type=int, default=0, help="seed of the first robot")
    parser.add_argument("--paths", default=",".join(PATHS))
    parser.add_argument("--late", type=float, default=0.0, help="largest offset of stamps, s")
    given = parser.parse_args()
    print("| cameras | path | robots | rms x / y / z | rms about x / y / z | within 95 %, each of the six | clocks |")
    print("|---|---|---|---|---|---|---|")
    seeds = range(given.first, given.first + given.robots)
    for count in map(int, given.cameras.split(",")):
        for path in given.paths.split(","):
            print(row(count, path, seeds, given.late), flush=True)


if __name__ == "__main__":
    main()
