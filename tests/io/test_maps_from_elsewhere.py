"""Maps whose keys change what their numbers mean."""

from __future__ import annotations

import json
import warnings
from dataclasses import replace

import numpy as np
import pytest
import yaml
from command_line import run_command

import lmkit
from lmkit.errors import InputError, InputWarning
from lmkit.geometry.pose import Pose
from lmkit.io.external_maps import map_to_tagslam, map_to_wpilib, read_any_map
from lmkit.io.landmark_map import map_to_yaml
from lmkit.io.marker_maps import MarkerDefaults
from lmkit.io.measured_map import FormDefaults, read_measured_map
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import LandmarkMap, MappedLandmark, wall_pose
from lmkit.simulation.recording import make_drive

LANDMARKS = make_drive(0, seconds=3).landmarks
TAG = {"position": {"x": 1.0, "y": 0.0, "z": 1.5}, "rotation": {"x": 0.0, "y": 0.0, "z": 0.0}}


def file(folder, data: object):
    path = folder / "map"
    path.write_text(json.dumps(data))
    return path


def test_the_format_key_decides_before_anything_else(tmp_path):
    path = file(tmp_path, yaml.safe_load(map_to_yaml(LANDMARKS)))
    assert [m.id for m in read_any_map(path)] == [m.id for m in LANDMARKS]


def test_a_layout_that_names_its_tags_is_believed(tmp_path):
    layout = json.loads(map_to_wpilib(LANDMARKS, (8.0, 5.0)))
    code = layout["tags"][0]["ID"]
    found = read_any_map(file(tmp_path, layout | {"family": "aruco5x5_1000", "size": 0.1524}))
    assert found.find(LandmarkId("aruco5x5_1000", code)).size_m == 0.1524
    for wrong in ({"family": "qr"}, {"size": -1}, {"size": 152.4}):
        with pytest.raises(InputError, match="unknown"):
            read_any_map(file(tmp_path, layout | wrong))


def test_a_tagslam_bodys_own_pose_is_applied(tmp_path):
    pose = {"position": {"x": 4.0, "y": 1.0, "z": 0.0}, "rotation": {"x": 0.0, "y": 0.0, "z": 1.5707963267948966}}
    body = {"is_static": True, "default_tag_size": 0.2, "pose": pose, "tags": [{"id": 4, "pose": TAG}]}
    moving = {"is_static": False, "default_tag_size": 0.2, "tags": [{"id": 9, "pose": TAG}]}
    found = read_any_map(file(tmp_path, {"bodies": [{"lab": body}, {"cart": moving}]}))
    assert len(found) == 1
    T = found.find(LandmarkId("tag36h11", 4)).T_map_landmark
    assert T.t == pytest.approx([4.0, 2.0, 1.5])
    assert T.R[:, 0] == pytest.approx([0, 1, 0])


def test_the_format_key_is_parsed_not_searched_for(tmp_path):
    """A file that only mentions a format, or states it last, has the format of its own key."""
    ours = yaml.safe_load(map_to_yaml(LANDMARKS))
    path = file(tmp_path, {key: ours[key] for key in ("landmarks", "frame", "format")} | {"bodies": []})
    with pytest.raises(InputError, match="bodies: unknown key"):
        read_any_map(path)
    layout = json.loads(map_to_wpilib(LANDMARKS, (8.0, 5.0)))
    found = read_any_map(file(tmp_path, layout | {"name": "lmkit-map/1 of TagSLAM bodies: fiducials"}))
    assert len(found) == len(LANDMARKS)
    with pytest.raises(InputError, match="format is 'lmkit-rig/1', expected 'lmkit-map/1'"):
        read_any_map(file(tmp_path, layout | {"format": "lmkit-rig/1"}))


