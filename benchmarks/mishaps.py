"""Faults of real surveys, simulated: each is corrected, named, or distorts the map without a report.

    uv run python benchmarks/mishaps.py [--seeds 10] [--first 0]

Recordings of a minute with one anchor (`simulation/recording.py`: simulated corners, wheels and gyro).  From half way
on two landmarks are swapped, or one is mounted on the wall across; odometry stops for 10 s, or its clock jumps by 2 s
(without the gyro); no landmark larger than 30 px is seen.  Distorted: a landmark that was not touched is off by more
than 5 cm or 0.15 rad and four standard deviations.  Named: the survey reports a contradiction, an ambiguity, or a
landmark that it could not place.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from lmkit.errors import LmkitError
from lmkit.geometry.pose import Pose
from lmkit.geometry.rotations import rotation_angle
from lmkit.mapping.bundle_adjustment import Anchor
from lmkit.mapping.survey import survey_frames
from lmkit.mapping.survey_results import Survey
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import LandmarkMap
from lmkit.model.observation import Detection
from lmkit.model.recording import Gyro, Odometry, RigFrame
from lmkit.odometry.wheel_odometry import MotionModel
from lmkit.simulation.observations import look
from lmkit.simulation.recording import Drive, WheelErrors, make_drive

SECONDS, NOISE_PX, LARGEST_PX = 60.0, 0.15, 30.0
ROOM_M = (8.0, 5.0)
DISTORTED_M, DISTORTED_RAD, DISTORTED_SIGMA = 0.05, 0.15, 4.0
NAMES = ("nothing", "two swapped", "one moved", "odometry stops", "clock jumps", "all seen from afar")
WITHOUT_ODOMETRY = (0, 1, 2, 5)

Seen = tuple[Detection, ...]


@dataclass(frozen=True)
class Case:
    frames: Sequence[RigFrame]
    odometry: Odometry
    gyro: Gyro | None
    touched: frozenset[int] = frozenset()


def each_camera(frame: RigFrame, change: Callable[[Seen], Seen]) -> RigFrame:
    return replace(frame, seen=tuple(map(change, frame.seen)))


def cases(drive: Drive, seed: int) -> list[Case]:
    """Mishap of this name; see NAMES."""
    rng, half = np.random.default_rng(seed), len(drive.frames) // 2
    codes = list(dict.fromkeys(o.code for frame in drive.frames for o in frame.seen[0]))[1:]
    a, b, moved = (int(code) for code in rng.choice(codes, 3, replace=False))
    plain = Case(drive.frames, drive.odometry, drive.gyro)

    def swapped(seen: Seen) -> Seen:
        return tuple(replace(o, id=LandmarkId("lm8", {a: b, b: a}.get(o.code, o.code))) for o in seen)

    T = drive.landmarks.find(LandmarkId("lm8", moved)).T_map_landmark
    place = np.array([ROOM_M[0] - T.t[0], ROOM_M[1] - T.t[1], T.t[2]])
    across = Pose("map", "landmark", np.diag([-1.0, -1.0, 1.0]) @ T.R, place)
    mapped = LandmarkMap([replace(m, T_map_landmark=across) if m.code == moved else m for m in drive.landmarks])

    def seen_again(k: int) -> RigFrame:
        left, right = look(mapped, drive.rig, drive.pose(k), NOISE_PX, rng)
        return replace(drive.frames[k], seen=(left, right))

    def small(seen: Seen) -> Seen:
        return tuple(o for o in seen if np.linalg.norm(o.corners[0] - o.corners[1]) < LARGEST_PX)

    o = drive.odometry
    on = (o.times_s < 20) | (o.times_s > 30)
    return [
        plain,
        replace(
            plain,
            frames=[m if k < half else each_camera(m, swapped) for k, m in enumerate(drive.frames)],
            touched=frozenset({a, b}),
        ),
        replace(
            plain,
            frames=[m if k < half else seen_again(k) for k, m in enumerate(drive.frames)],
            touched=frozenset({moved}),
        ),
        replace(plain, odometry=Odometry(o.times_s[on], o.forward_m[on], o.turn_rad[on])),
        replace(
            plain,
            odometry=Odometry(np.where(o.times_s > 30, o.times_s + 2.0, o.times_s), o.forward_m, o.turn_rad),
            gyro=None,
        ),
        replace(plain, frames=[each_camera(m, small) for m in drive.frames]),
    ]


def outcome(drive: Drive, case: Case, wheels: bool) -> tuple[bool, bool]:
    """Distorted, and named."""
    seen = list(dict.fromkeys(o.code for frame in case.frames for o in frame.seen[0]))
    anchor = drive.landmarks.find(LandmarkId("lm8", next(code for code in seen if code not in case.touched)))
    sizes = {m.id: m.size_m for m in drive.landmarks}
    motion = MotionModel(case.odometry, case.gyro) if wheels else None
    try:
        survey = survey_frames(case.frames, drive.rig, sizes, {anchor.id: Anchor(anchor, None)}, motion)
    except LmkitError:
        return False, True
    named = survey.contradicted or survey.bundle.jumps or survey.unplaced or survey.ambiguous
    return distorted(drive, survey, case.touched), bool(named)


def distorted(drive: Drive, survey: Survey, touched: frozenset[int]) -> bool:
    for m in survey.bundle.landmarks:
        true, C = drive.landmarks.find(m.id).T_map_landmark, m.covariance
        off = float(np.linalg.norm(m.T_map_landmark.t - true.t))
        turned = float(rotation_angle(m.T_map_landmark.R.T @ true.R))
        place, turn = (np.sqrt(abs(np.linalg.eigvalsh(C[part, part])[-1])) for part in (slice(0, 3), slice(3, 6)))
        far = off > DISTORTED_M + DISTORTED_SIGMA * place
        if m.code not in touched and (far or turned > DISTORTED_RAD + DISTORTED_SIGMA * turn):
            return True
    return False


def outcomes(seed: int, wheels: bool) -> list[tuple[bool, bool]]:
    drive = make_drive(seed, SECONDS, size_m=ROOM_M, errors=WheelErrors(slips=seed % 2), noise_px=NOISE_PX)
    chosen = enumerate(cases(drive, seed))
    return [outcome(drive, case, wheels) for k, case in chosen if wheels or k in WITHOUT_ODOMETRY]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--first", type=int, default=0)
    arguments = parser.parse_args()
    seeds = range(arguments.first, arguments.first + arguments.seeds)
    print("| odometry | mishap | drives | map distorted | and not named | named |")
    print("|---|---|---|---|---|---|")
    for wheels in (True, False):
        with ProcessPoolExecutor() as pool:
            results = list(pool.map(partial(outcomes, wheels=wheels), seeds))
        names = NAMES if wheels else [NAMES[k] for k in WITHOUT_ODOMETRY]
        for name, runs in zip(names, zip(*results, strict=True), strict=True):
            silent = sum(distorted and not named for distorted, named in runs)
            print(
                f"| {'yes' if wheels else 'no'} | {name} | {len(runs)} | {sum(distorted for distorted, _ in runs)} "
                f"| {silent} | {sum(named for _, named in runs)} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
