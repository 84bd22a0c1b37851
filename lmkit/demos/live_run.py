"""`lmkit demo --run`: the live loop on a simulated robot, against the truth."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.geometry.planar import wrap_heading
from lmkit.geometry.stereo_rig import ahead_of
from lmkit.io.files import write_file
from lmkit.live.loop import LiveLoop
from lmkit.live.open_run import open_run
from lmkit.live.run_settings import settings_of
from lmkit.live.state import LiveState
from lmkit.localization.correspondences import CORNER_FLOOR_PX
from lmkit.simulation.robot_course import ROOM_M
from lmkit.visualization.plan_view import BLUE, GREEN, Found, Polyline, draw_plan

SHOWN = 8  # number of robots on the plan
LENS_PX = CORNER_FLOOR_PX  # errors of lenses after calibration, as assumed by the filter


@dataclass(frozen=True)
class LiveDemo:
    """Results of a live run.

    Attributes:
        steps, poses: number of steps of the loop, and of published poses.
        step_hz: steps per second.
        rate_hz: poses per second, from the first to the last.
        after_s: from the first step to the first pose.
        latency_ms: (50 %, 95 %) from the images to the end of the step.
        cpu_ms: of the process per step, decoding the images included.
        error_mm: (root mean square, largest) position error.
        error_deg: root mean square heading error.
        nees: mean NEES of x, y and heading, divided by three; 1 is consistent.
        statuses: steps by status.
    """

    steps: int
    poses: int
    step_hz: float
    rate_hz: float
    after_s: float
    latency_ms: tuple[float, float]
    cpu_ms: float
    error_mm: tuple[float, float]
    error_deg: float
    nees: float
    statuses: Counter[str]


def run_live_demo(
    folder: Path,
    seconds: float,
    seed: int,
    shown: Callable[[LiveState], None] | None = None,
    options: str = "size=640x480",
) -> LiveDemo | None:
    """Run ``sim:`` live and write ``plan.png``; None if no pose was published.

    Images are rendered in advance; lenses have typical errors of a calibration.

    Args:
        options: further options of the source, such as ``size=1280x720&fps=20``.
    """
    source = f"sim:?seconds={seconds + 2:.0f}&seed={seed}&images=before&lens={LENS_PX}&{options}"
    run = open_run(settings_of({"sources": [source]}, Path()))
    states: list[LiveState] = []
    end = time.monotonic() + seconds

    def listen(state: LiveState) -> None:
        states.append(_without_images(state))
        if shown is not None:
            shown(state)
        if time.monotonic() > end:
            run.stop()

    run.listeners.append(listen)
    before = time.process_time()
    summary = run.run()
    cpu_s = time.process_time() - before
    poses = [s for s in states if s.T_map_base is not None and s.truth is not None]
    if not poses:
        return None
    write_file(folder / "plan.png", _plan(run.loop, poses), True)
    errors, headings, nees = _against_truth(poses)
    late = [1000 * s.latency_s for s in states if s.latency_s is not None]
    return LiveDemo(
        summary.steps,
        len(poses),
        _rate(states),
        _rate(poses),
        poses[0].time_s - states[0].time_s,
        (float(np.median(late)), float(np.percentile(late, 95))),
        1000 * cpu_s / max(summary.steps, 1),
        (1000 * float(np.sqrt(np.mean(errors**2))), 1000 * float(errors.max())),
        float(np.rad2deg(np.sqrt(np.mean(headings**2)))),
        float(np.mean(nees)) / 3,
        summary.statuses,
    )


def _rate(states: list[LiveState]) -> float:
    """States per second."""
    return (len(states) - 1) / max(states[-1].time_s - states[0].time_s, 1e-3)


def _plan(loop: LiveLoop, states: list[LiveState]) -> bytes:
    """Truth, published positions, and the robot with its ellipse at some times."""
    true = np.array([s.truth.t[:2] for s in states if s.truth is not None])
    believed = np.array([s.T_map_base.t[:2] for s in states if s.T_map_base is not None])
    lines = [Polyline(true, GREEN, "truth", 7), Polyline(believed, BLUE, "published", 3)]
    found = []
    for k in range(0, len(states), max(1, len(states) // SHOWN)):
        pose, C = states[k].T_map_base, states[k].covariance
        assert pose is not None
        assert C is not None
        found.append(Found("", ahead_of(pose), C[:2, :2]))
    return draw_plan(loop.landmarks, found, size_m=ROOM_M, title="Live run", polylines=lines)


def _without_images(state: LiveState) -> LiveState:
    return replace(state, views=(), group=None)


def _against_truth(states: list[LiveState]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Position errors (m), heading errors (rad), squared errors in standard deviations of x, y and heading."""
    errors, headings, nees = [], [], []
    for state in states:
        assert state.T_map_base is not None
        assert state.truth is not None
        assert state.covariance is not None
        off = (state.T_map_base.t - state.truth.t)[:2]
        R = state.T_map_base.R @ state.truth.R.T
        turn = float(wrap_heading(float(np.arctan2(R[1, 0], R[0, 0]))))
        d = np.array([*off, turn])
        C = state.covariance[np.ix_([0, 1, 5], [0, 1, 5])]
        errors.append(float(np.linalg.norm(off)))
        headings.append(turn)
        nees.append(float(d @ np.linalg.solve(C, d)))
    return np.array(errors), np.array(headings), np.array(nees)
