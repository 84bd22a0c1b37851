"""Doubts about a surveyed map: overlapping landmarks, and known places that are not exact."""

import numpy as np
import pytest

from lmkit.geometry.pose import Pose
from lmkit.mapping.map_doubts import exactness_doubts, overlap_doubts
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import MappedLandmark

TURNED = np.diag([-1.0, 1.0, -1.0])  # by half a turn about y: the other side of a wall


def landmark(code, x_m, R=None, sigma_m=None):
    covariance = None if sigma_m is None else np.eye(6) * sigma_m**2
    pose = Pose("map", "landmark", np.eye(3) if R is None else R, np.array([x_m, 0.0, 0.0]))
    return MappedLandmark(LandmarkId("lm8", code), 0.18, pose, covariance)


def test_a_misread_landmark_overlaps_the_true_one():
    (text,) = overlap_doubts([landmark(231, 0.0), landmark(167, 0.07)])
    assert text.startswith("lm8:167 and lm8:231 overlap, 70 mm from center to center")


@pytest.mark.parametrize("other", [landmark(2, 0.2), landmark(2, 0.05, TURNED)], ids=["beside it", "behind the wall"])
def test_neighbors_do_not_overlap(other):
    assert overlap_doubts([landmark(1, 0.0), other]) == []


@pytest.mark.parametrize(("wrong", "sigma_m", "doubts"), [(3, None, 1), (3, 0.0, 1), (2, None, 0), (3, 0.05, 0)])
def test_many_contradicted_exact_landmarks_were_measured_badly(wrong, sigma_m, doubts):
    known = [landmark(code, float(code), sigma_m=sigma_m) for code in range(5)]
    texts = exactness_doubts(known, [m.id for m in known[:wrong]])
    assert len(texts) == doubts
    assert all("3 of 5 known landmarks" in text and "--known-sigma" in text for text in texts)
