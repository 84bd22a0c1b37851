"""`lmkit survey`, `lmkit track` and `lmkit demo --drive`, as a user runs them."""

import json
from html.parser import HTMLParser

import pytest
from command_line import run_command
from shared_folders import written_once


class Page(HTMLParser):
    """Rows of the report's tables, and the number of its drawings."""

    def __init__(self, text):
        super().__init__()
        self.rows, self.drawings = [], 0
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.drawings += tag == "svg"
        if tag == "tr":
            self.rows.append([""])
        elif tag in ("td", "th") and self.rows[-1] != [""]:
            self.rows[-1].append("")

    def handle_data(self, data):
        if self.rows and self.lasttag in ("td", "th"):
            self.rows[-1][-1] += data


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    """The files of a simulated recording."""
    return written_once(tmp_path_factory, "demo_drive", lambda folder: run("demo", "--drive", "-o", folder))


def run(*arguments, code=0):
    done = run_command(*arguments)
    assert done.code == code, done.err
    return done


def test_the_demo_writes_a_map_a_trajectory_and_a_plan(demo):
    assert (demo / "plan.png").read_bytes()[:4] == b"\x89PNG"
    done = run("evaluate", demo / "truth.tum", demo / "trajectory.tum", "--json")
    assert json.loads(done.out)["position_m"]["rmse"] < 0.1


@pytest.mark.slow
def test_a_survey_of_the_demo_s_files_finds_the_map(demo, tmp_path):
    known = tmp_path / "known.yaml"
    text = (demo / "true_map.yaml").read_text()
    head, *entries = text.split("- code:")
    # The last landmark was at another place before.
    past = f"{entries[2].rstrip()}\n  valid_to: 1.0\n"
    known.write_text(head + "- code:" + "- code:".join([*entries[:3], past]))
    seen = {line.split(",")[3] for line in (demo / "detections.csv").read_text().splitlines()[1:]}
    one, never = min(seen), next(code for code in map(str, range(256)) if code not in seen)
    done = run(
        "survey", "--detections", demo / "detections.csv", "--rig", demo / "rig.yaml", "--known", known,
        "--odometry", demo / "odometry.csv", "--gyro", demo / "gyro.csv",
        "-o", tmp_path / "map.yaml", "--plan", tmp_path / "plan.svg", "--tum", tmp_path / "s.tum", "--json",
        "--report", tmp_path / "s.html", "--wall", f"{one},{never}",
    )  # fmt: skip
    # A constraint on a landmark that the recording never saw has no effect.
    assert f"the constraint 'wall {one}, {never}' names landmarks that are not in the map: {never}\n" in done.err
    answer = json.loads(done.out)
    assert {str(entry["code"]) for entry in answer["landmarks"]} >= seen
    assert answer["odometry"]["forward_scale"] == pytest.approx(0.92, abs=0.01)
    assert (tmp_path / "map.yaml").read_text().count("valid_to: 1.0") == 1
    assert (tmp_path / "plan.svg").read_text().startswith("<svg")
    page = Page((tmp_path / "s.html").read_text())
    assert [row[0] for row in page.rows if row[0].startswith("lm8:")] == [f"lm8:{c}" for c in sorted(seen, key=int)]
    assert page.drawings == 5
    error = json.loads(run("evaluate", demo / "truth.tum", tmp_path / "s.tum", "--json").out)
    assert error["position_m"]["rmse"] < 0.06


def test_tracking_a_recording_folder_gives_a_line_per_frame(demo, tmp_path):
    files = ["--rig", demo / "rig.yaml", "--map", demo / "true_map.yaml"]
    done = run("track", demo, *files, "--live", "--json", "--csv", tmp_path / "t.csv")  # --live needs odometry
    lines = [json.loads(line) for line in done.out.splitlines()]
    assert {line["status"] for line in lines} == {"ok"}
    assert len((tmp_path / "t.csv").read_text().splitlines()) == len(lines) + 1


