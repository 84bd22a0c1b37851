"""History of a map that is surveyed again from an earlier one."""

import numpy as np

from lmkit.geometry.pose import Pose
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import LandmarkMap, MappedLandmark


def mounted(code, x, valid_from_s=None, valid_to_s=None):
    T = Pose("map", "landmark", np.eye(3), np.array([x, 0.0, 1.0]))
    return MappedLandmark(LandmarkId("lm8", code), 0.18, T, valid_from_s=valid_from_s, valid_to_s=valid_to_s)


def test_a_map_keeps_the_moves_of_the_one_it_was_surveyed_from():
    earlier = LandmarkMap([mounted(1, 2.0, 20.0), mounted(1, 1.0, None, 10.0), mounted(2, 5.0)])
    again = LandmarkMap([mounted(1, 2.1), mounted(2, 7.0, 40.0), mounted(2, 5.0, None, 30.0), mounted(3, 9.0)])
    kept = again.with_history_of(earlier)
    assert [(m.id.code, m.T_map_landmark.t[0], m.valid_from_s) for m in kept] == [
        (1, 2.1, 20.0),
        (2, 7.0, 40.0),
        (3, 9.0, None),
    ]
    assert [(m.id.code, m.valid_to_s) for m in kept.past] == [(1, 10.0), (2, 30.0)]
    assert kept.at(5.0).find(LandmarkId("lm8", 1)).T_map_landmark.t[0] == 1.0


def test_a_landmark_that_was_moved_twice_keeps_all_three_places():
    earlier = LandmarkMap([mounted(1, 2.0, 20.0), mounted(1, 1.0, None, 10.0)])
    again = LandmarkMap([mounted(1, 3.0, 40.0), mounted(1, 2.0, None, 30.0)])
    kept = again.with_history_of(earlier)
    assert [(m.valid_from_s, m.valid_to_s) for m in kept.past] == [(None, 10.0), (20.0, 30.0)]
    places = [kept.at(time_s).find("lm8:1").T_map_landmark.t[0] for time_s in (5.0, 25.0, 50.0)]
    assert places == [1.0, 2.0, 3.0]
