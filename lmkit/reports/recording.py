"""Reports of drives: what a survey found and how well, and how a robot was followed through a map."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from lmkit.arrays import BoolArray, FloatArray
from lmkit.geometry.pose import Pose
from lmkit.mapping.survey import OUTLIER_SIGMA, Survey, deviations
from lmkit.model.landmark_map import LandmarkMap
from lmkit.model.pose_status import PoseStatus
from lmkit.model.tracked_trajectory import TrackedTrajectory
from lmkit.odometry.motion_model import Motion
from lmkit.visualization.html import GREY, figure, grid, listed, page, svg, svg_text, table, verdict
from lmkit.visualization.plan_view import Found, draw_plan

MOST_DRAWN = 60  # poses of a plan
MOST_DOTS = 3000
SEEN, LEFT_OUT, OTHER = "#2f6fde", "#cf222e", "#e8833a"
WIDTH, HEIGHT, ASIDE, BELOW = 640.0, 200.0, 52.0, 24.0
INSIDE = 0.95
TOO_MANY_OUTSIDE = 0.15  # of frames beyond the band: the covariance claims too much


@dataclass(frozen=True, eq=False)
class _Series:
    times_s: FloatArray
    values: FloatArray
    color: str
    dots: bool = True


def survey_report(survey: Survey, motion: Motion | None, warnings: Sequence[str]) -> str:
    """The report of a survey, as HTML.

    Args:
        warnings: as told to the user.
    """
    bundle = survey.bundle
    believed = bundle.residuals < OUTLIER_SIGMA
    times = bundle.times_s[bundle.frames]
    plan = draw_drive(
        bundle.landmarks,
        bundle.times_s,
        bundle.left_poses(),
        bundle.covariances,
        [True] * len(bundle.times_s),
        "svg",
    ).decode()
    place_mm = 1000 * np.sqrt(np.einsum("nii->n", bundle.covariances[:, :3, :3]))
    turn_deg = np.rad2deg(np.sqrt(np.linalg.eigvalsh(bundle.covariances[:, 3:, 3:])[:, -1]))
    parts = [
        f"<p>{len(bundle.landmarks)} landmarks, {len(bundle.times_s)} frames, {len(bundle.of)} observations, "
        f"{survey.dropped} left out, {bundle.rms_px:.2f} px</p>",
        verdict(*_survey_verdict(survey)),
        listed("Warnings", warnings),
        "<h2>Map and drive</h2>",
        figure(plan, "Landmarks and the left camera from above; 95 % ellipses."),
        "<h2>Landmarks</h2>",
        _landmarks(survey, believed),
        "<h2>Residuals</h2>",
        grid(
            [
                (
                    _over_time(
                        [
                            _Series(times[believed], bundle.residuals[believed], SEEN),
                            _Series(times[~believed], bundle.residuals[~believed], LEFT_OUT),
                        ],
                        "residual of an observation, standard deviations",
                        log=True,
                    ),
                    "Every observation; red: left out. Honest covariances make it 1 on average.",
                ),
                (
                    _over_time(
                        [_Series(bundle.times_s, place_mm, SEEN, False)], "standard deviation of the place, mm"
                    ),
                    "How well the camera's place is known.",
                ),
                (
                    _over_time(
                        [_Series(bundle.times_s, turn_deg, OTHER, False)], "standard deviation of the turn, deg"
                    ),
                    "How well its direction is known.",
                ),
            ],
            "two",
        ),
    ]
    if motion is not None:
        parts.append(_odometry(dict(zip(motion.names, bundle.parameters.tolist(), strict=True))))
    return page("Survey", parts)


def track_report(drive: TrackedTrajectory, landmarks: LandmarkMap) -> str:
    """The report of a robot that was followed through a map, as HTML."""
    sure = [status == PoseStatus.OK for status in drive.statuses]
    plan = draw_tracked(drive, landmarks, "svg").decode()
    C = drive.covariances
    place_mm = 1000 * np.sqrt(np.einsum("nii->n", C[:, :3, :3]))
    heading_deg = np.rad2deg(np.sqrt(np.maximum(C[:, 5, 5], 0.0)))
    parts = [
        f"<p>{len(drive.times_s)} frames, {sum(sure)} of them sure</p>",
        verdict(*_track_verdict(drive)),
        listed("Warnings", drive.remarks),
        "<h2>Drive</h2>",
        figure(plan, "The robot from above; 95 % ellipses. Grey: not sure."),
        "<h2>Innovations</h2>",
        _nis(drive),
        "<h2>How well the pose is known</h2>",
        grid(
            [
                (
                    _over_time(
                        [_Series(drive.times_s, place_mm, SEEN, False)], "standard deviation of the place, mm"
                    ),
                    "",
                ),
                (_over_time([_Series(drive.times_s, heading_deg, OTHER, False)], "of the heading, deg"), ""),
            ],
            "two",
        ),
        _odometry(drive.parameters),
    ]
    return page("Track", parts)


def draw_drive(
    landmarks: LandmarkMap,
    times_s: FloatArray,
    looking: Sequence[Pose],
    covariances: FloatArray,
    sure: Sequence[bool],
    kind: str,
) -> bytes:
    """The map and some of the poses from above, as ``png`` or ``svg``.

    Args:
        looking: (N) poses of a camera that looks where the robot does.
        covariances: (N,6,6) of them.
    """
    found = [
        Found(f"{times_s[k]:.1f} s", looking[k], covariances[k][:2, :2], sure[k])
        for k in range(0, len(times_s), 1 + len(times_s) // MOST_DRAWN)
    ]
    return draw_plan(landmarks, found, kind=kind)


def draw_survey(survey: Survey, kind: str) -> bytes:
    """The map and some of the left camera's poses from above, as ``png`` or ``svg``."""
    bundle = survey.bundle
    sure = [True] * len(bundle.times_s)
    return draw_drive(bundle.landmarks, bundle.times_s, bundle.left_poses(), bundle.covariances, sure, kind)


