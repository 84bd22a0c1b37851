"""HTML reports of a surveyed recording and of a tracked trajectory."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.stats import chi2

from lmkit.arrays import BoolArray, FloatArray
from lmkit.geometry.pose import Pose
from lmkit.mapping.hinges import folds_of
from lmkit.mapping.survey import OUTLIER_SIGMA
from lmkit.mapping.survey_results import Survey, deviations
from lmkit.model.landmark_map import LandmarkMap
from lmkit.model.pose_status import PoseStatus
from lmkit.model.tracked_trajectory import PARAMETER_WORDS, TrackedTrajectory
from lmkit.odometry.motion_model import Motion
from lmkit.reports.time_plots import LEFT_OUT, OTHER, SEEN, Series, over_time
from lmkit.visualization.html import GRAY, figure, grid, headline, listed, page, sized, table
from lmkit.visualization.plan_view import FILE_SIZE, PAGE_SIZE, PHONE_SIZE, Found, PlanSize, draw_plan

MOST_DRAWN = 60  # poses of a plan
DRAWN_ON_PAGE, DRAWN_ON_PHONE = 40, 16  # poses of a plan in a report
INSIDE = 0.95
TOO_MANY_OUTSIDE = 0.15  # share of frames outside the band: the covariance is too small


def survey_report(survey: Survey, motion: Motion | None, warnings: Sequence[str]) -> str:
    """HTML report of a survey.

    Args:
        warnings: the warnings that the command line printed.
    """
    bundle = survey.bundle
    believed = bundle.residuals < OUTLIER_SIGMA
    times = bundle.times_s[bundle.frames]
    plan = _trajectory(
        bundle.landmarks,
        bundle.times_s,
        bundle.left_poses(),
        bundle.covariances,
        [True] * len(bundle.times_s),
    )
    position_mm = 1000 * np.sqrt(np.einsum("nii->n", bundle.covariances[:, :3, :3]))
    rotation_deg = np.rad2deg(np.sqrt(np.linalg.eigvalsh(bundle.covariances[:, 3:, 3:])[:, -1]))
    parts = [
        f"<p>{len(bundle.landmarks)} landmarks, {len(bundle.times_s)} frames, {len(bundle.of)} observations, "
        f"{survey.dropped} rejected; reprojection error {bundle.rms_px:.2f} px (RMS)</p>",
        headline(*_survey_headline(survey, motion)),
        listed("Warnings", warnings),
        "<h2>Map and trajectory</h2>",
        figure(plan, "Landmarks and poses of the left camera from above, with 95 % ellipses."),
        "<h2>Landmarks</h2>",
        _landmarks(survey, believed),
        "<h2>Residuals</h2>",
        grid(
            [
                (
                    over_time(
                        [
                            Series(times[believed], bundle.residuals[believed], SEEN),
                            Series(times[~believed], bundle.residuals[~believed], LEFT_OUT),
                        ],
                        "residual, standard deviations",
                        log=True,
                    ),
                    "Residual of every observation. Red: rejected. The mean is 1 if the covariances are right.",
                ),
                (
                    over_time([Series(bundle.times_s, position_mm, SEEN, False)], "position, mm"),
                    "Standard deviation of the left camera's position.",
                ),
                (
                    over_time(
                        [Series(bundle.times_s, rotation_deg, OTHER, False)],
                        "rotation, deg",
                    ),
                    "Standard deviation of the left camera's rotation, about its least certain axis.",
                ),
            ],
            "two",
        ),
    ]
    if motion is not None:
        parts.append(_odometry(survey.odometry, survey.odometry_sigmas))
    return page("Survey", parts)


def track_report(tracked: TrackedTrajectory, landmarks: LandmarkMap) -> str:
    """HTML report of a robot tracked through a map."""
    sure = [status == PoseStatus.OK for status in tracked.statuses]
    C = tracked.covariances
    plan = _trajectory(landmarks, tracked.times_s, _looking(tracked), C, sure)
    position_mm = 1000 * np.sqrt(np.einsum("nii->n", C[:, :3, :3]))
    heading_deg = np.rad2deg(np.sqrt(np.maximum(C[:, 5, 5], 0.0)))
    parts = [
        f"<p>{len(tracked.times_s)} frames, {sum(sure)} located</p>",
        headline(*_track_headline(tracked)),
        listed("Warnings", tracked.remarks),
        "<h2>Trajectory</h2>",
        figure(plan, "Poses of the robot from above, with 95 % ellipses. Gray: no reliable pose."),
        "<h2>Innovations</h2>",
        _innovations(tracked),
        "<h2>Uncertainty of the pose</h2>",
        grid(
            [
                (
                    over_time([Series(tracked.times_s, position_mm, SEEN, False)], "position, mm"),
                    "Standard deviation of the position.",
                ),
                (
                    over_time(
                        [Series(tracked.times_s, heading_deg, OTHER, False)],
                        "heading, deg",
                    ),
                    "Standard deviation of the heading.",
                ),
            ],
            "two",
        ),
        _odometry(tracked.parameters, tracked.parameter_sigmas),
    ]
    return page("Track", parts)


def draw_trajectory(
    landmarks: LandmarkMap,
    times_s: FloatArray,
    looking: Sequence[Pose],
    covariances: FloatArray,
    sure: Sequence[bool],
    kind: str,
    size: PlanSize = FILE_SIZE,
    most: int = MOST_DRAWN,
) -> bytes:
    """The map and some of the poses from above, as ``png`` or ``svg``.

    Args:
        looking: (N) poses of a camera with the viewing direction of the robot's heading.
        covariances: (N,6,6) of these poses.
        size: of the drawing.
        most: largest number of drawn poses.
    """
    found = [
        Found(f"{times_s[k]:.1f} s", looking[k], covariances[k][:2, :2], sure[k])
        for k in range(0, len(times_s), 1 + len(times_s) // most)
    ]
    return draw_plan(landmarks, found, kind=kind, size=size)


def _trajectory(
    landmarks: LandmarkMap,
    times_s: FloatArray,
    looking: Sequence[Pose],
    covariances: FloatArray,
    sure: Sequence[bool],
) -> str:
    """The drawing of `draw_trajectory` for a page, and for a phone."""
    pages = (
        draw_trajectory(landmarks, times_s, looking, covariances, sure, "svg", size, most).decode()
        for size, most in ((PAGE_SIZE, DRAWN_ON_PAGE), (PHONE_SIZE, DRAWN_ON_PHONE))
    )
    return sized(*pages)


def draw_survey(survey: Survey, kind: str) -> bytes:
    """The map and some of the left camera's poses from above, as ``png`` or ``svg``."""
    bundle = survey.bundle
    sure = [True] * len(bundle.times_s)
    return draw_trajectory(bundle.landmarks, bundle.times_s, bundle.left_poses(), bundle.covariances, sure, kind)


