"""Wrong use: one line that says what, where and how to fix it; the right exit code; nothing half written."""

from __future__ import annotations

import os
from pathlib import Path

import cv2
import numpy as np
import pytest
from ids import lm8

from lmkit.errors import InputError
from lmkit.io.images import decode_image
from lmkit.io.landmark_map import map_to_yaml
from lmkit.io.rig import rig_to_yaml
from lmkit.model.landmark_map import LandmarkMap, MappedLandmark, wall_pose
from lmkit.simulation.scene import make_rig


def assert_refused(answer, *words, code=2):
    assert answer.code == code, answer
    lines = answer.err.strip().splitlines()
    assert len(lines) == 1, answer.err
    assert lines[0].startswith("lmkit: ")
    for word in words:
        assert str(word) in lines[0], lines[0]
    assert "Traceback" not in answer.err


def files(folder: Path) -> set[str]:
    return {str(p.relative_to(folder)) for p in folder.rglob("*")}


def saved_image(path: Path, size=(64, 48)) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    noise = np.random.default_rng(1).integers(0, 255, (size[1], size[0], 3), dtype=np.uint8)
    cv2.imwrite(str(path), noise)
    return path


@pytest.fixture
def rig(tmp_path) -> Path:
    path = tmp_path / "rig.yaml"
    path.write_text(rig_to_yaml(make_rig()))
    return path


@pytest.fixture
def landmark_map(tmp_path) -> Path:
    path = tmp_path / "map.yaml"
    landmarks = [MappedLandmark(lm8(3), 0.18, wall_pose([1, 0, 1], 1.0))]
    path.write_text(map_to_yaml(LandmarkMap(landmarks)))
    return path


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--code", "256"], ["256", "0 to 255"]),
        (["--code", "-1"], ["-1"]),
        (["--codes", "5-2"], ["5-2", "2-5"]),
        (["--codes", "1,x"], ["x"]),
        ([], ["--code"]),
        (["--code", "1", "--size", "180"], ["180", "unit"]),
        (["--code", "1", "--size", "9m"], ["9000", "sheets"]),
        (["--code", "1", "--template", "a4", "--size", "250mm"], ["250", "180 mm"]),
        (["--code", "1", "--size", "3mm"], ["3 mm", "5 mm"]),
        (["--code", "16", "--family", "lm4"], ["16", "0 to 15"]),
        (["--code", "1", "--family", "lm9"], ["lm9", "lm12"]),
        (["--code", "1", "--compensate", "150"], ["150", "100 %"]),
        (["--code", "1", "--compensate", "1x2x3"], ["WIDTHxHEIGHT"]),
        (["--code", "1", "--measured", "179"], ["--map"]),
        (["--code", "1", "--paper", "a5"], ["a5", "letter"]),
        (["--code", "1", "--text", "Room 1"], ["--text", "a4-door"]),
        (["--code", "1", "--template", "sticker-100", "--paper", "letter"], ["sticker-100", "130 x 140", "--paper"]),
        (["--code", "1", "--template", "a4-six", "--paper", "letter"], ["a4-six", "letter"]),
        (["--code", "1", "--bare", "--paper", "letter", "-o", "x.svg"], ["--bare", "--paper"]),
        (["--code", "1", "--bare", "--mirror", "-o", "x.svg"], ["--bare", "--mirror"]),
        (["--code", "1", "--cmyk", "-o", "x.png"], ["--cmyk"]),
        (["--code", "1", "--size", "0mm"], ["0mm"]),
        (["--code", "1", "-o", "x.gif"], ["x.gif", ".pdf"]),
        (["--code", "1", "--template", "a7"], ["a7", "letter"]),
        (["--code", "1", "--bare", "-o", "x.pdf"], ["--bare"]),
        (["--code", "1", "--dpi", "0", "-o", "x.png"], ["--dpi"]),
        (["--code", "1", "--dpi", "4800", "-o", "x.png"], ["4800", "--dpi"]),
        (["--code", "one"], ["--code"]),
        (["--color", "red"], ["--color"]),
    ],
)
def test_generate(lmkit, tmp_path, arguments, words):
    assert_refused(lmkit("generate", *arguments), *words)
    assert files(tmp_path) == set()


def test_no_command_shows_the_help(lmkit):
    answer = lmkit()
    assert answer.code == 2
    assert "Usage: lmkit" in answer.out
    assert "generate" in answer.out