def test_family_and_size_are_given_or_assumed_aloud(tmp_path):
    layout = json.loads(map_to_wpilib(LANDMARKS, (8.0, 5.0)))
    with pytest.warns(InputWarning) as said:
        read_any_map(file(tmp_path, layout))
    assert ["tag36h11 is assumed" in str(said[0].message), "165.1 mm is assumed" in str(said[1].message)] == [
        True
    ] * 2
    given = MarkerDefaults("aruco5x5_1000", 0.1524)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = read_any_map(file(tmp_path, layout), given)
        read_any_map(file(tmp_path, layout | {"family": "aruco5x5_1000", "size": 0.1524}), given)
    assert {(m.family, m.size_m) for m in found} == {("aruco5x5_1000", 0.1524)}
    for stated in ({"family": "tag36h11"}, {"size": 0.1651}):
        with pytest.raises(InputError, match="its markers are"):
            read_any_map(file(tmp_path, layout | stated), given)
    with pytest.raises(InputError, match=r"family tag16h5 has no code .*0 to 29"):
        read_any_map(file(tmp_path, layout), MarkerDefaults("tag16h5"))
    with pytest.raises(InputError, match="states the family and the size"):
        read_any_map(file(tmp_path, yaml.safe_load(map_to_yaml(LANDMARKS))), given)


def test_family_and_size_on_the_command_line_and_in_python(tmp_path):
    source = file(tmp_path, json.loads(map_to_wpilib(LANDMARKS, (8.0, 5.0))))
    options = ["--family", "aruco5x5_1000", "--size", "152.4mm"]
    done = run_command("convert", str(source), "--to", "map", "-o", str(tmp_path / "map.yaml"), *options)
    assert done.code == 0, done.err
    assert {(m.family, m.size_m) for m in lmkit.read_map(tmp_path / "map.yaml")} == {("aruco5x5_1000", 0.1524)}
    assert {m.family for m in lmkit.read_map(source, family="aruco5x5_1000", size="152.4mm")} == {"aruco5x5_1000"}
    (tmp_path / "readings.csv").write_text("time_s,code,range_m,bearing_rad\n0,1,2.0,0.1\n")
    done = run_command(
        "locate", "--readings", str(tmp_path / "readings.csv"), "--map", str(source), *options, "--json"
    )
    assert "assumed" not in done.err, done.err
    done = run_command("convert", str(source), "--to", "opencv", "-o", str(tmp_path / "rig.yml"), *options)
    assert (done.code, "for maps" in done.err) == (2, True)


def test_a_landmark_larger_than_a_building_is_refused(tmp_path):
    ours = yaml.safe_load(map_to_yaml(LANDMARKS))
    ours["landmarks"][0]["size_m"] = 1.8e307
    with pytest.raises(InputError, match=r"landmarks.*size_m"):
        read_any_map(file(tmp_path, ours))


@pytest.mark.parametrize("kind", ["wpilib", "tagslam"])
def test_files_that_name_no_family_take_one_and_say_so(tmp_path, monkeypatch, kind):
    monkeypatch.chdir(tmp_path)
    one = list(LANDMARKS)[:2]
    other = replace(one[1], id=LandmarkId("tag36h11", one[0].code))
    for name, some in (("one", one), ("two", [one[0], other])):
        (tmp_path / f"{name}.yaml").write_text(map_to_yaml(LandmarkMap(some)))
    answer = run_command("convert", "one.yaml", "--to", kind, "-o", "one.out")
    assert answer.code == 0 and "say that these are lm8" in answer.err
    answer = run_command("convert", "two.yaml", "--to", kind, "-o", "two.out")
    assert answer.code == 2 and "lm8, tag36h11" in answer.err
    assert not (tmp_path / "two.out").exists()


NOISE = {"position_noise": {"x": 0.01, "y": 0.02, "z": 0.03}, "rotation_noise": {"x": 0.1, "y": 0.2, "z": 0.3}}


def tagslam_tag(**pose):
    place = {"position": {"x": 1.0, "y": 0.0, "z": 1.0}, "rotation": {"x": 0.0, "y": 0.0, "z": np.pi / 2}}
    tag = {"id": 3, "size": 0.16, "pose": place | pose}
    return {"bodies": [{"wall": {"is_static": True, "type": "simple", "tags": [tag]}}]}