def draw_tracked(tracked: TrackedTrajectory, landmarks: LandmarkMap, kind: str) -> bytes:
    """The map and some of the robot's poses from above, as ``png`` or ``svg``."""
    sure = [status == PoseStatus.OK for status in tracked.statuses]
    return draw_trajectory(landmarks, tracked.times_s, _looking(tracked), tracked.covariances, sure, kind)


def _looking(tracked: TrackedTrajectory) -> list[Pose]:
    return [tracked.looking(k) for k in range(len(tracked))]


def _survey_headline(survey: Survey, motion: Motion | None) -> tuple[str, str, str]:
    if survey.contradicted or survey.bundle.jumps:
        return (
            "poor",
            _contradictions(survey, motion),
            "The warnings name the observations and what to check in the room.",
        )
    if survey.unplaced or survey.poorly_determined or survey.ambiguous or survey.off_constraint:
        return (
            "fair",
            "The map is incomplete.",
            "Some landmarks are missing or poorly determined; the warnings name the views that would help.",
        )
    worst = max((deviations(m)[0] for m in survey.bundle.landmarks), default=0.0)
    return (
        "good",
        f"{len(survey.bundle.landmarks)} landmarks mapped.",
        f"Standard deviation of every position: {1000 * worst:.0f} mm or less. No observation contradicts the map.",
    )


def _contradictions(survey: Survey, motion: Motion | None) -> str:
    """The headline of a survey whose observations contradict each other; with odometry, a jump folds no map."""
    parts = []
    if names := [str(landmark.id) for landmark in survey.contradicted]:
        subject = "1 landmark contradicts" if len(names) == 1 else f"{len(names)} landmarks contradict"
        parts.append(f"{subject} the map: {', '.join(names)}")
    if folds := [str(fold.id) for fold in folds_of(survey.bundle)] if motion is None else []:
        parts.insert(0, f"The map is probably folded at {', '.join(folds)}")
    elif count := len(survey.bundle.jumps):
        parts.append("1 jump of the trajectory" if count == 1 else f"{count} jumps of the trajectory")
    return "; ".join(parts) + "."


