"""Images of several cameras are grouped by their names where possible; times are never invented."""

from __future__ import annotations

from pathlib import Path

import pytest

from lmkit.errors import InputError, InputWarning
from lmkit.io.image_groups import list_pairs
from lmkit.io.image_names import time_of
from lmkit.io.image_sources import list_images


def folders(tmp_path: Path, left: list[str], right: list[str]) -> tuple[str, str]:
    for side, names in (("left", left), ("right", right)):
        (tmp_path / side).mkdir()
        for name in names:
            (tmp_path / side / name).touch()
    return str(tmp_path / "left"), str(tmp_path / "right")


def names_of(pairs: list[tuple[Path, Path]]) -> list[tuple[str, str]]:
    return [(a.name, b.name) for a, b in pairs]


NS = [1403636579763555584 + k * 50_000_000 for k in range(4)]


@pytest.mark.parametrize(
    ("left", "right", "first", "count"),
    [
        (["1.png", "2.png", "10.png"], ["1.jpg", "2.jpg", "10.jpg"], ("1.png", "1.jpg"), 3),
        (["left01.png", "left02.png"], ["right01.png", "right02.png"], ("left01.png", "right01.png"), 2),
        (["a_1_L.png", "a_2_L.png"], ["a_1_R.png", "a_2_R.png"], ("a_1_L.png", "a_1_R.png"), 2),
        (["cam0_7.png", "cam0_8.png"], ["cam1_7.png", "cam1_8.png"], ("cam0_7.png", "cam1_7.png"), 2),
        (
            [f"{t}.png" for t in NS],
            [f"{t + 3_000_000}.png" for t in NS],
            (f"{NS[0]}.png", f"{NS[0] + 3_000_000}.png"),
            4,
        ),
        (["IMG_0101.jpg", "IMG_0102.jpg"], ["DSC_0877.jpg", "DSC_0878.jpg"], ("IMG_0101.jpg", "DSC_0877.jpg"), 2),
        # Counters of two cameras that overlap by chance do not group images.
        ([f"{k}.png" for k in range(1, 6)], [f"{k}.png" for k in range(4, 9)], ("1.png", "4.png"), 5),
    ],
)
def test_pairs(tmp_path, left, right, first, count):
    pairs = names_of(list_pairs(*folders(tmp_path, left, right)))
    assert (pairs[0], len(pairs)) == (first, count)


@pytest.mark.parametrize(
    ("left", "right", "alone"),
    [
        (["0.png", "1.png", "2.png"], ["1.png", "2.png", "3.png"], 2),
        (["0.png", "1.png", "2.png"], ["0.png", "2.png"], 1),
        ([f"{t}.png" for t in NS], [f"{t - 2_000_000}.png" for t in NS if t != NS[1]], 1),
    ],
)
def test_images_without_a_partner_are_left_out_and_named(tmp_path, left, right, alone):
    with pytest.warns(InputWarning, match=rf"left out: {alone} \("):
        pairs = names_of(list_pairs(*folders(tmp_path, left, right)))
    assert len(pairs) == 2 + (len(left) == 4)
    for a, b in pairs:
        assert a == b or int(a[:-4]) - int(b[:-4]) == 2_000_000


def test_names_that_do_not_tell_need_as_many_images_of_each_camera(tmp_path):
    with pytest.raises(InputError, match="3 left and 2 right images do not make pairs"):
        list_pairs(*folders(tmp_path, ["a.png", "b.png", "c.png"], ["x.png", "y.png"]))


def test_numbers_in_names_are_ordered_by_value(tmp_path):
    left, _ = folders(tmp_path, ["f10.png", "f9.png", "f1.25.png", "f1.5.png"], [])
    assert [path.name for path in list_images(left)] == ["f1.25.png", "f1.5.png", "f9.png", "f10.png"]


@pytest.mark.parametrize(
    ("name", "time_s"),
    [
        ("1403636579763555584.png", 1403636579.763555584),
        ("cam0_1403636579763555584.png", 1403636579.763555584),
        ("1305031102.175304.png", 1305031102.175304),
        ("left-3.50.png", 3.5),
        ("000123.png", None),
        ("20240131_093000.png", None),
        ("1403636579763.png", None),
        ("1.403636579763555584e18.png", None),
        ("99999999999999999999999.png", None),
    ],
)
def test_times_are_those_that_names_hold(name, time_s):
    assert time_of(name) == (None if time_s is None else pytest.approx(time_s, abs=1e-6))
