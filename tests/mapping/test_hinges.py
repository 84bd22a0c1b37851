"""A code that is mounted twice and joins two parts of a recording is named."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np

from lmkit.geometry.rig import Rig
from lmkit.mapping.hinges import folds_of, hinges_of
from lmkit.mapping.survey import survey_frames
from lmkit.mapping.survey_results import survey_warnings
from lmkit.model.landmark_id import LandmarkId
from lmkit.odometry.motion_model import BoundedMotion
from lmkit.reports.recording import _survey_headline
from lmkit.simulation.recording import T_BASE_LEFT, make_drive
from lmkit.simulation.scene import make_rig


def test_what_one_landmark_joins_is_named():
    """Ten frames in each of two halls, connected by one landmark (perhaps two with one code), by two, by none."""

    def bundle(shared, jumps=()):
        seen = [(k, 0) for k in range(10)] + [(k, 1) for k in range(10, 20)]
        seen += [(k, 2 + j) for j in range(shared) for k in range(8, 13)]
        frames, of = np.array(seen).T
        ids = tuple(LandmarkId("lm8", 40 + k) for k in range(2 + shared))
        return SimpleNamespace(times_s=np.arange(20) / 2, ids=ids, of=of, frames=frames, jumps=jumps)

    [hinge] = hinges_of(bundle(1))
    assert (hinge.id.code, hinge.frames, hinge.from_s, hinge.to_s) == (42, 10, 0.0, 4.5)
    assert "by lm8:42 alone" in str(hinge)
    assert folds_of(bundle(1)) == hinges_of(bundle(2)) == []
    # Only a jump between the two halls speaks for a fold.
    [fold] = folds_of(bundle(1, ((2.0, 2.5, 0.4), (4.5, 5.0, 3.0))))
    assert fold.jump == (4.5, 5.0, 3.0)
    assert "folded at lm8:42" in str(fold)
    assert folds_of(bundle(1, ((2.0, 2.5, 0.4),))) == folds_of(bundle(2, ((4.5, 5.0, 3.0),))) == []


def one_camera_in_two_rooms(seed):
    """Frames of a robot with one camera in one room, and then in another that shares one code."""
    rig = Rig.of_one(make_rig().left, T_BASE_LEFT)
    first, second = (make_drive(seed + k, seconds=40, hz=3, rig=rig, count=30) for k in (0, 1000))
    shared, other = next(iter(first.landmarks)).id, [m.id for m in second.landmarks]
    free = [LandmarkId("lm8", k) for k in range(250) if first.landmarks.find(LandmarkId("lm8", k)) is None]
    renamed = {id_: free[k] for k, id_ in enumerate(other)} | {other[0]: shared}
    later_s = first.frames[-1].time_s + 0.5
    moved = [
        replace(
            f, time_s=f.time_s + later_s, seen=tuple(tuple(replace(o, id=renamed[o.id]) for o in s) for s in f.seen)
        )
        for f in second.frames
    ]
    sizes = {o.id: 0.18 for f in (*first.frames, *moved) for o in f.detections}
    sizes.update({m.id: m.size_m for m in first.landmarks})
    return rig, [*first.frames, *moved], dict.fromkeys(sizes, sizes[shared]), shared


def test_the_code_at_which_a_map_is_folded_is_named():
    rig, frames, sizes, shared = one_camera_in_two_rooms(3)
    result = survey_frames(frames, rig, sizes, {})
    [fold] = folds_of(result.bundle)
    assert fold.id == shared
    texts = survey_warnings(result, None, (), {})
    assert texts[0] == str(fold)
    assert sum("jumps by" in text for text in texts) == 1
    [many] = [text for text in texts if "standard deviations" in text]
    assert many.startswith(f"{len(result.poorly_determined)} landmarks have standard deviations of up to")
    assert _survey_headline(result, None)[1].startswith(f"The map is probably folded at {shared}")
    # Odometry would hold the two rooms apart: a jump is then a slip.
    assert "folded" not in _survey_headline(result, BoundedMotion(result.bundle.times_s))[1]