def test_noise_of_a_tagslam_tag_lies_along_its_own_axes(tmp_path):
    [tag] = read_any_map(file(tmp_path, tagslam_tag(**NOISE)), MarkerDefaults("tag36h11"))
    assert np.sqrt(np.diag(tag.covariance)) == pytest.approx([0.02, 0.01, 0.03, 0.2, 0.1, 0.3])
    (tmp_path / "again.yaml").write_text(map_to_tagslam(LandmarkMap([tag])))
    [again] = read_any_map(tmp_path / "again.yaml", MarkerDefaults("tag36h11"))
    assert again.covariance == pytest.approx(tag.covariance, abs=1e-12)


@pytest.mark.parametrize(
    "noise", [{"position_noise": NOISE["position_noise"]}, NOISE | {"rotation_noise": {"x": -1, "y": 0, "z": 0}}]
)
def test_noise_of_a_tagslam_tag_that_is_incomplete_or_negative_is_refused(tmp_path, noise):
    with pytest.raises(InputError, match="noise"):
        read_any_map(file(tmp_path, tagslam_tag(**noise)), MarkerDefaults("tag36h11"))


def scaled(factor, height=1.0):
    """The map with other lengths, and heights times ``height``."""
    scale = factor * np.array([1.0, 1.0, height])
    return LandmarkMap(
        replace(m, T_map_landmark=Pose("map", "landmark", m.T_map_landmark.R, scale * m.T_map_landmark.t))
        for m in LANDMARKS
    )


def test_a_map_in_millimeters_is_refused_and_what_may_be_meant_is_named(tmp_path):
    path = file(tmp_path, yaml.safe_load(map_to_yaml(scaled(1000))))
    with pytest.raises(InputError, match="are its lengths millimeters") as refused:
        read_any_map(path)
    assert refused.value.code == "implausible_map" and "1000" in refused.value.hint
    # A map in inches, and a wide yard with landmarks near the ground.
    for maybe in (scaled(39.37), scaled(1000, height=0.001)):
        with pytest.warns(InputWarning, match="inches or millimeters"):
            read_any_map(file(tmp_path, yaml.safe_load(map_to_yaml(maybe))))


def test_two_landmarks_in_one_place_are_named(tmp_path):
    first, second, *rest = LANDMARKS
    doubled = LandmarkMap([first, replace(second, T_map_landmark=first.T_map_landmark), *rest])
    with pytest.warns(InputWarning, match="overlap, 0 mm"):
        read_any_map(file(tmp_path, yaml.safe_load(map_to_yaml(doubled))))


@pytest.mark.parametrize(
    ("rotation", "is_read"), [("x: 0.6, y: 0, z: 0, w: 0.8", True), ("x: 90, y: 0, z: 0", False)]
)
def test_a_tagslam_rotation_may_be_a_quaternion_but_not_degrees(tmp_path, rotation, is_read):
    pose = f"pose: {{position: {{x: 1, y: 2, z: 3}}, rotation: {{{rotation}}}}}"
    path = tmp_path / "map"
    path.write_text(f"bodies:\n- a: {{is_static: true, tags: [{{id: 1, size: 0.16, {pose}}}]}}\n")
    defaults = MarkerDefaults("tag36h11")
    if is_read:
        assert np.allclose(next(iter(read_any_map(path, defaults))).T_map_landmark.quaternion_xyzw, [0.6, 0, 0, 0.8])
    else:
        with pytest.raises(InputError, match="degrees"):
            read_any_map(path, defaults)


def upright(code: int, heading: float) -> MappedLandmark:
    return MappedLandmark(LandmarkId("lm8", code), 0.18, wall_pose([code, 0.0, 1.5], heading))