def test_an_unknown_command(lmkit):
    assert_refused(lmkit("frobnicate"), "frobnicate")


def test_files_are_not_overwritten(lmkit, tmp_path):
    assert lmkit("generate", "--code", 1, "-o", "x.svg").code == 0
    (tmp_path / "x.svg").write_text("precious")
    assert_refused(lmkit("generate", "--code", 1, "-o", "x.svg"), "x.svg", "--force")
    assert (tmp_path / "x.svg").read_text() == "precious"
    assert lmkit("generate", "--code", 1, "-o", "x.svg", "--force").code == 0


def test_an_unwritable_folder(lmkit, tmp_path, monkeypatch):
    # Root can write to every folder, so the error of the system is simulated here.
    monkeypatch.setattr(os, "access", lambda path, mode: Path(path).name != "locked")
    (tmp_path / "locked").mkdir()
    assert_refused(lmkit("generate", "--code", 1, "-o", "locked/x.pdf"), "locked", "write")
    assert files(tmp_path) == {"locked"}


def test_a_file_in_the_place_of_a_folder(lmkit, tmp_path):
    (tmp_path / "plain").write_text("")
    assert_refused(lmkit("generate", "--code", 1, "-o", "plain/x.pdf"), "plain")


def test_a_bad_template(lmkit, tmp_path):
    (tmp_path / "mine.toml").write_text('format = "lmkit-template/1"\nname = "m"\npaper = "a4"\nmargin = 3\n')
    assert_refused(lmkit("generate", "--code", 1, "--template", "mine.toml"), "mine.toml")


def test_detect_names_a_missing_file(lmkit):
    assert_refused(lmkit("detect", "nowhere.png"), "nowhere.png")


def test_detect_names_half_a_jpeg_and_goes_on(lmkit, tmp_path):
    whole = saved_image(tmp_path / "a.jpg")
    (tmp_path / "b.jpg").write_bytes(whole.read_bytes()[:900])
    saved_image(tmp_path / "c.jpg")
    answer = lmkit("detect", tmp_path / "*.jpg", "--json")
    assert answer.code == 2
    lines = answer.out.strip().splitlines()
    assert len(lines) == 3
    assert "image_truncated" in lines[1]
    assert "detections" in lines[2]
    assert_refused(answer, "b.jpg", "cut off")


def test_detect_says_no_when_there_is_nothing(lmkit, tmp_path):
    assert_refused(lmkit("detect", saved_image(tmp_path / "a.png")), "no landmark", code=1)


def test_verify_says_no_when_there_is_nothing(lmkit, tmp_path):
    image = saved_image(tmp_path / "a.png")
    assert_refused(lmkit("verify", image), "a.png", "in color", "another family than lm8", code=1)
    of_tags = lmkit("verify", image, "--family", "tag36h11")
    assert_refused(of_tags, "another family than tag36h11", code=1)
    assert "color" not in of_tags.err


def test_verify_refuses_a_broken_pdf(lmkit, tmp_path):
    (tmp_path / "a.pdf").write_bytes(b"%PDF-1.4 nonsense")
    assert_refused(lmkit("verify", "a.pdf"), "a.pdf")


@pytest.mark.parametrize(
    "spec", ["chessboard", "charuco:8x6:30mm:22mm:DICT_9X9_1", "charuco:40x40:9mm:7mm:DICT_4X4_50"]
)
def test_board(lmkit, tmp_path, spec):
    assert_refused(lmkit("board", spec, "-o", "b.pdf"))
    assert files(tmp_path) == set()


@pytest.mark.slow
def test_calibrate_names_the_board_that_is_there(lmkit, data, tmp_path):
    root = data / "stereo" / "opencv_bouguet"
    answer = lmkit("calibrate", root / "left", root / "right", "--board", "chessboard:8x5:30mm", "-o", "rig.yaml")
    assert_refused(answer, "9x6", "8x5", "chessboard:9x6:30mm")
    assert files(tmp_path) == set()


@pytest.mark.slow
def test_calibrate_refuses_images_of_different_sizes_from_one_camera(lmkit, tmp_path):
    for k in range(3):
        saved_image(tmp_path / "l" / f"{k}.png")
        saved_image(tmp_path / "r" / f"{k}.png", (80, 48) if k == 2 else (64, 48))
    answer = lmkit("calibrate", "l", "r", "--board", "chessboard:9x6:30mm")
    assert_refused(answer, "80 x 48", "64 x 48")


