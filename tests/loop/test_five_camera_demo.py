"""`lmkit demo --rig`: poses of five cameras without a common view are found by driving; then the robot is tracked."""

from __future__ import annotations

import numpy as np
import pytest

from lmkit.demos import five_cameras
from lmkit.io.any_rig import read_any_rig


def test_no_point_far_away_is_seen_by_two_cameras():
    rig = five_cameras.ring_of_cameras(np.random.default_rng(3))
    around = np.linspace(0, 2 * np.pi, 720, endpoint=False)
    for height in (-20.0, 0.0, 20.0):
        points = np.column_stack([100 * np.cos(around), 100 * np.sin(around), np.full(720, height)])
        in_left = rig.T_base_left.inverse().apply(points)
        seen = np.zeros(720, dtype=int)
        for camera in rig.cameras:
            there = camera.T_camera_left.apply(in_left)
            before = there[:, 2] > 0.3 * np.linalg.norm(there, axis=1)
            pixels = camera.model.project(np.where(before[:, None], there, [0, 0, 1.0]))
            seen += before & camera.model.contains(pixels, 0)
        assert seen.max() == 1


@pytest.mark.slow
def test_the_demo_places_cameras_and_tracks(tmp_path, monkeypatch):
    monkeypatch.setattr(five_cameras, "TRACK_S", 6.0)
    result = five_cameras.run_rig_demo(tmp_path, 7, 14)
    assert [camera.name for camera in result.cameras] == list(five_cameras.NAMES)
    assert max(camera.turn_deg for camera in result.cameras) < 0.3
    assert max(camera.place_mm for camera in result.cameras) < 10
    assert result.track_mm < 20
    assert result.located > 0.7 * result.frames
    rig = read_any_rig(tmp_path / "rig.yaml")
    assert [camera.name for camera in rig.cameras] == list(five_cameras.NAMES)
    assert (tmp_path / "plan.png").stat().st_size > 10_000
    assert len(result.table) == 9
