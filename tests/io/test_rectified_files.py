"""`lmkit rectify` writes the calibration of the images that it writes."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from command_line import run_command

from lmkit.geometry.rectification import rectification
from lmkit.geometry.rig import as_stereo
from lmkit.io.any_rig import read_any_rig
from lmkit.io.rig import rig_to_yaml
from lmkit.simulation.scene import make_rig


def test_the_written_calibration_is_that_of_rectified_images(tmp_path: Path) -> None:
    rig = make_rig()
    width, height = rig.left.image_size
    for side in ("left", "right"):
        (tmp_path / side).mkdir()
        cv2.imwrite(str(tmp_path / side / "0.png"), np.full((height, width, 3), 128, dtype=np.uint8))
    (tmp_path / "rig.yaml").write_text(rig_to_yaml(rig))
    flat = tmp_path / "flat"
    command = ("rectify", tmp_path / "left", tmp_path / "right", "--rig", tmp_path / "rig.yaml", "-o", flat)
    answer = run_command(*command)
    assert answer.code == 0, answer.err
    assert len(list(flat.glob("*.png"))) == 2
    expected = rectification(rig)
    for written in ("rig.yaml", "opencv.yml", "camera_info"):
        maps = rectification(as_stereo(read_any_rig(flat / written), "the test"))
        np.testing.assert_allclose(maps.R_left, np.eye(3), atol=1e-9)
        np.testing.assert_allclose(maps.P_left, expected.P_left, atol=1e-6)
        np.testing.assert_allclose(maps.P_right, expected.P_right, atol=1e-6)
        np.testing.assert_allclose(maps.Q, expected.Q, atol=1e-6)
    assert run_command(*command).code == 2
