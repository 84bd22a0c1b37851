"""Trajectory errors: equal to those of evo (its formulas are written out here), and laws."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from lmkit.errors import InputError
from lmkit.evaluation.trajectory_error import associate, compare_trajectories, umeyama
from lmkit.io.trajectory import read_trajectory
from lmkit.model.trajectory import Trajectory


def wander(seed: int, count: int = 60, noise: float = 0.0) -> Trajectory:
    rng = np.random.default_rng(seed)
    way = np.cumsum(rng.normal(0, 0.1, (count, 3)), axis=0)
    turns = Rotation.from_rotvec(np.cumsum(rng.normal(0, 0.05, (count, 3)), axis=0))
    other = np.random.default_rng(seed + 1000)
    off = Rotation.from_rotvec(other.normal(0, noise + 1e-15, (count, 3)))
    positions = way + other.normal(0, noise + 1e-15, (count, 3))
    return Trajectory(np.arange(count) / 10, positions, (turns * off).as_quat())


def tum(t: Trajectory) -> str:
    return "\n".join(
        " ".join(f"{v:.12f}" for v in (time, *p, *q))
        for time, p, q in zip(t.times_s, t.positions, t.quaternions, strict=True)
    )


@given(st.integers(0, 50), st.tuples(*[st.floats(-3, 3)] * 3), st.tuples(*[st.floats(-9, 9)] * 3), st.floats(0.2, 4))
def test_alignment_undoes_any_turn_shift_and_scale(seed, turn, shift, scale):
    truth = wander(seed)
    moved = truth.moved(Rotation.from_rotvec(turn).as_matrix(), np.array(shift), scale)
    error = compare_trajectories(truth, moved, "scale")
    assert error.position_m.max < 1e-8
    assert error.rotation_deg.max < 1e-4
    assert error.scale == pytest.approx(1 / scale)


def test_relative_errors_do_not_see_the_frame():
    truth, found = wander(1), wander(1, noise=0.02)
    moved = found.moved(Rotation.from_rotvec([0.3, 2, 1]).as_matrix(), np.array([5.0, 6, 7]))
    one, other = compare_trajectories(truth, found, delta=3), compare_trajectories(truth, moved, delta=3)
    assert one.relative_position_m.rmse == pytest.approx(other.relative_position_m.rmse)
    assert one.position_m.rmse < 0.1 < other.position_m.rmse


def test_known_errors_come_out():
    truth = wander(2)
    shifted = Trajectory(truth.times_s, truth.positions + np.array([0.3, 0.4, 0.0]), truth.quaternions)
    error = compare_trajectories(truth, shifted)
    assert error.position_m.rmse == pytest.approx(0.5)
    assert error.relative_position_m.max == pytest.approx(0, abs=1e-12)
    turn = Rotation.from_rotvec([0, 0, 0.1])
    turned = Trajectory(
        truth.times_s,
        truth.positions,
        (turn * Rotation.from_quat(truth.quaternions)).as_quat(),
    )
    error = compare_trajectories(truth, turned)
    assert error.rotation_deg.mean == pytest.approx(np.rad2deg(0.1))
    assert error.heading_deg.mean == pytest.approx(np.rad2deg(0.1))


def test_the_papers_percentage():
    level = np.tile([0.0, 0, 0, 1], (3, 1))
    truth = Trajectory([0, 1, 2], np.array([[0, 0, 0], [1.0, 0, 0], [2, 0, 0]]), level)
    found = Trajectory([0, 1, 2], np.array([[0, 0, 0], [1.02, 0, 0], [1.94, 0, 0]]), level)
    assert compare_trajectories(truth, found).percent == pytest.approx((2 + 3) / 2)


def test_times_find_their_nearest():
    a, b = associate(np.array([0.0, 1, 2, 3]), np.array([0.004, 0.995, 2.5, 3.0, 9.0]), 0.01)
    assert (a.tolist(), b.tolist()) == ([0, 1, 3], [0, 1, 3])
    b, a = associate(np.array([0.004, 0.995, 2.5, 3.0, 9.0]), np.array([0.0, 1, 2, 3]), 0.01)
    assert (a.tolist(), b.tolist()) == ([0, 1, 3], [0, 1, 3])


def test_poses_on_a_line_fix_no_alignment():
    line = np.outer(np.arange(5.0), [1, 2, 3])
    with pytest.raises(InputError, match="on a line"):
        umeyama(line, line + 1, False)


def test_the_command_reads_tum_and_says_it_in_words_and_json(lmkit, tmp_path):
    truth, found = wander(3), wander(3, noise=0.01)
    (tmp_path / "t.txt").write_text("# time x y z\n" + tum(truth))
    (tmp_path / "e.txt").write_text(tum(found))
    row = json.loads(lmkit("evaluate", "t.txt", "e.txt", "--json", "--align", "rigid").out)
    want = compare_trajectories(truth, found, "rigid")
    assert row["position_m"]["rmse"] == pytest.approx(want.position_m.rmse, abs=1e-9)
    assert row["pairs"] == 60
    assert "percentage error" in lmkit("evaluate", "t.txt", "e.txt").out
    assert np.allclose(read_trajectory(tmp_path / "t.txt").positions, truth.positions)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("0 1 2 3", "line 1 holds 4 numbers"),
        ("0 0 0 0 0 0 0 1\n0 0 0 0 0 0 0 1", "line 2 has the time of the line before"),
        ("0 0 0 0 0 0 0 2", "not of length 1"),
        ("0 0 0 0 0 0 0 nan", "line 1"),
        ("a b", "line 1"),
        ("# nothing", "no poses"),
        ("99 0 0 0 0 0 0 1", "within 0.01 s"),
    ],
)
def test_bad_trajectories_are_refused(lmkit, tmp_path, text, words):
    (tmp_path / "t.txt").write_text(tum(wander(1)))
    (tmp_path / "e.txt").write_text(text)
    answer = lmkit("evaluate", "t.txt", "e.txt")
    assert answer.code == 2
    assert words in answer.err


def test_the_report_shows_both_paths_and_the_time_of_the_largest_error(lmkit, tmp_path):
    truth = wander(3)
    positions = truth.positions.copy()
    positions[17] += [0.0, 0.3, 0.0]
    (tmp_path / "truth.tum").write_text(tum(truth))
    (tmp_path / "found.tum").write_text(tum(Trajectory(truth.times_s, positions, truth.quaternions)))
    answer = lmkit("evaluate", "truth.tum", "found.tum", "--report", "errors.html")
    assert answer.code == 0
    text = (tmp_path / "errors.html").read_text()
    assert "truth: truth.tum" in text
    assert "estimate: found.tum" in text
    assert "<td>1.70</td><td class='n'>300.0</td>" in text
    assert lmkit("evaluate", "truth.tum", "found.tum", "--report", "errors.html").code == 2


@pytest.mark.parametrize(("factor", "word"), [(1e3, "milliseconds"), (1e6, "microseconds"), (1.0, "start together")])
def test_clocks_that_do_not_meet_are_named(factor, word):
    times = 1.7e9 + np.arange(5.0)
    at = np.zeros((5, 3)), np.tile([0.0, 0, 0, 1], (5, 1))
    with pytest.raises(InputError, match=word):
        compare_trajectories(Trajectory(times, *at), Trajectory(times * factor + 99.0, *at))


def curve(unit: float = 1.0, order: tuple[int, ...] = (0, 1, 2, 3)) -> Trajectory:
    """A robot on an arc, with lengths in another unit or quaternions in another order."""
    angles = np.linspace(0.2, 1.8, 30)
    quaternions = Rotation.from_rotvec(np.outer(angles, [0.0, 0.0, 1.0])).as_quat()[:, order]
    places = np.column_stack([3 * np.cos(angles), 3 * np.sin(angles), 0 * angles])
    return Trajectory(np.arange(30.0), unit * places, quaternions)


@pytest.mark.parametrize(
    ("truth", "estimate", "align", "words"),
    [
        (curve(), curve(), "none", ""),
        (curve(), curve(1000), "none", "the estimate extends 1000 times as far as the truth (is it in millimeters?)"),
        (curve(1000), curve(), "rigid", "the truth extends 1000 times as far"),
        (curve(), curve(1000), "scale", ""),
        (curve(), curve(3.28), "none", ""),
        (curve(0.001), wander(0), "none", ""),
        (curve(), curve(order=(3, 0, 1, 2)), "none", "quaternions of the estimate have w first"),
        (curve(order=(3, 0, 1, 2)), curve(), "none", "quaternions of the truth have w first"),
        (curve(order=(3, 0, 1, 2)), curve(order=(3, 0, 1, 2)), "none", ""),
    ],
)
def test_units_and_orders_that_differ_are_named(recwarn, truth, estimate, align, words):
    compare_trajectories(truth, estimate, align)
    said = " ".join(str(w.message) for w in recwarn)
    assert words in said
    assert bool(words) == bool(said)
