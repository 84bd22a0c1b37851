"""Cameras that take images and read them."""

from dataclasses import replace

import numpy as np
import pytest

from lmkit.geometry.pose import Pose
from lmkit.model.landmark import LM8
from lmkit.pipelines.rendered_cameras import RenderedCameras
from lmkit.simulation.observations import look
from lmkit.simulation.scene import make_rig, make_room


def standing_before(landmark, distance_m):
    """T_map_base of cameras that look straight at a landmark, in a frame x ahead, z up."""
    T = landmark.T_map_landmark
    ahead, up = -T.R[:, 2], np.array([0.0, 0.0, 1.0])
    R = np.column_stack([ahead, np.cross(up, ahead), up])
    return Pose("map", "base", R, T.t - distance_m * ahead)


@pytest.mark.slow
def test_rendered_cameras_see_the_landmarks_of_the_scene():
    scene = make_room(3, LM8, count=6)
    ahead = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])
    rig = replace(make_rig(), T_base_left=Pose("base", "left", ahead, np.zeros(3)))
    landmark = next(iter(scene.landmarks))
    T = standing_before(landmark, 1.2)
    see = RenderedCameras(scene, rig, 1, every_s=0.6)
    exact = look(scene.landmarks, rig, T, None, np.random.default_rng(0))
    for seen, true in zip(see(10.0, T), exact, strict=True):
        found = next(o for o in seen if o.code == landmark.code)
        corners = next(o for o in true if o.code == landmark.code).corners
        assert 0 < np.abs(found.corners - corners).max() < 0.5
    # Between two images there is no new image; after the pause there is one.
    assert see(10.2, T) == ((), ())
    assert [o.code for o in see(10.6, T)[0]] == [o.code for o in exact[0]]
