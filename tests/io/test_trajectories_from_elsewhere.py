"""Trajectories without times (KITTI), and on another clock."""

from __future__ import annotations

import json

import numpy as np
import pytest
from command_line import run_command
from scipy.spatial.transform import Rotation

from lmkit.errors import InputError
from lmkit.io.trajectory import read_trajectory

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


QUATERNIONS = Rotation.from_rotvec([[0.1, 0.2, 0.3], [0.2, 0.2, 0.5]]).as_quat().tolist()
POSES = [dict(zip(("t", *"xyz", "qx", "qy", "qz", "qw"), row, strict=True)) for row in (
    (10.0, 1.0, 2.0, 0.5, *QUATERNIONS[0]), (10.5, 1.25, 2.0, 0.5, *QUATERNIONS[1]),
)]  # fmt: skip
IN_MESSAGES = {
    "%time": "t", "field.header.seq": "seq", "field.header.frame_id": "frame",
    **{f"field.pose.pose.position.{k}": k for k in "xyz"},
    **{f"field.pose.pose.orientation.{k}": f"q{k}" for k in "xyzw"},
    **{f"field.twist.twist.linear.{k}": "seq" for k in "xyz"},
}  # fmt: skip


@pytest.mark.parametrize(
    ("names", "keys", "separator"),
    [
        ("t x y z qx qy qz qw", "t x y z qx qy qz qw", ";"),
        ("t;x;y;z;qw;qx;qy;qz", "t x y z qw qx qy qz", ";"),
        ("time,qx,qy,qz,qw,x,y,z", "t qx qy qz qw x y z", ","),
        ("# timestamp qw qx qy qz tx ty tz", "t qw qx qy qz x y z", " "),
        (",stamp,px,py,pz,qx,qy,qz,qw", "seq t x y z qx qy qz qw", ","),
        ('"t","x","y","z","qx","qy","qz","qw"', "t x y z qx qy qz qw", ","),
        (",".join(IN_MESSAGES), " ".join(IN_MESSAGES.values()), ","),
    ],
)
def test_columns_of_a_trajectory_are_found_by_their_names(tmp_path, names, keys, separator):
    rows = [separator.join(str((pose | {"seq": 7, "frame": "map"})[key]) for key in keys.split()) for pose in POSES]
    if separator == ";":
        rows, names = [row.replace(".", ",") for row in rows], names.replace(" ", ";")
    (tmp_path / "t.csv").write_text("\n".join([names, *rows]))
    found = read_trajectory(tmp_path / "t.csv")
    assert found.times_s.tolist() == [10.0, 10.5]
    assert found.positions.tolist() == [[1.0, 2.0, 0.5], [1.25, 2.0, 0.5]]
    assert np.allclose(found.quaternions, QUATERNIONS)


def test_poses_of_colmap_have_no_times_and_are_refused(tmp_path):
    """They are poses of the world in the camera."""
    row = f"1 {QUATERNIONS[0][3]} " + " ".join(map(str, [*QUATERNIONS[0][:3], 1, 2, 3])) + " 1 a.png"
    (tmp_path / "images.txt").write_text(f"# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n{row}\n")
    with pytest.raises(InputError, match="line 2"):
        read_trajectory(tmp_path / "images.txt")


def test_times_in_milliseconds_make_no_bag(tmp_path):
    pytest.importorskip("rosbags")
    rows = [f"{(1.7e9 + k) * 1000:.0f} 0 0 0 0 0 0 1\n" for k in range(2)]
    (tmp_path / "ms.tum").write_text("".join(rows))
    done = run_command("convert", tmp_path / "ms.tum", "--to", "bag", "-o", tmp_path / "bag")
    assert done.code == 2
    assert "divide milliseconds by 1000" in done.err
    assert not (tmp_path / "bag").exists()
