"""Which frames of videos of a board are kept: the still ones that show a camera a new view."""

from __future__ import annotations

import numpy as np
import pytest
from board_views import BOARD

from lmkit.io.image_sources import Frame
from lmkit.model.observation import BoardObservation
from lmkit.pipelines import camera_views
from lmkit.pipelines.camera_views import find_board_videos
from lmkit.pipelines.still_frames import still_frames
from lmkit.simulation.scene import board_poses, make_rig

RATE, HELD, ON_ITS_WAY = 20, 12, 8  # frames a second; frames at one place, and between two places


def frames(counts):
    """Three cameras' frames: pixel (0, 0) holds the frame's number and the camera."""
    for k in range(counts):
        images = []
        for camera in range(3):
            image = np.zeros((48, 64, 3), dtype=np.uint8)
            # Brightness changes while the board is on its way.
            place, part = divmod(k, HELD + ON_ITS_WAY)
            image[:] = (20 * place + 10 * max(0, part - HELD + 1)) % 200
            image[0, 0] = k // 250, k % 250, camera
            images.append(image)
        yield tuple(Frame(f"{c}.mp4#{k}", image, None, k / RATE) for c, image in zip("abc", images, strict=True))


@pytest.fixture
def films(monkeypatch):
    """Six places of a board before three cameras; the last camera sees it at the places 0, 1, 2 and 5 alone.

    At place 5 the others see the same as at place 4.
    """
    rig = make_rig()
    poses = board_poses(3, rig, BOARD, 6)

    def detect(image, board):
        high, low, camera = (int(value) for value in image[0, 0])
        place, part = divmod(250 * high + low, HELD + ON_ITS_WAY)
        if camera == 2 and place in (3, 4):
            return None
        place = 4 if place == 5 and camera < 2 else place
        aside = np.array([0.01 * max(0, part - HELD + 1) + 0.02 * camera, 0, 0])
        points = poses[place].apply(BOARD.object_points) + aside
        return BoardObservation(np.arange(len(points)), rig.left.project(points) / 10, 0.05)

    monkeypatch.setattr(camera_views, "detect_board", detect)
    monkeypatch.setattr(camera_views, "checked_board", lambda images, board: board)
    monkeypatch.setattr(camera_views, "frame_count", lambda sources: 0)
    monkeypatch.setattr(camera_views, "frame_groups", lambda sources: frames(6 * (HELD + ON_ITS_WAY)))


def test_still_and_new_frames_are_kept_under_one_name_for_all_cameras(films):
    found = find_board_videos(["a.mp4", "b.mp4", "c.mp4"], BOARD)
    names = [[name for name, _ in camera.views] for camera in found]
    kept = [int(name.removeprefix("frame ")) for name in names[0]]
    assert [number // (HELD + ON_ITS_WAY) for number in kept] == list(range(6))
    assert all(0 < number % (HELD + ON_ITS_WAY) < HELD for number in kept)  # held still, and so was the frame before
    assert names[0] == names[1]
    assert names[2] == [names[0][place] for place in (0, 1, 2, 5)]
    assert [camera.image_size for camera in found] == [(64, 48)] * 3


def test_a_fifth_of_a_second_gives_its_stillest_frame():
    looks = list(still_frames(frames(HELD + ON_ITS_WAY)))
    assert len(looks) == (HELD + ON_ITS_WAY) * 5 // RATE
    assert all(look.before is not None and look.before[0].name == f"a.mp4#{look.number - 1}" for look in looks)


def test_without_times_every_frame_is_looked_at():
    alone = [tuple(Frame(f.name, f.image) for f in group) for group in frames(7)]
    assert [look.number for look in still_frames(alone)] == list(range(7))
