"""HTML report of an estimated trajectory compared with the true one."""

from __future__ import annotations

import numpy as np

from lmkit.evaluation.trajectory_error import TrajectoryError, pose_errors
from lmkit.model.landmark_map import LandmarkMap
from lmkit.reports.time_plots import OTHER, SEEN, Series, over_time
from lmkit.visualization.html import figure, grid, headline, page, sized, table
from lmkit.visualization.plan_view import GREEN, ORANGE, PAGE_SIZE, PHONE_SIZE, Polyline, draw_plan

WORST = 5  # poses listed


def evaluation_report(error: TrajectoryError, names: tuple[str, str]) -> str:
    """HTML report: trajectories from above, errors over time, statistics, and the worst poses.

    Args:
        names: names of the true and the estimated trajectory.
    """
    off_m, off_rad = pose_errors(error.truth, error.estimate)
    times, mm, deg = error.truth.times_s, 1000 * off_m, np.rad2deg(off_rad)
    lines = [
        Polyline(error.truth.positions[:, :2], GREEN, f"truth: {names[0]}", 4),
        Polyline(error.estimate.positions[:, :2], ORANGE, f"estimate: {names[1]}", 2),
    ]
    nothing = LandmarkMap([])
    plan = sized(
        *(draw_plan(nothing, [], kind="svg", polylines=lines, size=size).decode() for size in (PAGE_SIZE, PHONE_SIZE))
    )
    missing = f"{error.missing} true poses have no estimate." if error.missing else "Every true pose has an estimate."
    worst = [(f"{times[k]:.2f}", f"{mm[k]:.1f}", f"{deg[k]:.2f}") for k in np.argsort(-off_m, kind="stable")[:WORST]]
    return page(
        "Trajectory errors",
        [
            headline(
                "fair" if error.missing else "good",
                f"{1000 * error.position_m.rmse:.1f} mm, {error.rotation_deg.rmse:.2f} deg (RMS).",
                f"{error.pairs} poses compared. {missing}",
            ),
            "<h2>Trajectories</h2>",
            figure(plan, "Both trajectories from above, after the alignment that was asked for."),
            "<h2>Errors over time</h2>",
            grid(
                [
                    (over_time([Series(times, mm, SEEN, False)], "position error, mm"), ""),
                    (over_time([Series(times, deg, OTHER, False)], "rotation error, deg"), ""),
                ],
                "two",
            ),
            "<h2>Statistics</h2>",
            _statistics(error),
            "<h2>Largest position errors</h2>",
            table(("time, s", "position, mm", "rotation, deg"), worst),
        ],
    )


def _statistics(error: TrajectoryError) -> str:
    rows = [
        (
            name,
            *(f"{unit * value:.2f}" for value in (spread.rmse, spread.mean, spread.median, spread.p95, spread.max)),
        )
        for name, spread, unit in error.rows()
    ]
    return table(("", "RMS", "mean", "median", "95 %", "largest"), rows)
