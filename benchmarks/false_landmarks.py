"""False readings in recordings: which of them become landmarks of the map, and what happens to the true ones.

    uv run python benchmarks/false_landmarks.py [--rooms 30] [--first 0]

Simulated rooms with 14 landmarks, one recording of 25 s at 2.5 Hz with wheels and gyro, one landmark known.  In every
recording a code that is mounted nowhere is read:

- ``1 % of all readings``: each reading of a camera is that of any other code, one in a hundred (several false codes),
- ``1 of 1``: in place of a true landmark, in one frame, by one camera or by both,
- ``2 ... 8``: in place of the same landmark, in so many frames by both cameras,
- ``two places``: in place of two landmarks, in one frame each,
- ``look-alike``: a print on a wall that reads as a code in a share of the frames in which it is in view,
- ``second place``: the same, and the code is mounted elsewhere in the room.

A false code is kept out (named, with its reason), not placed (named as well), or it is in the map.  A code with a
second place is "in the map" if its landmark is over 10 cm from where it is mounted, "named" if it is where it is
mounted and the survey says that readings contradict it, and "dropped" if nothing is said.  "Lost" are true landmarks
that the map has without false readings, and lacks with them; "moved" are those that are elsewhere by over 1 cm.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from lmkit.mapping.bundle_adjustment import Anchor
from lmkit.mapping.survey import survey_frames
from lmkit.mapping.survey_results import Survey
from lmkit.model.landmark import LM8
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.recording import RigFrame
from lmkit.odometry.wheel_odometry import MotionModel
from lmkit.simulation.recording import Drive, make_drive

SECONDS, HZ, LANDMARKS, MOVED_M, ELSEWHERE_M = 25.0, 2.5, 14, 0.01, 0.1
Spoil = Callable[[Drive, LandmarkId, LandmarkId, np.random.Generator], list[RigFrame]]  # drive, wrong code, known one


@dataclass(frozen=True)
class Outcome:
    """Fates of the false codes of a recording, and counts of the true landmarks."""

    became: tuple[str, ...]
    lost: int
    moved: int
    landmarks: int


def frames_of(drive: Drive, id_: LandmarkId) -> np.ndarray:
    """Frames in which both cameras see a landmark."""
    return np.flatnonzero([all(any(o.id == id_ for o in seen) for seen in frame.seen) for frame in drive.frames])


def misread(
    frames: Sequence[RigFrame], at: int, true: LandmarkId, wrong: LandmarkId, cameras: Sequence[int]
) -> RigFrame:
    """One frame in which a landmark reads as another code."""
    frame = frames[at]
    seen = tuple(
        tuple(replace(o, id=wrong) if o.id == true and k in cameras else o for o in found)
        for k, found in enumerate(frame.seen)
    )
    return replace(frame, seen=seen)


def misreadings(count: int, places: int = 1, cameras: Sequence[int] = (0, 1)) -> Spoil:
    """In place of so many landmarks, in so many frames each."""

    def spoiled(drive: Drive, wrong: LandmarkId, known: LandmarkId, rng: np.random.Generator) -> list[RigFrame]:
        frames = list(drive.frames)
        often = [m.id for m in drive.landmarks if len(frames_of(drive, m.id)) >= count]
        for which in rng.permutation(len(often))[:places]:
            for at in rng.choice(frames_of(drive, often[which]), count, replace=False):
                frames[at] = misread(frames, at, often[which], wrong, cameras)
        return frames

    return spoiled


def often_seen(drive: Drive, known: LandmarkId) -> list[LandmarkId]:
    return [m.id for m in drive.landmarks if m.id != known and len(frames_of(drive, m.id)) >= 5]


def read_as(
    drive: Drive, print_: LandmarkId, code: LandmarkId, share: float, rng: np.random.Generator
) -> list[RigFrame]:
    """Frames in which a landmark's face reads as a code in a share of them, and in the others not at all."""
    frames = []
    for frame in drive.frames:
        reads = rng.uniform() < share
        kept = tuple(
            tuple(replace(o, id=code) if o.id == print_ else o for o in found if reads or o.id != print_)
            for found in frame.seen
        )
        frames.append(replace(frame, seen=kept))
    return frames


def look_alike(share: float) -> Spoil:
    """A true landmark's place is that of a print which reads as a code in a share of the frames."""

    def spoiled(drive: Drive, wrong: LandmarkId, known: LandmarkId, rng: np.random.Generator) -> list[RigFrame]:
        often = often_seen(drive, known)
        return read_as(drive, often[rng.integers(len(often))], wrong, share, rng)

    return spoiled


def second_place(share: float) -> Spoil:
    """A look-alike of the code of another landmark."""

    def spoiled(drive: Drive, wrong: LandmarkId, known: LandmarkId, rng: np.random.Generator) -> list[RigFrame]:
        often = often_seen(drive, known)
        print_, mounted = (often[k] for k in rng.permutation(len(often))[:2])
        return read_as(drive, print_, mounted, share, rng)

    return spoiled


