"""The most informative next view of an uncertain landmark, and whether it is informative."""

from dataclasses import replace

import numpy as np

from lmkit.geometry.pose import Pose
from lmkit.mapping.bundle_adjustment import Anchor
from lmkit.mapping.next_view import _clear, next_view
from lmkit.mapping.survey import survey_frames
from lmkit.mapping.survey_results import deviations
from lmkit.model.recording import RigFrame
from lmkit.simulation.observations import look
from lmkit.simulation.recording import make_drive


def codes_seen(drive):
    return list(dict.fromkeys(o.id for frame in drive.frames for o in frame.seen[0]))


def survey(drive, frames):
    sizes = {m.id: m.size_m for m in drive.landmarks}
    anchors = {code: Anchor(drive.landmarks.find(code), None) for code in codes_seen(drive)[:6]}
    # A landmark without most of its views looks like one that is rarely read.
    return survey_frames(frames, drive.rig, sizes, anchors, keep_doubtful=True)


def with_few_far_views_of(drive, code):
    """The recording, with only the two smallest views of a landmark."""
    sides = {}
    for k, frame in enumerate(drive.frames):
        for o in frame.seen[0]:
            if o.id == code:
                sides[k] = np.linalg.norm(o.corners[0] - o.corners[1])
    kept = sorted(sides, key=sides.get)[:2]

    def without(seen, k):
        return seen if k in kept else tuple(o for o in seen if o.id != code)

    return [replace(m, seen=tuple(without(some, k) for some in m.seen)) for k, m in enumerate(drive.frames)]


def test_the_view_that_is_proposed_does_what_it_promises():
    promised, kept = [], []
    for seed in (2, 3):
        drive = make_drive(seed, seconds=30)
        code = codes_seen(drive)[6]
        frames = with_few_far_views_of(drive, code)
        before = survey(drive, frames)
        uncertain = before.bundle.landmarks.find(code)
        view = next_view(uncertain, before.bundle, drive.rig)
        assert view is not None
        assert view.then_m < 0.7 * view.place_m or view.then_rad < 0.7 * view.turn_rad
        # Taken as proposed, with the landmarks that it states as in view.
        rig, T = replace(drive.rig, T_base_left=Pose.identity("base", "left")), view.T_map_left
        rng = np.random.default_rng(seed)
        while True:
            left, right = look(drive.landmarks, rig, Pose("map", "base", T.R, T.t), None, rng)
            if {o.id for o in left} >= {code, *view.beside}:
                break
        time = drive.frames[-1].time_s + 100.0
        after = survey(drive, [*frames, RigFrame(time, (left, right))])
        place, turn = deviations(after.bundle.landmarks.find(code))
        promised.append(view.then_m + view.then_rad)
        kept.append(place + turn)
    assert 0.6 < np.mean(kept) / np.mean(promised) < 1.6


def test_no_view_is_proposed_where_the_whole_map_errs_alike():
    drive = make_drive(1, seconds=30)
    bundle = survey(drive, drive.frames).bundle
    code = next(iter(bundle.landmarks)).id
    count = len(bundle.landmarks)
    # All landmarks are off by the same 0.1 m, and by little else.
    common = np.kron(np.ones((count, count)), np.diag([0.01, 0.01, 0.01, 0, 0, 0])) + 1e-8 * np.eye(6 * count)
    mapped = [replace(m, covariance=common[:6, :6]) for m in bundle.landmarks]
    alike = replace(bundle, landmarks=type(bundle.landmarks)(mapped), joint=common)
    assert next_view(alike.landmarks.find(code), alike, drive.rig) is None


def test_a_landmark_between_hides_those_behind_its_wall():
    # Camera at the origin; a wall across x at 1 m with a landmark, two behind it, one of those far aside.
    places = np.array([[1.0, 0.0], [2.0, 0.1], [2.0, 3.0]])
    along = np.array([[0.0, 1.0], [0.0, 1.0], [0.0, 1.0]])
    assert _clear(np.zeros(2), places, along).tolist() == [True, False, True]