def _track_headline(tracked: TrackedTrajectory) -> tuple[str, str, str]:
    unsure = sum(status != PoseStatus.OK for status in tracked.statuses)
    outside, counted = _outside(tracked)
    located = f"{len(tracked.statuses) - unsure} of {len(tracked.statuses)} frames located"
    if tracked.remarks:
        count = len(tracked.remarks)
        return "poor", f"{located}; {count} warning{'s' if count > 1 else ''}.", "The warnings name the cause."
    if counted and outside > TOO_MANY_OUTSIDE * counted:
        return (
            "fair",
            f"{located}; the covariances are too small.",
            f"Normalized innovations of {outside} of {counted} frames lie above the {100 * INSIDE:.0f} % bound.",
        )
    if unsure:
        return "fair", f"{located}.", f"{unsure} frames have no reliable pose."
    return "good", f"{located}.", "Every frame has a reliable pose."


def _landmarks(survey: Survey, believed: BoolArray) -> str:
    bundle = survey.bundle
    rows = []
    for m in sorted(bundle.landmarks, key=lambda m: m.id):
        mine = bundle.of == bundle.ids.index(m.id)
        position_m, rotation_rad = deviations(m)
        x, y, z = np.round(m.T_map_landmark.t, 3) + 0.0
        residual = f"{np.median(bundle.residuals[mine]):.2f}" if mine.any() else ""
        rows.append(
            (str(m.id), f"{x:.3f}", f"{y:.3f}", f"{z:.3f}", f"{1000 * position_m:.1f}",
             f"{np.rad2deg(rotation_rad):.2f}", str(mine.sum()), str((mine & ~believed).sum()), residual)
        )  # fmt: skip
    head = ("landmark", "x, m", "y, m", "z, m", "±\u00a0mm", "±\u00a0deg", "seen", "rejected", "residual")
    note = (
        "<p class='note'>± is one standard deviation, of the axis that is known least. Residual: the median, in "
        "standard deviations.</p>"
    )
    return note + table(head, rows)


def _innovations(tracked: TrackedTrajectory) -> str:
    squared, dof = tracked.nis.T
    some = dof > 0
    if not some.any():
        return "<p class='note'>No landmark was seen.</p>"
    ratio = squared[some] / dof[some]
    bound = chi2.ppf(INSIDE, dof[some]) / dof[some]
    above, times = ratio > bound, tracked.times_s[some]
    outside, counted = _outside(tracked)
    plot = over_time(
        [
            Series(times, bound, GRAY, dots=False),
            Series(times[~above], ratio[~above], SEEN),
            Series(times[above], ratio[above], LEFT_OUT),
        ],
        "NIS / degrees of freedom",
        log=True,
    )
    return figure(
        plot,
        "Normalized innovation squared (NIS): how far the observations lie from the prediction, against their "
        f"covariance. Mean {squared.sum() / dof.sum():.2f}. 1 is expected where errors are as large as stated and "
        "independent; observations that share errors (of lenses, of the map) give less. "
        f"Line: {100 * INSIDE:.0f} % bound. Red: above it, {outside} of {counted} frames.",
    )


def _outside(tracked: TrackedTrajectory) -> tuple[int, int]:
    """(frames whose normalized innovation lies above the bound, frames with an observation)."""
    squared, dof = tracked.nis.T
    some = dof > 0
    return int((squared[some] > chi2.ppf(INSIDE, dof[some])).sum()), int(some.sum())


def _odometry(parameters: Mapping[str, float], sigmas: Mapping[str, float]) -> str:
    if not parameters:
        return ""
    rows = []
    for name, value in parameters.items():
        row = [PARAMETER_WORDS.get(name, name.replace("_", " ")), f"{round(value, 4) + 0.0:.4f}"]
        if sigmas:
            row.append(f"{sigmas[name]:.4f}" if name in sigmas else "")
        rows.append(row)
    return "<h2>Odometry errors</h2>" + table(("", "estimate", "±") if sigmas else ("", "estimate"), rows)