def draw_tracked(drive: TrackedTrajectory, landmarks: LandmarkMap, kind: str) -> bytes:
    """The map and some of the robot's poses from above, as ``png`` or ``svg``."""
    looking = [drive.looking(k) for k in range(len(drive))]
    sure = [status == PoseStatus.OK for status in drive.statuses]
    return draw_drive(landmarks, drive.times_s, looking, drive.covariances, sure, kind)


def _survey_verdict(survey: Survey) -> tuple[str, str, str]:
    if survey.odd or survey.bundle.jumps:
        return "poor", "The recording contradicts itself.", "See the warnings: something was moved, or is misread."
    if survey.unplaced or survey.weak or survey.ambiguous or survey.astray:
        return (
            "fair",
            "A map with gaps.",
            "Some landmarks are known badly or not at all; the warnings say what would help.",
        )
    worst = max((deviations(m)[0] for m in survey.bundle.landmarks), default=0.0)
    return (
        "good",
        "A good map.",
        f"Every landmark is known to {1000 * worst:.0f} mm or better, and nothing contradicts it.",
    )


def _track_verdict(drive: TrackedTrajectory) -> tuple[str, str, str]:
    unsure = sum(status != PoseStatus.OK for status in drive.statuses)
    outside, counted = _outside(drive)
    if drive.remarks:
        return "poor", "Something is wrong.", "See the warnings."
    if counted and outside > TOO_MANY_OUTSIDE * counted:
        return (
            "fair",
            "The covariance claims too much.",
            f"{outside} of {counted} frames lie above the {100 * INSIDE:.0f} % band of their innovations.",
        )
    if unsure:
        return "fair", "Followed with gaps.", f"{unsure} of {len(drive.statuses)} frames are not sure."
    return "good", "Followed all the way.", "Every frame has a sure pose."


def _landmarks(survey: Survey, believed: BoolArray) -> str:
    bundle = survey.bundle
    rows = []
    for m in sorted(bundle.landmarks, key=lambda m: m.id):
        mine = bundle.of == bundle.ids.index(m.id)
        place, turn = deviations(m)
        x, y, z = m.T_map_landmark.t
        misfit = f"{np.median(bundle.residuals[mine]):.2f}" if mine.any() else ""
        rows.append(
            (str(m.id), f"{x:.3f}", f"{y:.3f}", f"{z:.3f}", f"± {1000 * place:.1f}", f"± {np.rad2deg(turn):.2f}",
             str(mine.sum()), str((mine & ~believed).sum()), misfit)
        )  # fmt: skip
    head = ("landmark", "x, m", "y, m", "z, m", "mm", "deg", "sightings", "left out", "residual, median")
    return table(head, rows)