def test_calibrate_refuses_what_does_not_pair(lmkit, tmp_path):
    saved_image(tmp_path / "l" / "door.png")
    saved_image(tmp_path / "r" / "0.png")
    saved_image(tmp_path / "r" / "1.png")
    assert_refused(lmkit("calibrate", "l", "r", "--board", "chessboard:9x6:30mm"), "1 left", "2 right")


def test_calibrate_refuses_an_empty_folder(lmkit, tmp_path):
    (tmp_path / "l").mkdir()
    assert_refused(lmkit("calibrate", "l", "r", "--board", "chessboard:9x6:30mm"), "no images")


def test_calibrate_refuses_one_folder_for_both_cameras(lmkit, tmp_path):
    saved_image(tmp_path / "l" / "0.png")
    assert_refused(lmkit("calibrate", "l", "l", "--board", "chessboard:9x6:30mm"), "both l")


@pytest.mark.slow
def test_calibrate_says_when_no_board_is_found(lmkit, tmp_path):
    for k in range(3):
        saved_image(tmp_path / "l" / f"{k}.png")
        saved_image(tmp_path / "r" / f"{k}.png")
    assert_refused(lmkit("calibrate", "l", "r", "--board", "chessboard:9x6:30mm"), "0 usable pairs")


@pytest.mark.parametrize(
    ("old", "new", "word"),
    [
        ("model: pinhole", "model: pinhole\n  zoom: 2", "zoom"),
        ("model: pinhole", "", "model"),
        ("[0.0, 0.0, 1.0]", "[.nan, 0.0, 1.0]", "nan"),
    ],
)
def test_locate_names_what_is_wrong_in_the_rig(lmkit, tmp_path, rig, landmark_map, old, new, word):
    rig.write_text(rig.read_text().replace(old, new, 1))
    image = saved_image(tmp_path / "a.png", (640, 480))
    assert_refused(lmkit("locate", image, image, "--rig", rig, "--map", landmark_map), "rig.yaml", word)


def test_locate_refuses_a_code_twice(lmkit, tmp_path, rig, landmark_map):
    text = landmark_map.read_text()
    entry = text[text.index("- code") :]
    landmark_map.write_text(text + entry)
    image = saved_image(tmp_path / "a.png", (640, 480))
    assert_refused(lmkit("locate", image, image, "--rig", rig, "--map", landmark_map), "map.yaml", "lm8:3", "twice")


def test_locate_refuses_images_of_another_size(lmkit, tmp_path, rig, landmark_map):
    image, other = saved_image(tmp_path / "a.png"), saved_image(tmp_path / "b.png")
    assert_refused(lmkit("locate", image, other, "--rig", rig, "--map", landmark_map), "64 x 48", "640 x 480")


def test_locate_says_no_when_it_sees_no_landmark(lmkit, tmp_path, rig, landmark_map):
    image, other = (saved_image(tmp_path / name, (640, 480)) for name in ("a.png", "b.png"))
    answer = lmkit("locate", image, other, "--rig", rig, "--map", landmark_map, "--json")
    assert_refused(answer, "no pose", code=1)
    assert '"status": "no_landmarks"' in answer.out


def test_locate_refuses_files_after_mono(lmkit, rig, landmark_map):
    """The shell turns `--mono *.png` into `--mono a.png b.png`."""
    for more in (["b.png"], ["b.png", "c.png"], ["b.png", "c.png", "d.png"]):
        answer = lmkit("locate", "--mono", "a.png", *more, "--rig", rig, "--map", landmark_map)
        assert_refused(answer, more[-1])


def test_locate_names_the_value_that_mono_lacks(lmkit, rig, landmark_map):
    answer = lmkit("locate", "a.png", "--mono", "--rig", rig, "--map", landmark_map)
    assert_refused(answer, "give --mono a.png")


def test_an_annotated_copy_never_replaces_the_image_itself(tmp_path):
    from lmkit.errors import InputError
    from lmkit.pipelines.annotated import AnnotatedFolder

    photo = tmp_path / "photo.jpg"
    photo.write_bytes(b"the only copy")
    with pytest.raises(InputError, match="replace the image itself"):
        AnnotatedFolder(tmp_path, force=True).add(str(photo), np.zeros((8, 8, 3), np.uint8))
    assert photo.read_bytes() == b"the only copy"


