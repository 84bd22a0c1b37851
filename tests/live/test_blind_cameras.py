"""A camera that reads nothing although landmarks are clearly in view is named, and named again when it reads."""

import numpy as np

from lmkit.live.blind_cameras import BlindCameras
from lmkit.live.state import CameraView
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.observation import Detection

ID = LandmarkId("lm8", 137)
READS = (Detection(ID, np.zeros((4, 2)), 1.0, 1.0),)


def codes(steps):
    watch, found = BlindCameras(["left", "right"]), []
    for time_s, reads, plain in steps:
        views = [CameraView(n, None, time_s, READS if r else ()) for n, r in (("left", reads), ("right", True))]
        views = [v if v.detections else CameraView("left", None, time_s, (), search="near") for v in views]
        found += [(e.code, time_s) for e in watch.add(time_s, views, [(ID,) if plain else (), ()])]
    return found


def test_a_covered_lens_is_named_once_and_named_again_when_it_reads():
    steps = [(k / 4, k >= 20, True) for k in range(24)]
    assert codes(steps) == [("camera_blind", 2.0), ("camera_sees", 5.0)]


def test_a_camera_that_has_nothing_in_view_is_not_named():
    assert codes([(k / 4, False, False) for k in range(40)]) == []


def test_a_single_landmark_read_starts_the_count_anew():
    assert codes([(k / 4, k % 7 == 6, True) for k in range(40)]) == []