def _nis(drive: TrackedTrajectory) -> str:
    squared, told = drive.nis.T
    some = told > 0
    if not some.any():
        return "<p class='note'>No landmark was seen.</p>"
    ratio = squared[some] / told[some]
    above = ratio > chi2.ppf(INSIDE, told[some]) / told[some]
    times = drive.times_s[some]
    outside, counted = _outside(drive)
    plot = _over_time(
        [_Series(times[~above], ratio[~above], SEEN), _Series(times[above], ratio[above], LEFT_OUT)],
        "squared innovation, 1 expected",
        log=True,
    )
    return figure(
        plot,
        f"Mean {squared.sum() / told.sum():.2f} of an ideal 1. Red: above the {100 * INSIDE:.0f} % band of honest "
        f"covariances, {outside} of {counted} frames.",
    )


def _outside(drive: TrackedTrajectory) -> tuple[int, int]:
    """Frames above the band of their innovations, of those that saw something."""
    squared, told = drive.nis.T
    some = told > 0
    return int((squared[some] > chi2.ppf(INSIDE, told[some])).sum()), int(some.sum())


def _odometry(parameters: Mapping[str, float]) -> str:
    if not parameters:
        return ""
    rows = [(name.replace("_", " "), f"{value:.4f}") for name, value in parameters.items()]
    return "<h2>What is wrong with the odometry</h2>" + table(("", ""), rows)


def _over_time(series: Sequence[_Series], label: str, log: bool = False) -> str:
    """Values over time, linear from 0 or logarithmic."""
    times = np.concatenate([s.times_s for s in series])
    values = np.concatenate([s.values for s in series])
    first, last = float(times.min()), max(float(times.max()), float(times.min()) + 1e-9)
    if log:
        low = 10 ** np.floor(np.log10(max(float(np.percentile(values, 1)), 1e-2)))
        high = 10 ** np.ceil(np.log10(max(float(values.max()), 10 * low)))
        ticks = [float(10**power) for power in range(round(np.log10(low)), round(np.log10(high)) + 1)]
    else:
        high = _round_up(float(values.max()))
        low, ticks = 0.0, [0.0, high / 2, high]

    def up(value: FloatArray) -> FloatArray:
        share = np.log(np.clip(value, low, high) / low) / np.log(high / low) if log else value / high
        return np.asarray(HEIGHT * (1 - share))

    def along(times_s: FloatArray) -> FloatArray:
        return np.asarray((times_s - first) / (last - first) * WIDTH)

    parts = []
    for tick in ticks:
        level = float(up(np.array(tick)))
        parts.append(f"<path d='M0 {level:.1f}H{WIDTH:g}' stroke='{GREY}' stroke-opacity='.35'/>")
        parts.append(svg_text(-6, level + 4, f"{tick:g}", 12, "end"))
    for one in series:
        x, y = along(one.times_s), up(one.values)
        if one.dots:
            step = 1 + len(x) // MOST_DOTS
            parts += [
                f"<circle cx='{a:.1f}' cy='{b:.1f}' r='2' fill='{one.color}' fill-opacity='.6'/>"
                for a, b in zip(x[::step], y[::step], strict=True)
            ]
        else:
            path = "L".join(f"{a:.1f} {b:.1f}" for a, b in zip(x, y, strict=True))
            parts.append(f"<path d='M{path}' fill='none' stroke='{one.color}' stroke-width='1.6'/>")
    parts.append(svg_text(0, -8, label, 13))
    parts.append(svg_text(0, HEIGHT + 18, f"{first:.1f} s", 12))
    parts.append(svg_text(WIDTH, HEIGHT + 18, f"{last:.1f} s", 12, "end"))
    box = (-ASIDE, -BELOW, WIDTH + ASIDE + 12, HEIGHT + 2 * BELOW)
    return svg(box, 640, label, "".join(parts))


def _round_up(value: float) -> float:
    """The next of 1, 2, 5, 10, ..."""
    power = 10 ** np.floor(np.log10(max(value, 1e-9)))
    return float(next(step * power for step in (1, 2, 5, 10) if step * power >= value * (1 - 1e-9)))