def test_an_annotated_video_appears_whole_or_not_at_all(tmp_path):
    from lmkit.errors import InputError
    from lmkit.pipelines.annotated import AnnotatedFolder

    frame = np.zeros((48, 64, 3), dtype=np.uint8)
    with pytest.raises(ZeroDivisionError), AnnotatedFolder(tmp_path / "out", False) as folder:
        folder.add("drive.avi#0", frame)
        raise ZeroDivisionError
    assert files(tmp_path / "out") == set()
    with AnnotatedFolder(tmp_path / "out", False) as folder:
        folder.add("drive.avi#0", frame)
        folder.add("a.png", frame)
        folder.add("a.jpg", frame)
    assert files(tmp_path / "out") == {"drive.mp4", "a.jpg", "a.jpg.jpg"}
    with pytest.raises(InputError, match="exists"), AnnotatedFolder(tmp_path / "out", False) as folder:
        folder.add("drive.avi#0", frame)


def test_one_video_is_annotated_into_the_file_that_is_named(tmp_path):
    from lmkit.errors import InputError
    from lmkit.pipelines.annotated import AnnotatedFolder

    frame = np.zeros((48, 64, 3), dtype=np.uint8)
    with AnnotatedFolder(tmp_path / "found.mp4", False) as drawn:
        drawn.add("drive.avi#0", frame)
    assert files(tmp_path) == {"found.mp4"}
    for more in ("other.avi#0", "a.png"):
        with pytest.raises(InputError, match="another file"), AnnotatedFolder(tmp_path / "found.mp4", True) as drawn:
            drawn.add("drive.avi#0", frame)
            drawn.add(more, frame)


@pytest.mark.parametrize(("times_s", "rate", "shown"), [
    ((0.0, 0.1, 0.2, 0.3), 10.0, 4),
    ((0.0, 0.2, 0.4, 0.6), 10.0, 7),  # the source lost every other frame
    ((0.5, 0.54, 0.74, 0.78), 25.0, 8),
])  # fmt: skip
def test_frames_of_an_annotated_video_keep_their_times(tmp_path, monkeypatch, times_s, rate, shown):
    from lmkit.pipelines import annotated

    class Source:
        """Video of 10 frames a second, as far as it says."""

        def __init__(self, _: str) -> None:
            self.at = -1

        def grab(self) -> bool:
            self.at += 1
            return self.at < len(times_s)

        def get(self, what: int) -> float:
            return 10.0 if what == cv2.CAP_PROP_FPS else 1000 * times_s[self.at]

        def release(self) -> None:
            pass

    frame = np.zeros((48, 64, 3), dtype=np.uint8)
    with monkeypatch.context() as patched:
        patched.setattr(annotated.cv2, "VideoCapture", Source)
        with annotated.AnnotatedFolder(tmp_path / "found.mp4", False) as drawn:
            for k, time_s in enumerate(times_s):
                drawn.add(f"phone.mp4#{k}", frame, time_s)
    written = cv2.VideoCapture(str(tmp_path / "found.mp4"))
    assert written.get(cv2.CAP_PROP_FPS) == pytest.approx(rate)
    assert written.get(cv2.CAP_PROP_FRAME_COUNT) == shown


def test_locate_needs_a_rig_and_a_map(lmkit):
    assert_refused(lmkit("locate", "a.png", "b.png"), "--rig")


@pytest.mark.parametrize("arguments", [["--pairs", "0"], ["--landmarks", "100"], ["--seed", "-1"]])
def test_simulate(lmkit, tmp_path, arguments):
    assert_refused(lmkit("simulate", "-o", "room", *arguments), arguments[0])
    assert files(tmp_path) == set()


@pytest.mark.parametrize("fault", [ZeroDivisionError, EOFError])
def test_an_internal_error_is_called_one(lmkit, monkeypatch, fault):
    """This includes the error that typer takes for the end of a dialog."""

    def fail(*_):
        raise fault

    monkeypatch.setattr("lmkit.model.codewords.parse_codes", fail)
    assert_refused(lmkit("generate", "--code", 1), "internal error (please report)", "--debug", code=70)


