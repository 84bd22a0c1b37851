"""Recordings for the Rerun viewer, read back by Rerun."""

import re
import subprocess
import sys

import numpy as np
import pytest

from lmkit.errors import InputError
from lmkit.mapping.bundle_adjustment import Anchor
from lmkit.mapping.survey import survey_frames
from lmkit.odometry.wheel_odometry import MotionModel
from lmkit.reports.rerun import require_rerun, survey_recording, track_recording
from lmkit.simulation.recording import make_drive
from lmkit.tracking.batch import track_images


def entities(path):
    """Names of what a recording holds, as Rerun's own reader lists them."""
    reader = [sys.executable, "-m", "rerun", "rrd", "print", str(path)]
    done = subprocess.run(reader, capture_output=True, text=True, check=True)
    return set(re.findall(r"(?<= )/[a-z_/]+", done.stdout))


def test_a_tracked_drive_and_a_survey_are_recorded(tmp_path):
    pytest.importorskip("rerun", reason="the extra viewer is not installed")
    drive = make_drive(1, seconds=8)
    motion = MotionModel(drive.odometry, drive.gyro)
    tracked = track_images(drive.frames, drive.rig, drive.landmarks, motion)
    path = tmp_path / "t.rrd"
    path.write_bytes(track_recording(tracked, drive.landmarks, drive.rig, drive.frames))
    assert entities(path) >= {
        "/map/landmarks",
        "/map/robot",
        "/map/trajectory",
        "/map/cameras/left/read",
        "/innovation",
    }
    first = drive.landmarks.find(drive.frames[0].seen[0][0].id)
    sizes = {m.id: m.size_m for m in drive.landmarks}
    survey = survey_frames(drive.frames, drive.rig, sizes, {first.id: Anchor(first, None)}, motion)
    assert np.isfinite(survey.bundle.rms_px)
    path.write_bytes(survey_recording(survey, drive.rig, drive.frames))
    assert entities(path) >= {"/map/landmarks", "/map/cameras/right", "/residual", "/sigma/position_mm"}


def test_without_the_package_its_extra_is_named(monkeypatch):
    monkeypatch.setattr("lmkit.reports.rerun.find_spec", lambda name: None)
    with pytest.raises(InputError) as raised:
        require_rerun()
    assert "--extra viewer" in raised.value.hint