def at_random(share: float) -> Spoil:
    """Each reading of a camera is that of any other code, in a share of them."""

    def spoiled(drive: Drive, wrong: LandmarkId, known: LandmarkId, rng: np.random.Generator) -> list[RigFrame]:
        codes = np.setdiff1d(np.arange(LM8.code_count), [m.code for m in drive.landmarks])
        frames = []
        for frame in drive.frames:
            seen = tuple(
                tuple(
                    replace(o, id=LandmarkId(LM8.name, int(rng.choice(codes)))) if rng.uniform() < share else o
                    for o in found
                )
                for found in frame.seen
            )
            frames.append(replace(frame, seen=seen))
        return frames

    return spoiled


KINDS: dict[str, Spoil] = {
    "1 % of all readings": at_random(0.01),
    "1 of 1, one camera": misreadings(1, cameras=(0,)),
    "1 of 1, both cameras": misreadings(1),
    "2 frames": misreadings(2),
    "3 frames": misreadings(3),
    "5 frames": misreadings(5),
    "8 frames": misreadings(8),
    "two places": misreadings(1, places=2),
    "look-alike, 5 % of frames": look_alike(0.05),
    "look-alike, 20 % of frames": look_alike(0.2),
    "look-alike, all frames": look_alike(1.0),
    "second place, 5 % of frames": second_place(0.05),
    "second place, 20 % of frames": second_place(0.2),
    "second place, all frames": second_place(1.0),
}


def surveyed(drive: Drive, frames: Sequence[RigFrame], anchor: Anchor) -> Survey:
    sizes = {o.id: anchor.landmark.size_m for frame in frames for o in frame.detections}
    motion = MotionModel(drive.odometry, drive.gyro)
    return survey_frames(frames, drive.rig, sizes, {anchor.landmark.id: anchor}, motion)


def fate(id_: LandmarkId, result: Survey, drive: Drive) -> str:
    """Fate of a false code, or of a code that is read in a false place as well."""
    if id_ in {one.id for one in result.kept_out}:
        return "kept out"
    if id_ in result.unplaced:
        return "not placed"
    found, true = result.landmarks.find(id_), drive.landmarks.find(id_)
    if found is None:
        return "dropped"
    if true is None or np.linalg.norm(found.T_map_landmark.t - true.T_map_landmark.t) > ELSEWHERE_M:
        return "in the map"
    return "named" if id_ in {one.id for one in result.contradicted} else "dropped"


def outcome(drive: Drive, clean: Survey, anchor: Anchor, spoil: Spoil, rng: np.random.Generator) -> Outcome | None:
    """One recording; None where the code was not read in it."""
    mounted = {m.id for m in drive.landmarks}
    wrong = next(
        id_ for id_ in (LandmarkId(LM8.name, int(c)) for c in rng.permutation(LM8.code_count)) if id_ not in mounted
    )
    frames = spoil(drive, wrong, anchor.landmark.id, rng)
    readings = {o.id for frame in frames for o in frame.detections}
    made = {id(o) for frame in drive.frames for o in frame.detections}
    false = sorted({o.id for frame in frames for o in frame.detections if id(o) not in made})
    if not false:
        return None
    result = surveyed(drive, frames, anchor)
    became = tuple(fate(id_, result, drive) for id_ in false)
    # What a look-alike stands for was never read.
    true = [m for m in clean.landmarks if m.id in readings]
    found = {m.id: m.T_map_landmark.t for m in result.landmarks}
    lost = sum(m.id not in found for m in true)
    moved = sum(np.linalg.norm(found[m.id] - m.T_map_landmark.t) > MOVED_M for m in true if m.id in found)
    return Outcome(became, lost, int(moved), len(true))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rooms", type=int, default=30)
    parser.add_argument("--first", type=int, default=0)
    given = parser.parse_args()
    names = ("kept out", "not placed", "named", "dropped", "in the map")
    rows: dict[str, list[Outcome]] = {kind: [] for kind in KINDS}
    for seed in range(given.first, given.first + given.rooms):
        drive = make_drive(seed, seconds=SECONDS, hz=HZ, count=LANDMARKS)
        count = {m.id: len(frames_of(drive, m.id)) for m in drive.landmarks}
        anchor = Anchor(max(drive.landmarks, key=lambda m: count[m.id]), None)
        clean = surveyed(drive, drive.frames, anchor)
        for number, (kind, spoil) in enumerate(KINDS.items()):
            one = outcome(drive, clean, anchor, spoil, np.random.default_rng([seed, 51, number]))
            if one is not None:
                rows[kind].append(one)
    print(f"| false code | recordings | codes | {' | '.join(names)} | true landmarks: lost, moved, of |")
    print("|---|---|---|---|---|---|---|---|---|")
    for kind, all_ in rows.items():
        codes = [name for one in all_ for name in one.became]
        became = " | ".join(str(codes.count(name)) for name in names)
        true = (sum(getattr(one, name) for one in all_) for name in ("lost", "moved", "landmarks"))
        print(f"| {kind} | {len(all_)} | {len(codes)} | {became} | {', '.join(map(str, true))} |")


if __name__ == "__main__":
    main()
