"""Do poses and maps from ranges and bearings err as their covariances say?  NEES over many simulated recordings.

    uv run python benchmarks/reading_nees.py [--seeds 40] [--first 1] [--seconds 60]

A robot drives round a room with 14 landmarks on its walls; a sensor in its middle tells range and bearing of those
that the left camera would see, five times a second.  ``independent``: every reading errs by chance alone.  ``alike``:
errors of one landmark last (a Gauss-Markov process of 20 s, so that 40 s hold one independent reading), as
do those that turn all bearings, and all ranges of a recording are too long or too short by one factor: what
`DRIVE_NOISE` stands for.

Rows: the whole recording through the known map, live through the known map, the survey's poses, and the places that
it finds.  NEES over the dimension, mean over recordings with its standard error and the 10 to 90 % of recordings;
share within 95 % ellipsoids; root mean square error of the place, and the stated one.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

import numpy as np
from scipy.stats import chi2

from lmkit.arrays import FloatArray
from lmkit.geometry.planar import planar_state, wrap_angle
from lmkit.localization.range_bearing_noise import DRIVE_NOISE, ReadingNoise
from lmkit.mapping.range_bearing_survey import ReadingFrames, survey_readings
from lmkit.model.observation import RangeBearing
from lmkit.model.tracked_trajectory import TrackedTrajectory
from lmkit.simulation.recording import Drive, make_drive
from lmkit.tracking.batch import track_readings
from lmkit.tracking.online import track_live

LASTING_S = 20.0
SETTLED_S = 3.0
SIZE_M = 0.18
PLANE = np.array([0, 1, 5])
Rows = tuple[FloatArray, FloatArray]  # errors (N,D), covariances (N,D,D)


class Lasting:
    """A first-order Gauss-Markov process of standard deviation 1."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng, self._time, self._value = rng, 0.0, float(rng.normal())

    def at(self, time_s: float) -> float:
        kept = np.exp(-(time_s - self._time) / LASTING_S)
        self._value = float(kept * self._value + np.sqrt(1 - kept**2) * self._rng.normal())
        self._time = time_s
        return self._value


def readings(drive: Drive, seed: int, alike: bool, noise: ReadingNoise) -> ReadingFrames:
    """Readings that err as the noise says."""
    rng = np.random.default_rng([seed, 31])
    processes: dict[object, Lasting] = {}

    def error(key: object, time_s: float) -> float:
        return processes.setdefault(key, Lasting(rng)).at(time_s) if alike else float(rng.normal())

    scale = 1 + noise.range_scale * rng.normal() * alike
    frames = []
    for state, frame in zip(drive.truth, drive.frames, strict=True):
        seen, together = [], noise.common_bearing_rad * error("frame", frame.time_s)
        for id_ in sorted({o.id for o in frame.seen[0]}):
            mounted = drive.landmarks.find(id_)
            assert mounted is not None
            off = mounted.T_map_landmark.t[:2] - state[:2]
            distance = float(np.hypot(*off))
            sigma = float(noise.range_sigma(np.array(distance)))
            range_m = scale * distance + sigma * error((id_, "range"), frame.time_s)
            bearing = (
                np.arctan2(off[1], off[0]) - state[2] + noise.bearing_rad * error((id_, "bearing"), frame.time_s)
            )
            turned = float(np.angle(np.exp(1j * (bearing + together))))
            seen.append(RangeBearing(id_, max(range_m, 0.05), turned))
        frames.append((frame.time_s, seen))
    return frames


def pose_rows(found: TrackedTrajectory, drive: Drive, true: FloatArray) -> Rows:
    """Errors of x, y and heading against the true states (N,3) of all frames."""
    rows = np.searchsorted(drive.times_s, found.times_s)
    kept = found.times_s >= drive.times_s[0] + SETTLED_S
    off = np.array([planar_state(pose) for pose in found.poses]) - true[rows]
    off[:, 2] = wrap_angle(off[:, 2])
    return off[kept], found.covariances[kept][:, PLANE[:, None], PLANE]


def surveyed(drive: Drive, frames: ReadingFrames) -> tuple[Rows, Rows]:
    """Poses and places of a survey, whose map begins at the first pose."""
    landmarks, found = survey_readings(frames, drive.odometry, drive.gyro, SIZE_M)
    x, y, heading = drive.truth[0]
    R = np.array([[np.cos(heading), -np.sin(heading)], [np.sin(heading), np.cos(heading)]])
    true = np.column_stack([(drive.truth[:, :2] - [x, y]) @ R, drive.truth[:, 2] - heading])
    errors, covariances = [], []
    for m in landmarks:
        mounted = drive.landmarks.find(m.id)
        assert mounted is not None and m.covariance is not None
        errors.append(m.T_map_landmark.t[:2] - (mounted.T_map_landmark.t[:2] - [x, y]) @ R)
        covariances.append(m.covariance[:2, :2])
    return pose_rows(found, drive, true), (np.array(errors), np.array(covariances))


def line(name: str, rows: Sequence[Rows]) -> str:
    """One row of the table, from every recording's errors."""
    squared = [np.einsum("ni,ni->n", e, np.linalg.solve(C, e[..., None])[..., 0]) for e, C in rows]
    size = rows[0][0].shape[1]
    means = np.array([values.mean() / size for values in squared])
    low, high = np.percentile(means, [10, 90])
    within = np.mean([np.mean(values < chi2.ppf(0.95, size)) for values in squared])
    place = np.sqrt(np.mean([(e[:, :2] ** 2).sum(axis=1).mean() for e, _ in rows]))
    stated = np.sqrt(np.mean([np.trace(C[:, :2, :2], axis1=1, axis2=2).mean() for _, C in rows]))
    error = means.std() / np.sqrt(len(means))
    return (
        f"| {name} | {len(rows)} | {means.mean():.2f} ± {error:.2f} | {low:.2f} to {high:.2f} "
        f"| {100 * within:.0f} % | {100 * place:.1f} cm | {100 * stated:.1f} cm |"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=40)
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=60.0)
    given = parser.parse_args()
    print("| readings | recordings | NEES over its dimension | 10 to 90 % | within 95 % | error | stated |")
    print("|---|---|---|---|---|---|---|")
    drives = [make_drive(seed, given.seconds) for seed in range(given.first, given.first + given.seeds)]
    for name, alike in (("independent", False), ("alike", True)):
        smoothed, live, poses, places = [], [], [], []
        for seed, drive in enumerate(drives, given.first):
            frames = readings(drive, seed, alike, DRIVE_NOISE)
            known = frames, drive.odometry, drive.gyro, drive.landmarks
            smoothed.append(pose_rows(track_readings(*known), drive, drive.truth))
            live.append(pose_rows(track_live(*known), drive, drive.truth))
            found = surveyed(drive, frames)
            poses.append(found[0])
            places.append(found[1])
        named = {"track": smoothed, "track --live": live, "survey, poses": poses, "survey, places": places}
        for what, rows in named.items():
            print(line(f"{name}: {what}", rows), flush=True)


if __name__ == "__main__":
    main()
