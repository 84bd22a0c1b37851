"""Landmarks are placed as one by one, however many are placed at once."""

import numpy as np
import pytest

from lmkit.mapping import landmark_initialization
from lmkit.mapping.initialization import find_start
from lmkit.simulation.recording import make_drive


@pytest.mark.parametrize("at_once", [1, 4])
def test_landmarks_are_placed_alike_however_many_at_once(at_once, monkeypatch):
    drive = make_drive(4, seconds=40, hz=2, count=14)
    sizes = {m.id: m.size_m for m in drive.landmarks}
    placed = find_start(drive.frames, drive.rig, sizes, {}).placed
    calls = []
    mean_chi2 = landmark_initialization.Placing._mean_chi2

    def counted(self, candidates, columns, floor_px):
        calls.append(len(candidates))
        return mean_chi2(self, candidates, columns, floor_px)

    monkeypatch.setattr(landmark_initialization, "AT_ONCE", at_once)
    monkeypatch.setattr(landmark_initialization.Placing, "_mean_chi2", counted)
    again = find_start(drive.frames, drive.rig, sizes, {}).placed
    assert max(calls) == at_once
    assert list(again) == list(placed)
    assert len(placed) > 4
    assert all(np.array_equal(again[k].corners_map, placed[k].corners_map) for k in placed)
