"""How far an estimated trajectory is from the true one: the field's measures, as evo defines them.

Absolute error: position differences after alignment (Sturm et al. 2012, "ATE"; Umeyama 1991 for the
alignment).  Relative error: error of the motion over a number of poses, which no early mistake
can spoil.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from lmkit.arrays import FloatArray, IntArray
from lmkit.errors import InputError, InputWarning, warn_caller
from lmkit.geometry.planar import wrap_angle
from lmkit.model.trajectory import Trajectory
from lmkit.units import unit_of_ratio

ALIGNMENTS = ("none", "rigid", "scale")
AT_LEAST_0 = "give max_apart_s (--max-apart) in seconds, 0 or more"
LARGE_ROTATION_RAD, AGREEING = 0.5, 0.1  # mean difference of rotations, and share that another order leaves of it
LEAST_UNIT, ALIKE = 30.0, 0.9  # inches and smaller units; correlation of distances from the start
LEAST_ACTUAL_M = 0.05  # the percentage error of a shorter distance has no meaning


@dataclass(frozen=True)
class Spread:
    """Statistics of errors: root mean square, mean, median, standard deviation, extremes, 95th percentile."""

    rmse: float
    mean: float
    median: float
    std: float
    min: float
    max: float
    p95: float

    @classmethod
    def of(cls, values: FloatArray) -> Spread:
        """Statistics of (N,) values."""
        return cls(
            float(np.sqrt(np.mean(values**2))),
            float(values.mean()),
            float(np.median(values)),
            float(values.std()),
            float(values.min()),
            float(values.max()),
            float(np.percentile(values, 95)),
        )


@dataclass(frozen=True, eq=False)
class TrajectoryError:
    """An estimate against the truth.

    Attributes:
        pairs: poses compared; ``missing`` of the truth's have no estimate near in time.
        position_m, rotation_deg: absolute errors.
        heading_deg: absolute errors of the direction about z.
        relative_position_m, relative_rotation_deg: of the motion over ``delta`` poses; None with too few.
        percent: the source paper's: |actual - measured| / actual distance from the start, mean; None where
            nothing moved.
        scale: of the alignment.
        truth, estimate: the poses compared, the estimate's aligned.
    """

    pairs: int
    missing: int
    position_m: Spread
    rotation_deg: Spread
    heading_deg: Spread
    relative_position_m: Spread | None
    relative_rotation_deg: Spread | None
    percent: float | None
    scale: float
    truth: Trajectory
    estimate: Trajectory

    def rows(self) -> list[tuple[str, Spread, float]]:
        """Name with its unit, statistics, and factor to that unit, of each kind of error."""
        rows = (
            ("position, mm", self.position_m, 1000.0),
            ("rotation, deg", self.rotation_deg, 1.0),
            ("heading, deg", self.heading_deg, 1.0),
            ("relative position, mm", self.relative_position_m, 1000.0),
            ("relative rotation, deg", self.relative_rotation_deg, 1.0),
        )
        return [(name, spread, unit) for name, spread, unit in rows if spread is not None]

    def __repr__(self) -> str:
        position_mm, rotation_deg = 1000 * self.position_m.rmse, self.rotation_deg.rmse
        return f"TrajectoryError({self.pairs} pairs, RMS {position_mm:.1f} mm and {rotation_deg:.2f} deg)"

    def to_dict(self) -> dict[str, Any]:
        """The result as JSON values; docs/formats.md lists the keys."""

        def spread(values: Spread | None) -> dict[str, float] | None:
            return None if values is None else dict(vars(values))

        return {
            "pairs": self.pairs,
            "missing": self.missing,
            "position_m": spread(self.position_m),
            "rotation_deg": spread(self.rotation_deg),
            "heading_deg": spread(self.heading_deg),
            "relative_position_m": spread(self.relative_position_m),
            "relative_rotation_deg": spread(self.relative_rotation_deg),
            "percent": self.percent,
            "scale": self.scale,
        }


def compare_trajectories(
    truth: Trajectory, estimate: Trajectory, align: str = "none", delta: int = 1, max_apart_s: float = 0.01
) -> TrajectoryError:
    """Compare two trajectories.

    Args:
        align: ``none``: both are in the same map; ``rigid``: the estimate is turned and shifted onto the truth;
            ``scale``: and stretched.
        delta: number of poses over which relative errors are measured.
        max_apart_s: poses belong together when their times differ by no more.

    Raises:
        InputError: an unknown alignment, a number out of range, no poses that belong together, or too few to align.

    Warns:
        InputWarning: lengths of another unit, or quaternions with w first.
    """
    if align not in ALIGNMENTS:
        raise InputError("bad_align", f"align {align!r} is unknown", f"choose {', '.join(ALIGNMENTS)} (--align)")
    if delta < 1:
        raise InputError("bad_option", f"delta {delta} is out of range", "give 1 or more (--delta)")
    if not max_apart_s >= 0:
        raise InputError("bad_option", f"the largest time difference {max_apart_s:g} s is out of range", AT_LEAST_0)
    in_truth, in_estimate = associate(truth.times_s, estimate.times_s, max_apart_s)
    if not len(in_truth):
        raise InputError(
            "no_common_times",
            f"no poses of the two trajectories lie within {max_apart_s:g} s of each other",
            _clock_hint(truth.times_s, estimate.times_s),
        )
    missing = len(truth) - len(np.unique(in_truth))
    true, found = truth.rows(in_truth), estimate.rows(in_estimate)
    for doubt in _doubts(true, found, align):
        warn_caller(InputWarning(doubt))
    scale = 1.0
    if align != "none":
        R, t, scale = umeyama(found.positions, true.positions, align == "scale")
        found = found.moved(R, t, scale)
    off_m, off_rad = pose_errors(true, found)
    heading = np.abs(wrap_angle(_headings(found) - _headings(true)))
    relative = _relative(true, found, delta)
    return TrajectoryError(
        pairs=len(true),
        missing=missing,
        position_m=Spread.of(off_m),
        rotation_deg=Spread.of(np.rad2deg(off_rad)),
        heading_deg=Spread.of(np.rad2deg(heading)),
        relative_position_m=None if relative is None else Spread.of(relative[0]),
        relative_rotation_deg=None if relative is None else Spread.of(np.rad2deg(relative[1])),
        percent=_percent(true, found),
        scale=scale,
        truth=true,
        estimate=found,
    )


def _doubts(true: Trajectory, found: Trajectory, align: str) -> list[str]:
    """Sentences about lengths in another unit, and quaternions whose order differs."""
    doubts = []
    reached = [np.linalg.norm(t.positions - t.positions[0], axis=1) for t in (true, found)]
    ratio = _ratio_of_alike(*reached) if align != "scale" else 1.0
    for name, other, factor in (("estimate", "truth", ratio), ("truth", "estimate", 1 / ratio)):
        if factor > LEAST_UNIT and (unit := unit_of_ratio(factor)):
            doubts.append(f"the {name} extends {factor:.4g} times as far as the {other}{unit}: write meters")
    off_rad = float(pose_errors(true, found)[1].mean())
    if off_rad > LARGE_ROTATION_RAD:
        for name, poses, others in (("estimate", found, true), ("truth", true, found)):
            w_first = replace(poses, quaternions=poses.quaternions[:, [1, 2, 3, 0]])
            if float(pose_errors(others, w_first)[1].mean()) < AGREEING * off_rad:
                doubts.append(f"rotations agree if the quaternions of the {name} have w first: write x y z w")
    return doubts


def _ratio_of_alike(a: FloatArray, b: FloatArray) -> float:
    """Ratio b / a of (N,) distances that grow and shrink together; 1 if they do not."""
    if len(a) < 3 or not min(a.std(), b.std()) > 0 or np.corrcoef(a, b)[0, 1] < ALIKE:
        return 1.0
    return float(b.mean() / a.mean())


def _clock_hint(truth_s: FloatArray, estimate_s: FloatArray) -> str:
    """Advice for times that do not meet: another unit, or clocks whose difference is the option to give."""
    middles = [float(times[len(times) // 2]) for times in (truth_s, estimate_s)]
    for factor, unit in ((1e3, "milliseconds"), (1e6, "microseconds")):
        for name, (a, b) in (("estimate", middles), ("truth", middles[::-1])):
            if min(a, b) > 0 and 0.9 < b / a / factor < 1.1:
                return f"the times of the {name} look like {unit}: write seconds"
    offset = float(truth_s[0] - estimate_s[0])
    return (
        f"check that both clocks agree: shifted by {offset:.3f} s (--time-offset {offset:.3f}) they start together; "
        "or allow larger differences (max_apart_s, --max-apart)"
    )


def pose_errors(true: Trajectory, found: Trajectory) -> tuple[FloatArray, FloatArray]:
    """(N,) meters and rad between the poses of two trajectories, row by row."""
    turned = Rotation.from_quat(true.quaternions).inv() * Rotation.from_quat(found.quaternions)
    return np.linalg.norm(found.positions - true.positions, axis=1), turned.magnitude()


def associate(times_a: FloatArray, times_b: FloatArray, max_apart_s: float) -> tuple[IntArray, IntArray]:
    """Rows of both that belong together: of every time of the shorter, the nearest of the longer."""
    if len(times_a) > len(times_b):
        rows_b, rows_a = associate(times_b, times_a, max_apart_s)
        return rows_a, rows_b
    after = np.searchsorted(times_b, times_a).clip(1, max(len(times_b) - 1, 1))
    if len(times_b) == 1:
        nearest = np.zeros(len(times_a), dtype=np.int64)
    else:
        earlier = np.abs(times_a - times_b[after - 1]) <= np.abs(times_b[after] - times_a)
        nearest = np.where(earlier, after - 1, after)
    close = np.abs(times_b[nearest] - times_a) <= max_apart_s
    return np.flatnonzero(close), nearest[close]


def umeyama(source: FloatArray, target: FloatArray, with_scale: bool) -> tuple[FloatArray, FloatArray, float]:
    """R (3,3), t (3,), scale that bring (N,3) source nearest to target in the least squares sense.

    Raises:
        InputError: the points do not fix a rotation.
    """
    mean_source, mean_target = source.mean(axis=0), target.mean(axis=0)
    a, b = source - mean_source, target - mean_target
    U, d, Vt = np.linalg.svd(b.T @ a / len(source))
    if len(source) < 3 or d[1] < 1e-12 * max(d[0], 1e-300):
        raise InputError(
            "no_alignment",
            "the poses do not fix an alignment: too few, or all on a line",
            "choose align none (--align none)",
        )
    sign = np.diag([1.0, 1.0, float(np.sign(np.linalg.det(U) * np.linalg.det(Vt)))])
    R = U @ sign @ Vt
    scale = float(np.trace(np.diag(d) @ sign) / (a**2).sum(axis=1).mean()) if with_scale else 1.0
    return R, mean_target - scale * R @ mean_source, scale


def _relative(true: Trajectory, found: Trajectory, delta: int) -> tuple[FloatArray, FloatArray] | None:
    """(M,) meters and rad that the motion from pose to pose, ``delta`` apart, is off."""
    rows = np.arange(0, len(true), delta)
    if len(rows) < 2:
        return None
    motions = []
    for trajectory in (true, found):
        R, p = trajectory.rotations[rows], trajectory.positions[rows]
        back = R[:-1].transpose(0, 2, 1)
        motions.append((back @ R[1:], np.einsum("nij,nj->ni", back, p[1:] - p[:-1])))
    (R_true, t_true), (R_found, t_found) = motions
    turned = Rotation.from_matrix(R_true.transpose(0, 2, 1) @ R_found).magnitude()
    return np.linalg.norm(t_found - t_true, axis=1), turned


def _headings(trajectory: Trajectory) -> FloatArray:
    """(N,) rad: where the x axis points in the map's plane; of a camera that looks level, its z axis."""
    R = trajectory.rotations
    # The most level axis is best determined: x of a robot's base, z of a camera.
    axis = 0 if np.abs(R[:, 2, 0]).mean() <= np.abs(R[:, 2, 2]).mean() else 2
    return np.arctan2(R[:, 1, axis], R[:, 0, axis])


def _percent(true: Trajectory, found: Trajectory) -> float | None:
    start = true.positions[0]
    actual = np.linalg.norm(true.positions - start, axis=1)
    measured = np.linalg.norm(found.positions - start, axis=1)
    far = actual > LEAST_ACTUAL_M
    if not far.any():
        return None
    return float(100 * np.mean(np.abs(actual[far] - measured[far]) / actual[far]))


def error_lines(error: TrajectoryError) -> list[str]:
    """The errors as a table, lines of text."""
    lines = [
        f"poses compared         {error.pairs}; true poses without an estimate: {error.missing}",
        f"{'':<22} {'rmse':>9} {'mean':>9} {'median':>9} {'95 %':>9} {'largest':>9}",
    ]
    for name, spread, unit in error.rows():
        figures = (spread.rmse, spread.mean, spread.median, spread.p95, spread.max)
        lines.append(f"{name:<22} " + " ".join(f"{unit * v:9.3f}" for v in figures))
    if error.percent is not None:
        lines.append(f"percentage error       {error.percent:.3f} % of the distance from the start")
    return lines
