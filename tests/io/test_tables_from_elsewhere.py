"""Tables and trajectories as spreadsheets, rostopic, EuRoC and TUM-VI write them."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

from lmkit.errors import InputError
from lmkit.io.readings import read_readings
from lmkit.io.recording_tables import read_gyro, read_odometry
from lmkit.io.trajectory import read_trajectory

TUM = "1520530308.25 1 2 3 0.1 0.2 0.3 0.9273618495495703\n1520530308.5 2 2 3 0.1 0.2 0.3 0.9273618495495703\n"
W_FIRST = TUM.replace("0.1 0.2 0.3 0.9273618495495703", "0.9273618495495703 0.1 0.2 0.3")
EUROC = """#timestamp [ns], p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z [], v_x
1520530308250000000,1,2,3,0.9273618495495703,0.1,0.2,0.3,7
1520530308500000000,2,2,3,0.9273618495495703,0.1,0.2,0.3,7
"""
ODOMETRY = "time_s,x_m,y_m,heading_rad\n0.0,0.5,0.0,0.1\n0.5,0.75,0.25,0.2\n"


def write(folder, text: str | bytes):
    path = folder / "table"
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return path


@pytest.mark.parametrize(
    "text",
    [
        EUROC,
        TUM.replace("308.25", "308250000000").replace("308.5", "308500000000"),
        "\ufeff" + TUM.replace("\n", " \r\n"),
        TUM.replace(" ", ","),
        "timestamp tx ty tz qx qy qz qw\n" + TUM,
        # w first, by a header with spaces; columns after the pose (OpenVINS, RTAB-Map); commas of a spreadsheet
        "# made by hand\n# timestamp tx ty tz qw qx qy qz\n" + W_FIRST,
        "timestamp,x,y,z,qw,qx,qy,qz\n" + W_FIRST.replace(" ", ","),
        "# timestamp(s) tx ty tz qx qy qz qw Pr11 Pr12\n" + TUM.replace("\n", " 0.1 0.2\n"),
        "#timestamp x y z qx qy qz qw id\n" + TUM.replace("\n", " 7\n"),
        "time;x;y;z;qx;qy;qz;qw\n" + TUM.replace(" ", ";").replace(".", ","),
    ],
)
def test_a_trajectory_is_the_same_in_every_dress(tmp_path, text):
    expected = read_trajectory(write(tmp_path, TUM))
    found = read_trajectory(write(tmp_path, text))
    assert found.times_s == pytest.approx(expected.times_s, abs=1e-6)
    assert np.array_equal(found.positions, expected.positions)
    assert np.array_equal(found.quaternions, expected.quaternions)


@pytest.mark.parametrize(
    ("text", "named"),
    [
        (TUM + TUM.splitlines()[1], "line 3 has the time of the line before it"),
        (TUM + TUM, "line 3: time does not increase"),
        (TUM.replace("1 2 3", "1 2 1e308"), "line 1"),
        (TUM.replace("1 2 3", "1 2 nan"), "line 1"),
        (TUM.replace("1 2 3", "1 2"), "line 1 holds 7 numbers"),
    ],
)
def test_what_is_wrong_in_a_trajectory_is_named(tmp_path, text, named):
    with pytest.raises(InputError, match=named):
        read_trajectory(write(tmp_path, text))


@pytest.mark.parametrize(
    "text",
    [
        "\ufeff" + ODOMETRY.replace("\n", "\r\n"),
        "time_s;x_m;y_m;heading_rad\n0,0;0,5;0,0;0,1\n0,5;0,75;0,25;0,2\n",
        ODOMETRY.replace(",", "\t"),
        "%time,field.header.frame_id,x,y,yaw\n0.0,odom,0.5,0.0,0.1\n0.5,odom,0.75,0.25,0.2\n",
    ],
)
def test_odometry_is_the_same_in_every_dress(tmp_path, text):
    expected = read_odometry(write(tmp_path, ODOMETRY))
    found = read_odometry(write(tmp_path, text))
    assert np.array_equal(found.times_s, expected.times_s)
    assert np.array_equal(found.forward_m, expected.forward_m)
    assert np.array_equal(found.turn_rad, expected.turn_rad)


@pytest.mark.parametrize(
    "text",
    [
        "time_s,wz\n0,nan\n1,1\n",
        "time_s,wz\n0,inf\n1,1\n",
        "time_s,wz\n0,1e308\n1,1\n",
        "time_s,wz\n1e308,1\n2,1\n",
        "time_s,wz\n0,1\n0,1\n",
        "time_s,wz,wz\n0,1,2\n1,1,2\n",
        "time_s,wz\n0," + "1" * 200_000 + "\n",
        "time_s,wz\n0\n",
    ],
    ids=lambda text: text[10:24],
)
def test_numbers_that_measure_nothing_are_refused(tmp_path, text):
    with pytest.raises(InputError):
        read_gyro(write(tmp_path, text))


@pytest.mark.parametrize("head", ["__time,/odom/twist/twist/linear/x,/odom/twist/twist/angular/z",
                                  "%time,field.twist.twist.linear.x,field.twist.twist.angular.z"])  # fmt: skip
def test_velocities_of_messages_are_found_by_their_names(tmp_path, head):
    found = read_odometry(write(tmp_path, f"{head}\n0.0,0.5,0.1\n0.5,0.5,0.1\n1.0,0.5,0.1\n"))
    assert found.forward_m.sum() == pytest.approx(0.5)
    rates = read_gyro(write(tmp_path, "__time,/imu/angular_velocity/z\n0.0,0.1\n0.5,0.2\n"))
    assert rates.rate_radps.tolist() == [0.1, 0.2]


def test_a_table_without_a_header_is_named(tmp_path):
    """Rows of `ros2 topic echo --csv` begin with numbers."""
    with pytest.raises(InputError, match="line 1 contains numbers"):
        read_odometry(
            write(tmp_path, "100,0,odom,base_link,0.1,0.0,0.0,0.0,0.0,1.0\n100,5,odom,base_link,0,0,0,0,0,1\n")
        )


@pytest.mark.parametrize(
    "text",
    [
        ODOMETRY.replace("time_s,x_m,y_m,heading_rad", "Time,X,Y,Yaw"),
        ODOMETRY.replace("time_s,x_m,y_m,heading_rad", "timestamp [s],x [m],y (m),theta [rad]"),
        ODOMETRY.replace("\n0", ",\n0").replace("0.2\n", "0.2,\n").replace("heading_rad,", "heading_rad"),
    ],
)
def test_headers_with_units_and_capitals_and_commas_at_the_end(tmp_path, text):
    expected, found = read_odometry(write(tmp_path, ODOMETRY)), read_odometry(write(tmp_path, text))
    assert np.array_equal(found.forward_m, expected.forward_m)
    assert np.array_equal(found.turn_rad, expected.turn_rad)


def test_another_unit_in_a_header_is_not_passed_over(tmp_path):
    with pytest.raises(InputError, match="no columns of odometry"):
        read_odometry(write(tmp_path, ODOMETRY.replace("x_m", "x [mm]")))


@pytest.mark.parametrize("is_swapped", [False, True])
def test_positions_that_move_sideways_are_doubted(tmp_path, is_swapped):
    """A quarter of a circle, 2 m of radius, in 10 s."""
    angles = np.linspace(0, np.pi / 2, 101)
    x, y = 2 * np.sin(angles), 2 - 2 * np.cos(angles)
    columns = (y, x) if is_swapped else (x, y)
    rows = np.column_stack([np.arange(101) / 10, *columns, angles])
    path = write(tmp_path, "time_s,x,y,yaw\n" + "\n".join(",".join(map(str, row)) for row in rows.tolist()))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        read_odometry(path)
    assert ["are x and y swapped" in str(w.message) for w in caught] == [True] * is_swapped


def test_readings_are_read_by_the_names_of_their_columns(tmp_path):
    rows = read_readings(write(tmp_path, "time_s,code,range_m,bearing_rad\n0.5,7,2.0,0.1\n0.5,8,,0.2\n"), ("lm8",))
    text = "Bearing,family,id,Range,t\n0.1,lm8,7,2.0,0.5\n0.2,lm8,8,,0.5\n"
    assert read_readings(write(tmp_path, text), ("lm8", "lm12")) == rows
    for header in ("time_s,code,range_m", "time_s,code,range_m,bearing_rad,range", "time_s,code,range_m,bearing_deg"):
        with pytest.raises(InputError, match="line 1 is"):
            read_readings(write(tmp_path, f"{header}\n0.5,7,2.0,0.1\n"), ("lm8",))
