"""Landmarks that were moved between recordings: found, and others named wrongly.

    uv run python benchmarks/moved_landmarks.py [--rooms 20]

Three simulated recordings of 25 s of one room with 14 landmarks.  Before the third recording one landmark, which at
least two of the recordings see often, is moved along its wall or rotated; or none is.
"""

from __future__ import annotations

import argparse
from collections import Counter
from dataclasses import replace

import numpy as np

from lmkit.geometry.pose import Pose
from lmkit.geometry.rotations import rotation_exp
from lmkit.mapping.bundle_adjustment import Anchor
from lmkit.mapping.several_recordings import NamedRecording, survey_recordings
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import LandmarkMap
from lmkit.model.recording import Odometry
from lmkit.odometry.wheel_odometry import MotionModel
from lmkit.simulation.recording import Drive, make_drive

DAY_S = 86400.0
CASES = ((0.0, 0.0), (0.05, 0.0), (0.1, 0.0), (0.2, 0.0), (0.5, 0.0), (0.0, 20.0))


def recording(made: Drive, day: int) -> NamedRecording:
    """One day's recording."""
    frames = tuple(replace(frame, time_s=frame.time_s + day * DAY_S) for frame in made.frames)
    o = made.odometry
    motion = MotionModel(Odometry(o.times_s + day * DAY_S, o.forward_m, o.turn_rad))
    return NamedRecording(f"day {day}", frames, made.rig, motion)


def moved(landmarks: LandmarkMap, chosen: LandmarkId, meters: float, degrees: float) -> LandmarkMap:
    """The room with one landmark elsewhere."""
    changed = []
    for m in landmarks:
        T = m.T_map_landmark
        if m.id == chosen:
            turn = rotation_exp(np.array([[0.0, 0.0, np.deg2rad(degrees)]]))[0]
            T = Pose("map", "landmark", turn @ T.R, T.t + meters * T.R[:, 0])
        changed.append(replace(m, T_map_landmark=T))
    return LandmarkMap(changed)


def seen_in(made: Drive) -> Counter[LandmarkId]:
    """Number of frames of each landmark."""
    return Counter(id_ for frame in made.frames for id_ in {o.id for o in frame.detections})


def trial(seed: int, meters: float, degrees: float) -> tuple[bool, int, float]:
    """Was the landmark named, how many others were, and the map's largest error (m)."""
    room, rng = make_drive(seed, seconds=2).landmarks, np.random.default_rng(seed)
    first = [make_drive(100 * seed + k, seconds=25, landmarks=room) for k in range(2)]
    last, both = seen_in(make_drive(100 * seed + 2, seconds=25, landmarks=room)), [seen_in(one) for one in first]
    order = sorted(last, key=lambda id_: -min(last[id_], max(count[id_] for count in both)))
    chosen = order[int(rng.integers(0, 3))]
    later = moved(room, chosen, meters, degrees)
    made = [*first, make_drive(100 * seed + 2, seconds=25, landmarks=later)]
    anchor = next(m for m in room if m.id != chosen)
    result = survey_recordings(
        [recording(one, day) for day, one in enumerate(made)],
        {m.id: m.size_m for m in room},
        {anchor.id: Anchor(anchor, None)},
    )
    named = {one.before.id for one in result.moved}
    truth = {m.id: m.T_map_landmark.t for m in later}
    error = max(float(np.linalg.norm(m.T_map_landmark.t - truth[m.id])) for m in result.landmarks)
    return chosen in named, len(named - {chosen}), error


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rooms", type=int, default=20)
    rooms = parser.parse_args().rooms
    print("| moved by | rooms | found | rooms in which another was named | largest error, median / maximum |")
    print("|---|---|---|---|---|")
    for meters, degrees in CASES:
        rows = [trial(seed, meters, degrees) for seed in range(rooms)]
        errors = 1000 * np.array([error for _, _, error in rows])
        what = f"{100 * meters:g} cm" if meters else f"{degrees:g} deg" if degrees else "not at all"
        found = sum(found for found, _, _ in rows) if meters or degrees else "-"
        wrong = sum(others > 0 for _, others, _ in rows)
        print(
            f"| {what} | {rooms} | {found} | {wrong} | {np.median(errors):.0f} / {errors.max():.0f} mm |", flush=True
        )


if __name__ == "__main__":
    main()