@pytest.mark.parametrize("source", ["camera:", "camera:front"])
def test_detect_a_camera_without_a_number(lmkit, source):
    assert_refused(lmkit("detect", source), source, "camera:0")


def test_detect_says_when_there_is_no_color(lmkit, tmp_path):
    path = tmp_path / "gray.png"
    cv2.imwrite(str(path), np.full((60, 80), 90, dtype=np.uint8))
    answer = lmkit("detect", str(path))
    assert answer.code == 1
    assert "no color" in answer.err


def test_the_readings_scatter_is_an_angle_and_a_length(lmkit, tmp_path, landmark_map):
    (tmp_path / "r.csv").write_text("time_s,code,range_m,bearing_rad\n0,1,2.0,0.1\n")
    start = ("locate", "--readings", "r.csv", "--map", landmark_map)
    assert_refused(lmkit(*start, "--bearing-sigma", "0"), "--bearing-sigma")
    assert_refused(lmkit(*start, "--range-sigma", "3"), "--range-sigma", "unit")


def test_nothing_is_written_where_one_print_does_not_read(lmkit, tmp_path, monkeypatch):
    from lmkit.errors import LmkitError
    from lmkit.pipelines import prints

    def refuse_code_2(pdf, pages):
        if any(face.code == 2 for page in pages for face in page.faces):
            raise LmkitError("proof_failed", "page 1: code 2 does not read", "nothing was written")

    monkeypatch.setattr(prints, "prove_pages", refuse_code_2)
    assert_refused(lmkit("generate", "--codes", "1-3", "-o", "x.svg"), "code 2", code=70)
    assert files(tmp_path) == set()


LONG = "x" * 300


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["map", "."], [". is a folder, not a map file"]),
        (["map", "map.yaml", "--floor", ".", "--plan", "p.svg"], [". is a folder, not a floor plan"]),
        (["map", "map.yaml", "--floor", "plan.png", "--plan", "p.svg"], ["plan.png", "No such file"]),
        (["evaluate", os.devnull, "map.yaml"], [os.devnull, "device", "not a trajectory"]),
        (["map", "map.yaml", "-o", "-"], ["standard output", "give a file name"]),
        (["generate", "--code", "1", "--bare", "-o", f"{os.devnull}", "--force"], [os.devnull]),
        (["map", "map.yaml", "-o", os.devnull, "--force"], [os.devnull, "device"]),
        (["map", "map.yaml", "-o", "map.yaml/x.yaml"], ["map.yaml is not a folder"]),
        (
            ["locate", "--rig", "r", "--map", "m", "a", "--tum", "x.txt", "--csv", "x.txt"],
            ["--tum and --csv", "x.txt"],
        ),
        (["convert", ".", "--to", "opencv", "-o", "x.yml"], ["folder without left.yaml", "give the rig file"]),
        (["detect", ""], ["empty"]),
        (["detect", "map.yaml", "--csv", "map.yaml", "--force"], ["--csv map.yaml", ".csv"]),
        (["evaluate", "a", "b", "--report", "r.pdf"], ["--report r.pdf", ".html"]),
        (["survey", "--output", "map.png"], ["--output map.png", ".yaml"]),
        (["generate", "--code", "3", "--measured", "179", "--map", "map.yaml", "-o", "x.pdf"], ["x.pdf", ".yaml"]),
        (["generate", "--code", "3", "--measured", "17.9", "--map", "map.yaml"], ["17.9 mm", "180 mm", "lm8:3"]),
        (["map", "--room", "4x3m", "--room", "5x3m", "map.yaml"], ["--room", "twice"]),
        (["board", "chessboard:9x6:20mm", "-o", "b.png", "--dpi", "nan"], ["--dpi nan"]),
        (["board", "chessboard:9x6:25m", "-o", "b.pdf"], ["25m", "0.5 to 2000 mm"]),
        (["detect", "map.yaml", "--annotate", "d.csv"], ["--annotate d.csv", "folder"]),
        (["locate", "a", "b", "--rig", "r", "--map", "m", "--heading", "500"], ["--heading '500'"]),
        (["survey", "--rig", "map.yaml", "-o", "map.yaml", "--force"], ["--output and --rig", "map.yaml"]),
        (["run", "sim:", "--seconds", "nan", "--check"], ["--seconds nan"]),
        (
            ["run", "camera:0", "camera:1", "--rig", "map.yaml", "--map", "map.yaml", "--check"],
            ["map.yaml", "lmkit-rig/1"],
        ),
        (["detect", LONG], [LONG, "too long"]),
        (["generate", "--code", "1", "--template", LONG], [LONG, "too long"]),
    ],
)
def test_a_path_that_cannot_be_what_is_wanted(lmkit, tmp_path, landmark_map, arguments, words):
    assert_refused(lmkit(*arguments), *words)
    assert files(tmp_path) == {"map.yaml"}