@pytest.mark.parametrize("how", [(), ("--live",)])
def test_tracking_goes_by_poses_of_visual_odometry_as_well(demo, tmp_path, how):
    done = run(
        "track", "--detections", demo / "detections.csv", "--rig", demo / "rig.yaml", "--map", demo / "true_map.yaml",
        "--odometry", demo / "truth.tum", "--tum", tmp_path / "t.tum", "--json", "--report", tmp_path / "t.html",
        *how,
    )  # fmt: skip
    ratios = [line["innovation"] for line in map(json.loads, done.out.splitlines()) if line["innovation"]]
    assert 0.3 < sum(ratios) / len(ratios) < 1.5
    assert Page((tmp_path / "t.html").read_text()).drawings == 5
    assert len(done.out.splitlines()) > 100
    error = json.loads(run("evaluate", demo / "truth.tum", tmp_path / "t.tum", "--json").out)
    assert error["position_m"]["rmse"] < 0.02


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["survey"], "needs a rig"),
        (["track"], "needs a map"),
        (["survey", "--rig", "RIG"], "one folder of images per camera"),
        (["survey", "--rig", "RIG", "--detections", "none.csv"], "none.csv"),
        (["survey", "--rig", "RIG", "--detections", "DET", "--gyro", "g.csv"], "--gyro needs wheel odometry"),
        (["survey", "--rig", "RIG", "--detections", "DET", "--known", "MAP", "--known-sigma", "5"], "valid angle"),
        (["survey", "--rig", "RIG", "--detections", "DET", "--wall", "12,x"], "not a landmark id"),
        (["survey", "--rig", "RIG", "--detections", "DET", "--wall", "12,13", "--wall-sigma", "5mm"], "valid angle"),
        (["survey", "--rig", "RIG", "--detections", "DET", "--wall-sigma", "5mm,1deg"], "--wall-sigma needs --wall"),
        (["track", "--map", "MAP", "--readings", "r.csv"], "odometry"),
        (["track", "--map", "MAP", "--detections", "DET"], "need a rig"),
        (["track", "--map", "MAP", "--detections", "DET", "--rig", "RIG", "--live"], "--odometry"),
        (
            ["survey", "--rig", "RIG", "--detections", "DET", "--odometry", "TUM", "--gyro", "g.csv"],
            "cannot be combined",
        ),
        (["track", "--map", "MAP", "--readings", "r.csv", "--odometry", "TUM"], "needs wheel odometry"),
        (["survey", "--rig", "RIG", "--detections", "DET", "--known-sigma", "5mm,1"], "--known-sigma needs known"),
        (["survey", "--rig", "RIG", "--detections", "DET", "--plan", "p.gif"], "unknown file type"),
        (["track", "--map", "MAP", "--detections", "DET", "--rig", "RIG", "--plan", "p.gif"], "unknown file type"),
        (["track", "--map", "MAP", "--detections", "DET", "--rig", "RIG", "--hz", "5"], "cannot be combined"),
        (["track", "DEMO", "--map", "MAP", "--rig", "RIG", "--gyro", "g.csv"], "and --gyro cannot be combined"),
        (["survey", "DEMO", "--rig", "RIG", "--odometry", "o.csv"], "and --odometry cannot be combined"),
    ],
)
def test_wrong_use_is_explained_in_one_line(demo, arguments, says):
    files = {
        "DEMO": demo,
        "RIG": demo / "rig.yaml",
        "DET": demo / "detections.csv",
        "MAP": demo / "true_map.yaml",
        "TUM": demo / "truth.tum",
    }
    done = run(*(files.get(a, a) for a in arguments), code=2)
    assert says in done.err
    assert len(done.err.strip().splitlines()) == 1


