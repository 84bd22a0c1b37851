"""Cameras that contradict each other, readings that contradict the map: the cause is named; valid input has none."""

from __future__ import annotations

import re
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from ids import lm8

import lmkit
from lmkit.errors import InputError
from lmkit.geometry.pose import Pose
from lmkit.geometry.rectification import rectification, rectified_rig
from lmkit.geometry.rig import as_stereo
from lmkit.geometry.rig_plausibility import rig_warnings
from lmkit.localization.range_bearing_noise import ReadingNoise
from lmkit.localization.readings_contradiction import find_readings_cause
from lmkit.localization.rig_contradiction import find_rig_cause
from lmkit.model.landmark_map import LandmarkMap, MappedLandmark, wall_pose
from lmkit.model.observation import RangeBearing
from lmkit.model.recording import Odometry, Recording, RigFrame
from lmkit.simulation.recording import make_drive


@pytest.fixture(scope="module")
def drive():
    return make_drive(3, seconds=12.0, size_m=(8.0, 5.0))


def with_extrinsics(rig, R, t):
    return replace(rig, T_right_left=Pose("right", "left", R, t))


def rectified(frames, rig):
    """Frames as the cameras would see them in rectified images."""
    maps, flat = rectification(rig), rectified_rig(rig)
    sides = ((rig.left, maps.R_left, flat.left), (rig.right, maps.R_right, flat.right))

    def moved(d, camera, R, new):
        points = np.column_stack([camera.unproject(d.corners), np.ones(4)]) @ R.T
        return replace(d, corners=new.project(points), covariance=None)

    def both(frame):
        return tuple(tuple(moved(d, *side) for d in seen) for seen, side in zip(frame.seen, sides, strict=True))

    return [RigFrame(f.time_s, both(f)) for f in frames]


def shifted(frames):
    return [RigFrame(a.time_s, (a.seen[0], b.seen[1])) for a, b in pairwise(frames)]


CAUSES = {
    "": lambda f, r: (f, r),
    "swapped_cameras": lambda f, r: ([replace(one, seen=one.seen[::-1]) for one in f], r),
    "rig_inverted": lambda f, r: (f, with_extrinsics(r, r.T_right_left.R.T, -r.T_right_left.R.T @ r.T_right_left.t)),
    "rig_units": lambda f, r: (f, with_extrinsics(r, r.T_right_left.R, 10 * r.T_right_left.t)),
    "rectified_images": lambda f, r: (rectified(f, r), r),
    "rectified_rig": lambda f, r: (f, rectified_rig(r)),
    "shifted_pairs": lambda f, r: (shifted(f), r),
}


@pytest.mark.parametrize("code", CAUSES)
def test_why_two_cameras_contradict_each_other(drive, code):
    frames, rig = CAUSES[code](list(drive.frames), as_stereo(drive.rig, "a test"))
    cause = find_rig_cause(frames, rig, {m.id: m.size_m for m in drive.landmarks})
    assert (cause.code if cause else "") == code


@pytest.mark.parametrize("stated", [0.05, 0.1, 0.018])
def test_landmarks_of_another_size_than_stated_are_no_rectified_images(drive, stated):
    cause = find_rig_cause(drive.frames, drive.rig, {m.id: stated for m in drive.landmarks})
    assert cause.code == "rig_units"
    sizes = re.search(r"landmarks of (\d+) mm measure (\d+) mm", cause.text)
    assert [float(number) for number in sizes.groups()] == pytest.approx([1000 * stated, 180.0], rel=0.02)


@pytest.mark.parametrize("work", ["track", "survey"])
def test_a_recording_whose_cameras_contradict_each_other_is_refused(drive, work):
    frames, rig = CAUSES["rectified_images"](list(drive.frames), as_stereo(drive.rig, "a test"))
    recording = Recording(tuple(frames))
    with pytest.raises(InputError, match="rectified") as caught:
        lmkit.track(recording, rig, drive.landmarks) if work == "track" else lmkit.survey(recording, rig)
    assert caught.value.code == "rectified_images"


def test_unusual_rigs_are_named_in_results(drive):
    rig = as_stereo(drive.rig, "a test")
    inverse = Pose("base", "left", rig.T_base_left.R.T, -rig.T_base_left.R.T @ rig.T_base_left.t)
    wrong = {"its inverse": inverse, "optical": Pose("base", "left", np.eye(3), rig.T_base_left.t)}
    assert rig_warnings(rig, "the rig") == ()
    recording = Recording(drive.frames[:5])
    for word, T in wrong.items():
        tracked = lmkit.track(recording, replace(rig, T_base_left=T), drive.landmarks)
        assert word in tracked.to_dict(0)["warnings"][0]
    half = replace(rig.left, K=rig.left.K * np.array([[0.5, 1, 0.5], [1, 0.5, 0.5], [1, 1, 1]]))
    assert "image size" in rig_warnings(replace(rig, left=half), "the rig")[0]
    far = replace(rig, T_base_left=Pose("base", "left", rig.T_base_left.R, 1000 * rig.T_base_left.t))
    with pytest.raises(InputError, match="millimeters"):
        lmkit.track(recording, far, drive.landmarks)


PLACES = [(0.0, 0.0), (6.0, 0.5), (5.5, 4.0), (0.5, 4.5), (3.0, -1.0)]