def with_quaternions(markers, order) -> object:
    """Values of a map file whose quaternions are written in another order."""
    data = yaml.safe_load(map_to_yaml(LandmarkMap(markers)))
    for landmark in data["landmarks"]:
        landmark["quaternion"] = [landmark["quaternion"][k] for k in order]
    return data


@pytest.mark.parametrize("headings", [(0.0, np.pi / 2), (0.3, -1.2, 2.0, 0.9), (np.pi / 2, -np.pi / 2)])
def test_quaternions_with_w_first_are_named(tmp_path, headings):
    markers = [upright(code, heading) for code, heading in enumerate(headings)]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read_any_map(file(tmp_path, with_quaternions(markers, (0, 1, 2, 3))))
    with pytest.warns(InputWarning, match="read with w first"):
        read_any_map(file(tmp_path, with_quaternions(markers, (3, 0, 1, 2))))


@pytest.mark.parametrize("is_ceiling", [False, True])
def test_landmarks_on_floors_and_ceilings_are_no_reason_to_doubt(tmp_path, is_ceiling):
    """All turns by quarters, also those whose quaternions look like those of a wall."""
    down = Pose.from_rvec("map", "landmark", np.array([np.pi if is_ceiling else 0.0, 0.0, 0.0]), np.zeros(3)).R
    turns = [Pose.from_rvec("map", "landmark", np.array([0, 0, k * np.pi / 2]), np.zeros(3)).R for k in range(4)]
    poses = [Pose("map", "landmark", R @ down, np.array([k, 0.0, 0.0])) for k, R in enumerate(turns)]
    for some in (poses, poses[1::2]):
        markers = [MappedLandmark(LandmarkId("lm8", k), 0.18, T) for k, T in enumerate(some)]
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            read_any_map(file(tmp_path, with_quaternions(markers, (0, 1, 2, 3))))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("code,x,y,z,yaw\n1,1.0,2.0,1.5,90\n", "lmkit map"),
        ("tags:\n- {id: 1, position: [1, 2, 1.5]}\n", "not a map that is known: its keys are tags"),
    ],
)
def test_tables_and_other_lists_of_tags_are_no_maps(tmp_path, text, words):
    (tmp_path / "map").write_text(text)
    with pytest.raises(InputError) as refused:
        read_any_map(tmp_path / "map")
    assert words in str(refused.value)


def test_a_map_of_earlier_places_alone_is_named(tmp_path):
    data = with_quaternions([upright(1, 0.0)], (0, 1, 2, 3))
    data["landmarks"][0] |= {"valid_from": 0.0, "valid_to": 9.0}
    with pytest.warns(InputWarning, match="only earlier places"):
        read_any_map(file(tmp_path, data))


@pytest.mark.parametrize(
    ("directions", "is_doubted"),
    [
        ((1.5708, 3.14159, -1.5708), True),
        ((0, 1.571), True),
        ((0, 90, 180), False),
        ((0, 0, 0), False),
        ((1, 2, 3), False),
        ((2, 5, -1.57), False),
    ],
)
def test_directions_in_radians_in_a_form_are_doubted(tmp_path, directions, is_doubted):
    rows = [f"{k},{k},0,1.5,{angle}" for k, angle in enumerate(directions)]
    (tmp_path / "form.csv").write_text("\n".join(["code,x_m,y_m,height_m,facing_deg", *rows]))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        read_measured_map(tmp_path / "form.csv", [], FormDefaults("lm8"))
    assert ["are these radians" in str(w.message) for w in caught] == [True] * is_doubted


def test_a_form_in_millimeters_is_refused_like_the_map_it_would_give(tmp_path):
    rows = ["1,0,1000,1500,0", "2,4000,1000,1500,180", "3,2000,5000,1500,-90"]
    form = tmp_path / "form.csv"
    form.write_text("\n".join(["code,x_m,y_m,height_m,facing_deg", *rows]), encoding="utf-8")
    with pytest.raises(InputError, match="are its lengths millimeters"):
        read_measured_map(form, [], FormDefaults("lm8", 0.18))
