"""Tables of a recording: what is read, and what is refused."""

import numpy as np
import pytest

from lmkit.errors import InputError
from lmkit.io.recording_tables import detections_to_csv, read_detections, read_gyro, read_odometry
from lmkit.simulation.recording import make_drive


def written(tmp_path, text):
    path = tmp_path / "table.csv"
    path.write_text(text)
    return path


def test_detections_come_back(tmp_path):
    frames = make_drive(0, seconds=5).frames
    back = read_detections(written(tmp_path, detections_to_csv(frames)), ["lm8"])
    seen = [frame for frame in frames if frame.detections]
    assert [m.time_s for m in back] == pytest.approx([m.time_s for m in seen], abs=1e-6)
    for a, b in zip(seen, back, strict=True):
        assert [o.code for o in a.seen[0]] == [o.code for o in b.seen[0]]
        for x, y in zip(a.seen[1], b.seen[1], strict=True):
            assert np.abs(x.corners - y.corners).max() < 1e-4


def test_the_three_kinds_of_odometry_agree(tmp_path):
    turn = 0.1 * np.arange(5)
    x, y = np.cumsum(0.2 * np.cos(turn - 0.05)), np.cumsum(0.2 * np.sin(turn - 0.05))
    poses = "t,x,y,yaw\n" + "".join(f"{k},{x[k]},{y[k]},{turn[k]}\n" for k in range(5))
    wheels = "time_s,left_m,right_m\n" + "".join(f"{k},{0.2 - 0.02},{0.2 + 0.02}\n" for k in range(5))
    speeds = "time_s,forward_mps,turn_radps\n" + "".join(f"{k},0.2,0.1\n" for k in range(5))
    for text, track in ((poses, None), (wheels, 0.4), (speeds, None)):
        odometry = read_odometry(written(tmp_path, text), track)
        assert odometry.forward_m[1:] == pytest.approx(0.2, abs=1e-9)
        assert odometry.turn_rad[1:] == pytest.approx(0.1, abs=1e-9)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("a,b\n1,2\n", "no column time_s"),
        ("time_s,b\n1,2\n2,3\n", "no columns of odometry in time_s"),
        ("time_s,left_m,right_m\n1,2,3\n2,3,4\n", "contains wheel distances"),
        ("time_s,v,w\n1,2,3\n1,3,4\n", "line 3: time does not increase"),
        ("time_s,v,w\n1,2,3\n2,nan,4\n", "line 3"),
        ("time_s,v,w\n1,2,3\n2,x,4\n", "line 3"),
        ("time_s,v,w\n1,2,3\n", "fewer than two rows"),
    ],
)
def test_bad_odometry_is_refused_by_line(tmp_path, text, says):
    with pytest.raises(InputError, match=says):
        read_odometry(written(tmp_path, text))


def test_a_gyro_file_in_place_of_odometry_is_named(tmp_path):
    with pytest.raises(InputError) as raised:
        read_odometry(written(tmp_path, "time_s,wz\n1,2\n2,3\n"))
    assert "--gyro" in raised.value.hint


def test_a_gyro_file_needs_rates(tmp_path):
    assert read_gyro(written(tmp_path, "t,wx,wy,wz\n0,9,9,0.1\n1,9,9,0.3\n")).turned(np.array([1.0])) == [0.2]
    with pytest.raises(InputError, match="rate_radps"):
        read_gyro(written(tmp_path, "t,wx\n0,1\n1,1\n"))


@pytest.mark.parametrize(
    ("row", "says"),
    [
        ("1.0,middle,7,0,0,1,0,1,1,0,1", "not in the rig: left, right"),
        ("1.0,left,7,0,0,1,0,1,1,0", "line 2.*10 values for 11 columns"),
        ("1.0,left,7,0,0,1,0,1,1,0,1\n1.0,left,7,0,0,1,0,1,1,0,1", "line 3.*repeats line 2"),
        ("1.0,left,x,0,0,1,0,1,1,0,1", "line 2"),
        ("inf,left,7,0,0,1,0,1,1,0,1", "line 2"),
        ("1.0,left,7,nan,0,1,0,1,1,0,1", "line 2"),
    ],
)
def test_bad_detections_are_refused_by_line(tmp_path, row, says):
    header = "time_s,camera,code,x0,y0,x1,y1,x2,y2,x3,y3"
    with pytest.raises(InputError, match=says):
        read_detections(written(tmp_path, f"{header}\n{row}\n"), ["lm8"])


def test_tags_of_others_keep_their_family(tmp_path):
    text = "time_s,camera,tag_id,x0,y0,x1,y1,x2,y2,x3,y3\n1,left,400,0,0,1,0,1,1,0,1\n"
    assert read_detections(written(tmp_path, text), ["lm8"])[0].seen[0][0].family == "tag36h11"


def test_the_header_names_the_corners_of_other_orders(tmp_path):
    ours = "time_s,camera,tag_id,x0,y0,x1,y1,x2,y2,x3,y3\n" + "".join(
        f"{k},left,{k},10,10,50,12,49,52,9,50\n" for k in range(5)
    )
    apriltag = "time_s,camera,tag_id,{}\n" + "".join(f"{k},left,{k},9,50,49,52,50,12,10,10\n" for k in range(5))
    named = apriltag.format("x3,y3,x2,y2,x1,y1,x0,y0")
    both = [read_detections(written(tmp_path, text), ["lm8"]) for text in (ours, named)]
    for a, b in zip(*both, strict=True):
        assert np.array_equal(a.seen[0][0].corners, b.seen[0][0].corners)
    with pytest.raises(InputError, match="another order"):
        read_detections(written(tmp_path, apriltag.format("x0,y0,x1,y1,x2,y2,x3,y3")), ["lm8"])


@pytest.mark.parametrize("text", ["", "\n\n"])
@pytest.mark.parametrize("read", [read_odometry, lambda path: read_detections(path, ["lm8"], ["left", "right"])])
def test_an_empty_file_is_called_empty(tmp_path, text, read):
    path = tmp_path / "table.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=r"table\.csv: the file is empty"):
        read(path)