def test_no_table_of_images_that_cannot_be_read(lmkit, tmp_path):
    (tmp_path / "a.png").write_bytes(b"")
    assert_refused(lmkit("detect", "a.png", "--csv", "d.csv"), "a.png", "empty")
    assert files(tmp_path) == {"a.png"}


def test_files_are_written_all_or_none(tmp_path):
    from lmkit.errors import InputError
    from lmkit.io.files import write_files

    with pytest.raises(InputError, match="/proc/x"):
        write_files({tmp_path / "new" / "a.txt": "a", Path("/proc/x"): "b"})
    assert files(tmp_path) == set()
    longest = tmp_path / ("a" * 251 + ".txt")
    write_files({longest: "a"})
    assert longest.read_text() == "a"


def test_a_simulated_room_overwrites_no_rig(lmkit, tmp_path, rig):
    """Before, the images were written before the command found that the rig exists."""
    assert_refused(lmkit("simulate", "-o", ".", "--pairs", "1"), "rig.yaml exists already")
    assert files(tmp_path) == {"rig.yaml"}


def test_a_file_name_that_is_no_text(tmp_path):
    from lmkit.io.files import write_file

    write_file(tmp_path / "d.csv", os.fsdecode(b"l\xe9.png,1"))
    assert (tmp_path / "d.csv").read_text() == "l\\udce9.png,1"


@pytest.mark.parametrize("command", [("map",), ("plan", "coverage")])
def test_a_usage_error_names_the_help_of_its_command(lmkit, command):
    assert_refused(lmkit(*command), f"see lmkit {' '.join(command)} --help")


@pytest.mark.parametrize("command", ["detect", "verify"])
@pytest.mark.parametrize("name", ["out.png", "out.mp4"])
def test_a_folder_for_annotations_named_as_a_file_is_refused(lmkit, tmp_path, command, name):
    image = saved_image(tmp_path / "a.png")
    assert_refused(lmkit(command, image, "--annotate", name), f"--annotate {name}", "folder")
    assert not (tmp_path / name).exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["convert", "rig.yaml", "-o", "x.yaml"], ["'--to'", "Output format: lmkit, opencv, ros or kalibr"]),
        (["plan", "coverage"], ["'--floor'", "Floor plan: lmkit-floor/1", "see lmkit plan coverage --help"]),
        (["evaluate"], ["'TRUTH'", "True trajectory: TUM"]),
        (
            ["track", "--map", "map.yaml", "-o", "drive.tum"],
            ["-o", "writes files with --tum, --csv, --plan, --report"],
        ),
        (["plan", "route", "1,1", "2,2", "--output", "route.png"], ["--output", "--plan, --csv, --tum"]),
        (["doctor", "-o", "x"], ["No such option: -o; see"]),
        (["plan", "coverage", "-o", "x"], ["cannot write x", ".png or .svg"]),
        (["plan", "coverage", "-o", "x.csv"], ["cannot write x.csv", ".png or .svg"]),
        (["survey", "-o", "map.png"], ["--output map.png", ".yaml"]),
        (["locate", "--rig", "l.yaml", "--rig", "r.yaml"], ["--rig is given twice", "left.yaml and right.yaml"]),
        (["convert", "a.yaml", "b.yaml", "c.yaml", "--to", "ros", "-o", "x"], ["one file is converted at a time"]),
        (["convert", "a.yaml", "b.yaml", "--to", "map", "-o", "x"], ["one file is converted at a time"]),
    ],
)
def test_missing_options_are_explained_and_outputs_are_named(lmkit, arguments, words):
    assert_refused(lmkit(*arguments), *words)


def test_a_video_on_standard_input_asks_for_its_file_name():
    with pytest.raises(InputError, match="a video, not an image"):
        decode_image(b"\0\0\0\x1cftypisom\0\0\2\0", "-")
