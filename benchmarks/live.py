"""The live loop against ArUco and PnP in the same loop: processor time per step, on two images rendered before.

    uv run python benchmarks/live.py [--size 1280x720] [--seconds 10] [--seeds 3]

A simulated robot drives through a room with six markers, in the same places: `lm8` for lmkit, `aruco4x4_50` for both.
The peer searches both whole images with `cv2.aruco` (corners refined to subpixels) and solves PnP from all corners of
the left image; it has no filter, no covariance and no check.  Thread processor time; images rendered before.
NEES: squared error of x and y in standard deviations over two, mean over the published poses; 1 is honest.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

import cv2
import numpy as np

from lmkit.geometry.pose import Pose
from lmkit.geometry.rig import mounted_cameras
from lmkit.live.frame_group import FrameGroup
from lmkit.live.loop import LiveLoop, LoopSettings
from lmkit.live.publication import PublicationRule
from lmkit.live.simulated_source import SimulatedRun
from lmkit.live.source_address import parse_source
from lmkit.simulation.robot_course import RobotCourse

FPS = 10.0  # of the images rendered; the loop itself takes as long at 30
PEER = "aruco4x4_50"


class Peer:
    """ArUco and PnP."""

    def __init__(self, course: RobotCourse) -> None:
        parameters = cv2.aruco.DetectorParameters()
        parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
        self._detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50), parameters)
        self._corners = {m.id.code: m.corners_map for m in course.landmarks}
        self._left = mounted_cameras(course.rig)[0].model
        self._T_base_left = course.rig.T_base_left

    def __call__(self, group: FrameGroup) -> Pose | None:
        """T_map_base of a step."""
        found = [self._detector.detectMarkers(cv2.cvtColor(i, cv2.COLOR_BGR2GRAY))[:2] for i in group.images]
        corners, ids = found[0]
        known = (
            []
            if ids is None
            else [(self._corners[c], q) for c, q in zip(ids.ravel(), corners, strict=True) if c in self._corners]
        )
        if not known:
            return None
        points = np.concatenate([p for p, _ in known])
        pixels = np.concatenate([q.reshape(4, 2) for _, q in known]).astype(float)
        flag = cv2.SOLVEPNP_IPPE if len(known) == 1 else cv2.SOLVEPNP_SQPNP
        done, rvec, t = cv2.solvePnP(points, pixels, self._left.K, self._left.distortion, flags=flag)
        T = Pose.from_rvec("left", "map", rvec.ravel(), t.ravel()).inverse()
        base = self._T_base_left.inverse()
        return Pose("map", "base", T.R @ base.R, T.R @ base.t + T.t) if done else None


@dataclass
class Tally:
    """Counts beside the poses: NEES of every pose, and how many images were searched how."""

    nees: list[float] = field(default_factory=list)
    searched: Counter[str] = field(default_factory=Counter)


def step_of(loop: LiveLoop, tally: Tally, group: FrameGroup) -> Pose | None:
    """T_map_base that lmkit publishes for a step."""
    state = loop.step(group)
    if state is None:
        return None
    tally.searched.update(view.search for view in state.views)
    if state.T_map_base is not None and state.covariance is not None and group.truth is not None:
        off = (state.T_map_base.t - group.truth.t)[:2]
        tally.nees.append(float(off @ np.linalg.solve(state.covariance[:2, :2], off)) / 2)
    return state.T_map_base


def measured(groups: list[FrameGroup], step: Callable[[FrameGroup], Pose | None]) -> tuple[np.ndarray, np.ndarray]:
    """Milliseconds of every step, and errors (m) of the poses."""
    times, errors = [], []
    for group in groups:
        start = time.thread_time()
        T = step(group)
        times.append(1000 * (time.thread_time() - start))
        if T is not None:
            errors.append(float(np.linalg.norm((T.t - group.truth.t)[:2])))
    return np.array(times), np.array(errors)


def report(name: str, times: np.ndarray, errors: np.ndarray) -> None:
    """One row of the table."""
    off = 1000 * np.sqrt(np.mean(errors**2)) if len(errors) else float("nan")
    most = 1000 * errors.max() if len(errors) else float("nan")
    print(
        f"| {name} | {len(times)} | {len(errors)} | {times.mean():.1f} | {np.percentile(times, 95):.1f} "
        f"| {off:.1f} | {most:.0f} |"
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--size", default="640x480")
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--first", type=int, default=1, help="first seed")
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    all_: dict[str, list[tuple[np.ndarray, np.ndarray]]] = {}
    tallies: dict[str, Tally] = {}
    for seed in range(arguments.first, arguments.first + arguments.seeds):
        for family in ("lm8", PEER):
            options = f"seconds={arguments.seconds}&seed={seed}&fps={FPS}&size={arguments.size}&family={family}"
            address = f"sim:?{options}&speed=max"
            simulated = SimulatedRun(parse_source(address))
            course, groups = simulated.course, list(simulated.groups())
            loop = LiveLoop(course.rig, course.landmarks, LoopSettings("wheels", rule=PublicationRule(confirm=1)))
            tally = tallies.setdefault(f"lmkit, {family}", Tally())
            all_.setdefault(f"lmkit, {family}", []).append(measured(groups, partial(step_of, loop, tally)))
            if family == PEER:
                all_.setdefault(f"ArUco and PnP, {family}", []).append(measured(groups, Peer(course)))
    print(f"{arguments.size}, two cameras, {arguments.seeds} runs\n")
    print("| | steps | poses | ms a step | 95 % | error mm | largest |\n|---|---|---|---|---|---|---|")
    for name, rows in all_.items():
        report(name, np.concatenate([t for t, _ in rows]), np.concatenate([e for _, e in rows]))
    means = {name: np.concatenate([t for t, _ in rows]).mean() for name, rows in all_.items()}
    peer = means.pop(f"ArUco and PnP, {PEER}")
    for name, mean in means.items():
        tally = tallies[name]
        share = tally.searched["near"] / max(sum(tally.searched.values()), 1)
        print(
            f"\n{name}: {mean / peer:.2f} times the peer's processor time, {1000 / mean:.0f} steps a second; "
            f"NEES {np.mean(tally.nees):.2f}; windows in {100 * share:.0f} % of the images"
        )


if __name__ == "__main__":
    main()