def ring() -> tuple[LandmarkMap, list[list[RangeBearing]]]:
    """Landmarks all around, and readings of all of them from four poses."""
    landmarks = LandmarkMap([MappedLandmark(lm8(k), 0.18, wall_pose([*p, 1.0], 0.0)) for k, p in enumerate(PLACES)])
    frames = []
    for x, y, heading in ((2.0, 1.0, 0.3), (2.5, 1.4, 0.5), (3.0, 2.5, -1.0), (3.2, 2.0, 2.0)):
        off = np.array(PLACES) - (x, y)
        bearings = (np.arctan2(off[:, 1], off[:, 0]) - heading + np.pi) % (2 * np.pi) - np.pi
        frames.append([RangeBearing(lm8(k), float(np.hypot(*off[k])), float(bearings[k])) for k in range(len(off))])
    return landmarks, frames


@pytest.mark.parametrize(
    ("code", "ranges", "bearings", "places", "word"),
    [
        ("", 1, 1, 1, ""),
        ("bearing_sign", 1, -1, 1, "other sign"),
        ("bearing_unit", 1, np.rad2deg(1), 1, "degrees"),
        ("range_unit", 100, 1, 1, "centimeters"),
        ("range_unit", 1, 1, 1000, "millimeters"),
        ("another_map", 1, 1, 0, "another place"),
    ],
)
def test_why_readings_contradict_the_map(code, ranges, bearings, places, word):
    landmarks, frames = ring()
    changed = [
        [replace(r, range_m=ranges * r.range_m, bearing_rad=bearings * r.bearing_rad) for r in f] for f in frames
    ]
    moved = [m.T_map_landmark.t * places for m in landmarks]
    if not places:
        moved = [np.array([x, y, 1.0]) for x, y in [*PLACES[2:], *PLACES[:2]]]
    elsewhere = LandmarkMap(
        [replace(m, T_map_landmark=replace(m.T_map_landmark, t=t)) for m, t in zip(landmarks, moved, strict=True)]
    )
    cause = find_readings_cause(changed, elsewhere, ReadingNoise())
    assert (cause.code if cause else "") == code
    assert word in str(cause)


def wall_readings(sign: float, count: int) -> tuple[LandmarkMap, list[list[RangeBearing]]]:
    """Landmarks of one wall, which face +y, and readings from four poses in front of it."""
    landmarks = LandmarkMap([MappedLandmark(lm8(k), 0.18, wall_pose([k, 0.0, 1.0], np.pi / 2)) for k in range(count)])
    frames = []
    for x, y, heading in ((0.5, 2.0, -1.5), (1.0, 2.5, -1.2), (2.0, 1.5, -1.8), (2.5, 3.0, -1.0)):
        off = np.array([m.T_map_landmark.t[:2] for m in landmarks]) - (x, y)
        bearings = (np.arctan2(off[:, 1], off[:, 0]) - heading + np.pi) % (2 * np.pi) - np.pi
        values = zip(np.linalg.norm(off, axis=1).tolist(), (sign * bearings).tolist(), strict=True)
        frames.append([RangeBearing(lm8(k), *pair) for k, pair in enumerate(values)])
    return landmarks, frames


@pytest.mark.parametrize("count", [3, 5])
def test_mirrored_bearings_to_one_wall_are_not_a_place_behind_it(count):
    """Both places explain all readings; a landmark is read from its front."""
    landmarks, frames = wall_readings(1.0, count)
    assert find_readings_cause(frames, landmarks, ReadingNoise()) is None
    landmarks, frames = wall_readings(-1.0, count)
    cause = find_readings_cause(frames, landmarks, ReadingNoise())
    assert cause is not None
    assert cause.code == "bearing_sign"


def test_mirrored_bearings_to_three_landmarks_are_named():
    """A pose explains any two of them."""
    landmarks, frames = ring()
    three = [[replace(r, bearing_rad=-r.bearing_rad) for r in seen[:3]] for seen in frames]
    cause = find_readings_cause(three, landmarks, ReadingNoise())
    assert cause is not None
    assert cause.code == "bearing_sign"


def test_one_moved_landmark_of_three_has_no_common_cause():
    landmarks, frames = ring()
    three = [seen[:3] for seen in frames]
    first, second, *rest = landmarks
    T = replace(second.T_map_landmark, t=second.T_map_landmark.t + np.array([0.7, 0.4, 0.0]))
    moved = LandmarkMap([first, replace(second, T_map_landmark=T), *rest])
    assert find_readings_cause(three, moved, ReadingNoise()) is None


def test_track_refuses_mirrored_bearings():
    landmarks, frames = wall_readings(-1.0, 4)
    readings = tuple((float(k), tuple(replace(r, time_s=float(k)) for r in seen)) for k, seen in enumerate(frames))
    odometry = Odometry.from_velocities(np.arange(5.0), np.full(5, 0.7), np.zeros(5))
    with pytest.raises(InputError, match="bearings have the other sign"):
        lmkit.track(Recording(readings=readings, odometry=odometry), None, landmarks)


def test_locate_names_why_readings_contradict_the_map(lmkit, tmp_path):
    from lmkit.io.landmark_map import map_to_yaml

    landmarks, frames = ring()
    rows = [f"{k},{r.id.code},{r.range_m},{-r.bearing_rad}" for k, seen in enumerate(frames) for r in seen]
    (tmp_path / "readings.csv").write_text("\n".join(["time_s,code,range_m,bearing_rad", *rows]))
    (tmp_path / "map.yaml").write_text(map_to_yaml(landmarks))
    answer = lmkit("locate", "--readings", "readings.csv", "--map", "map.yaml")
    assert "bearings have the other sign" in answer.err
