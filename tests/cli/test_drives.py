"""`lmkit survey`, `lmkit track` and `lmkit demo --drive`, as a user runs them."""

import json
import subprocess
import sys

import pytest


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    """The files of a simulated drive."""
    folder = tmp_path_factory.mktemp("drive")
    run("demo", "--drive", "-o", folder)
    return folder


def run(*arguments, code=0):
    done = subprocess.run(
        [sys.executable, "-c", "from lmkit.cli.main import main; main()", *map(str, arguments)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == code, done.stderr
    return done


def test_the_demo_writes_a_map_a_trajectory_and_a_plan(demo):
    assert (demo / "plan.png").read_bytes()[:4] == b"\x89PNG"
    done = run("evaluate", demo / "truth.tum", demo / "trajectory.tum", "--json")
    assert json.loads(done.stdout)["position_m"]["rmse"] < 0.1


def test_a_survey_of_the_demo_s_files_finds_the_map(demo, tmp_path):
    known = tmp_path / "known.yaml"
    text = (demo / "true_map.yaml").read_text()
    head, *entries = text.split("- code:")
    known.write_text(head + "- code:" + "- code:".join(entries[:3]))
    done = run(
        "survey", "--detections", demo / "detections.csv", "--rig", demo / "rig.yaml", "--known", known,
        "--odometry", demo / "odometry.csv", "--gyro", demo / "gyro.csv",
        "-o", tmp_path / "map.yaml", "--plan", tmp_path / "plan.svg", "--tum", tmp_path / "s.tum", "--json",
    )  # fmt: skip
    answer = json.loads(done.stdout)
    seen = {line.split(",")[3] for line in (demo / "detections.csv").read_text().splitlines()[1:]}
    assert {str(entry["code"]) for entry in answer["landmarks"]} >= seen
    assert answer["odometry"]["forward_scale"] == pytest.approx(0.92, abs=0.01)
    assert (tmp_path / "plan.svg").read_text().startswith("<svg")
    error = json.loads(run("evaluate", demo / "truth.tum", tmp_path / "s.tum", "--json").stdout)
    assert error["position_m"]["rmse"] < 0.06


def test_tracking_gives_a_line_a_moment(demo, tmp_path):
    done = run(
        "track", "--detections", demo / "detections.csv", "--rig", demo / "rig.yaml", "--map", demo / "true_map.yaml",
        "--odometry", demo / "odometry.csv", "--json", "--csv", tmp_path / "t.csv",
    )  # fmt: skip
    lines = [json.loads(line) for line in done.stdout.splitlines()]
    assert {line["status"] for line in lines} == {"ok"}
    assert len((tmp_path / "t.csv").read_text().splitlines()) == len(lines) + 1


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["survey"], "needs a rig"),
        (["track"], "needs a map"),
        (["survey", "--rig", "RIG"], "LEFT and RIGHT"),
        (["survey", "--rig", "RIG", "--detections", "none.csv"], "none.csv"),
        (["survey", "--rig", "RIG", "--detections", "DET", "--gyro", "g.csv"], "--gyro needs odometry"),
        (["survey", "--rig", "RIG", "--detections", "DET", "--known", "MAP", "--known-sigma", "5"], "no angle"),
        (["track", "--map", "MAP", "--readings", "r.csv"], "odometry"),
        (["track", "--map", "MAP", "--detections", "DET"], "need a rig"),
        (["track", "--map", "MAP", "--detections", "DET", "--rig", "RIG", "--live"], "--live"),
    ],
)
def test_wrong_use_is_told_in_one_line(demo, arguments, says):
    files = {"RIG": demo / "rig.yaml", "DET": demo / "detections.csv", "MAP": demo / "true_map.yaml"}
    done = run(*(files.get(a, a) for a in arguments), code=2)
    assert says in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