def test_odometry_of_another_clock_is_refused(demo, tmp_path):
    header, *rows = (demo / "odometry.csv").read_text().splitlines()
    late = tmp_path / "late.csv"
    moved = (f"{float(row.split(',')[0]) + 1e6},{row.split(',', 1)[1]}" for row in rows)
    late.write_text("\n".join([header, *moved]) + "\n")
    known = ["--detections", demo / "detections.csv", "--rig", demo / "rig.yaml", "--odometry", late]
    for command in (["survey", "-o", tmp_path / "m.yaml"], ["track", "--map", demo / "true_map.yaml"]):
        assert "give both in seconds of the same clock" in run(*command, *known, code=2).err
    assert not (tmp_path / "m.yaml").exists()


def test_odometry_in_feet_is_refused_by_name(demo, tmp_path):
    header, *rows = (demo / "odometry.csv").read_text().splitlines()
    feet = tmp_path / "feet.csv"
    cells = [row.split(",") for row in rows]
    feet.write_text("\n".join([header, *(f"{t},{float(v) / 0.3048},{w}" for t, v, w in cells)]) + "\n")
    done = run(
        "track", "--detections", demo / "detections.csv", "--rig", demo / "rig.yaml",
        "--map", demo / "true_map.yaml", "--odometry", feet, code=2,
    )  # fmt: skip
    assert "are these feet?" in done.err


def test_a_map_in_the_plane_from_readings(tmp_path):
    import numpy as np

    from lmkit.simulation.recording import make_drive

    drive = make_drive(1, seconds=60)
    readings = tmp_path / "r.csv"
    rows = [f"{t},{r.id.code},{r.range_m},{r.bearing_rad}" for t, seen in drive.readings(1) for r in seen]
    readings.write_text("\n".join(["time_s,code,range_m,bearing_rad", *rows]) + "\n")
    o = drive.odometry
    x = np.column_stack([o.times_s, np.append(o.forward_m[1:], 0) / 0.02, np.append(o.turn_rad[1:], 0) / 0.02])
    (tmp_path / "o.csv").write_text("t,v,w\n" + "".join(f"{a},{b},{c}\n" for a, b, c in x))
    done = run(
        "survey", "--readings", readings, "--odometry", tmp_path / "o.csv", "-o", tmp_path / "m.yaml", "--json"
    )
    found = {m["code"]: np.array(m["position"][:2]) for m in json.loads(done.out)["landmarks"]}
    true = {m.code: m.T_map_landmark.t[:2] for m in drive.landmarks if m.code in found}
    assert len(found) > 10
    # The map's frame is the robot's first pose, so only distances between landmarks can be compared.
    off = [
        np.linalg.norm(found[a] - found[b]) - np.linalg.norm(true[a] - true[b]) for a in found for b in found if a < b
    ]
    assert np.sqrt(np.mean(np.square(off))) < 0.15


@pytest.mark.slow
def test_april_tags_are_surveyed_and_tracked_as_landmarks_are(demo, tmp_path):
    files = {
        name: (demo / name).read_text().replace("lm8", "tag36h11") for name in ("true_map.yaml", "detections.csv")
    }
    for name, text in files.items():
        (tmp_path / name).write_text(text)
    head, *entries = files["true_map.yaml"].split("- code:")
    (tmp_path / "known.yaml").write_text(head + "- code:" + "- code:".join(entries[:3]))
    given = (
        "--detections", tmp_path / "detections.csv", "--rig", demo / "rig.yaml",
        "--odometry", demo / "odometry.csv", "--gyro", demo / "gyro.csv",
    )  # fmt: skip
    run("survey", *given, "--known", tmp_path / "known.yaml", "-o", tmp_path / "map.yaml")
    assert "family: tag36h11" in (tmp_path / "map.yaml").read_text()
    run("track", *given, "--map", tmp_path / "map.yaml", "--tum", tmp_path / "tracked.tum")
    done = run("evaluate", demo / "truth.tum", tmp_path / "tracked.tum", "--json")
    assert json.loads(done.out)["position_m"]["rmse"] < 0.1
