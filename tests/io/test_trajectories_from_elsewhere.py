"""Trajectories without times (KITTI), and on another clock."""

from __future__ import annotations

import json

import numpy as np
import pytest
from command_line import run_command
from scipy.spatial.transform import Rotation

ROTATIONS = Rotation.from_rotvec(np.linspace((0, 0, 0), (0.3, -0.2, 1.0), 12))
PLACES = np.linspace((0, 0, 0), (3, 1, 0.5), 12) ** 2


def tum(path, shift_s=0.0):
    rows = np.column_stack([np.arange(12) / 10 + shift_s, PLACES, ROTATIONS.as_quat()])
    path.write_text("\n".join(" ".join(f"{v:.9f}" for v in row) for row in rows))
    return path


def kitti(path, count=12):
    rows = np.concatenate([ROTATIONS.as_matrix(), PLACES[:, :, None]], axis=2).reshape(12, 12)[:count]
    path.write_text("\n".join(" ".join(f"{v:.6e}" for v in row) for row in rows))
    return path


def evaluate(*arguments):
    done = run_command("evaluate", *arguments, "--json")
    return json.loads(done.out) if done.code == 0 else done.err


def test_kitti_poses_are_compared_row_by_row(tmp_path):
    found = evaluate(kitti(tmp_path / "a.txt"), kitti(tmp_path / "b.txt"))
    assert found["pairs"] == 12
    assert found["position_m"]["max"] == pytest.approx(0, abs=1e-9)
    lines = (tmp_path / "b.txt").read_text().splitlines()
    moved = lines[3].split()
    moved[3] = str(float(moved[3]) + 0.25)
    (tmp_path / "b.txt").write_text("\n".join([*lines[:3], " ".join(moved), *lines[4:]]))
    assert evaluate(tmp_path / "a.txt", tmp_path / "b.txt")["position_m"]["max"] == pytest.approx(0.25, abs=1e-5)


def test_times_are_not_invented_for_kitti_poses(tmp_path):
    assert "KITTI poses, which have no times" in evaluate(kitti(tmp_path / "a.txt"), tum(tmp_path / "b.tum"))
    assert "12 KITTI poses" in evaluate(kitti(tmp_path / "a.txt"), kitti(tmp_path / "b.txt", 11))
    (tmp_path / "c.txt").write_text("2 0 0 0 0 1 0 0 0 0 1 0\n")
    assert "not a rotation" in evaluate(tmp_path / "c.txt", tmp_path / "c.txt")


def test_a_clock_that_is_ahead_is_set_right(tmp_path):
    truth, estimate = tum(tmp_path / "a.tum"), tum(tmp_path / "b.tum", shift_s=100.0)
    assert "within 0.01 s" in evaluate(truth, estimate)
    found = evaluate(truth, estimate, "--time-offset", "-100")
    assert (found["pairs"], found["missing"]) == (12, 0)
    assert found["position_m"]["max"] == pytest.approx(0, abs=1e-9)
