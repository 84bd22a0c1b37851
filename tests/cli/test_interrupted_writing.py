"""A signal during the writing of a file: one line, and neither a half file nor a part of one."""

from __future__ import annotations

import os
import signal

import cv2
import numpy as np
import pytest
from bag_files import write_bag
from board_views import views
from command_cases import write_inputs
from command_line import run_command
from test_environment import WRITERS, names

from lmkit.cli import main
from lmkit.io import files
from lmkit.io.board_corners import SavedCorners, corners_to_json
from lmkit.model.board import BoardSpec
from lmkit.simulation.scene import make_rig

MOVED = "--detections detections.csv --rig rig.yaml"
ALL_WRITERS = {name: words for name, words in WRITERS.items() if name not in ("plan coverage", "plan route")} | {
    "calibrate": "calibrate --corners corners.json -o out.yaml --report out.html",
    "detect": "detect blank.png --csv out.csv",
    "detect --annotate": "detect blank.png --annotate out",
    "evaluate": "evaluate truth.tum truth2.tum --report out.html",
    "unbag": "unbag drive -o out",
    "map --plan": "map map.yaml --floor floor.yaml --plan out.png",
    "plan sheet": "plan sheet --map map.yaml --room 8x5m -o out.pdf",
    "rectify": "rectify blank.png blank2.png --rig rig.yaml -o out",
    "track --report": f"track {MOVED} --map map.yaml --report out.html",
    "convert a map": "convert map.yaml --to wpilib -o out.json",
    "convert to ros": "convert rig.yaml --to ros -o out",
}
SLOW = {
    "plan coverage": WRITERS["plan coverage"],
    "plan route": WRITERS["plan route"],
    "plan place": "plan place --floor floor.yaml --rig rig.yaml --map map.yaml --error 1m --no-prints --patience 0 "
    "-o out",
}
NUMBERS = {"SIGTERM": signal.SIGTERM, "SIGINT": signal.SIGINT}


@pytest.fixture(scope="module")
def inputs(tmp_path_factory):
    """One folder for all runs: no file may remain in it."""
    folder = tmp_path_factory.mktemp("inputs")
    write_inputs(folder, images=False)
    board = BoardSpec.parse("chessboard:9x6:25mm")
    saved = SavedCorners(board, (640, 480), tuple(views(8, 0.1)), ())
    (folder / "corners.json").write_text(corners_to_json(saved))
    for name in ("blank.png", "blank2.png"):
        cv2.imwrite(str(folder / name), np.full((480, 640, 3), 200, np.uint8))
    pytest.importorskip("rosbags", reason="the extra bags is not installed")
    write_bag(folder / "drive", make_rig(image_size=(64, 48)))
    return folder


@pytest.fixture(autouse=True)
def heard():
    """Signal handlers as on a terminal: a process in the background of a shell ignores SIGINT."""
    handlers = {number: signal.getsignal(number) for number in NUMBERS.values()}
    signal.signal(signal.SIGTERM, main._terminate)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    for number, handler in handlers.items():
        signal.signal(number, handler)


class _Cut:
    """A file that gets a signal while its first bytes are written."""

    def __init__(self, stream, number):
        self.stream, self.number = stream, number

    def __enter__(self):
        self.stream.__enter__()
        return self

    def __exit__(self, *error):
        return self.stream.__exit__(*error)

    def write(self, data):
        self.stream.write(data[: len(data) // 2])
        self.stream.flush()
        os.kill(os.getpid(), self.number)
        self.stream.write(data[len(data) // 2 :])


def interrupted(folder, words, number, monkeypatch):
    """Answer of a command that is sent a signal while it writes its first file, and what is new in the folder."""
    cut = []

    def opened(handle, mode):
        cut.append(handle)
        return _Cut(open(handle, mode), number)  # noqa: PTH123  (a handle)

    monkeypatch.chdir(folder)
    monkeypatch.setattr(files.os, "fdopen", opened)
    before = names(folder)
    try:
        answer = run_command(*words.split())
    finally:
        monkeypatch.undo()
    assert len(cut) == 1, answer.err
    return answer, names(folder) - before


@pytest.mark.parametrize("command", ALL_WRITERS)
def test_a_signal_while_a_file_is_written_leaves_nothing(inputs, command, monkeypatch):
    number = NUMBERS["SIGINT" if command in ("board", "track", "convert") else "SIGTERM"]
    answer, left = interrupted(inputs, ALL_WRITERS[command], number, monkeypatch)
    assert (answer.code, answer.err.splitlines()[-1], left) == (130, "lmkit: interrupted", set())


@pytest.mark.slow
@pytest.mark.parametrize("command", SLOW)
def test_a_signal_while_a_plan_is_written_leaves_nothing(inputs, command, monkeypatch):
    answer, left = interrupted(inputs, SLOW[command], signal.SIGTERM, monkeypatch)
    assert (answer.code, answer.err.splitlines()[-1], left) == (130, "lmkit: interrupted", set())


@pytest.mark.parametrize("number", NUMBERS.values(), ids=NUMBERS)
def test_a_signal_while_a_bag_is_written_leaves_nothing(inputs, number, monkeypatch):
    from rosbags.rosbag2 import Writer

    written = Writer.write

    def write(*arguments):
        written(*arguments)
        os.kill(os.getpid(), number)

    monkeypatch.setattr(Writer, "write", write)
    monkeypatch.chdir(inputs)
    before = names(inputs)
    answer = run_command("convert", "truth.tum", "--to", "bag", "-o", "bag")
    assert (answer.code, answer.err.splitlines()[-1]) == (130, "lmkit: interrupted")
    assert names(inputs) == before


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_a_kill_while_a_file_is_written_leaves_its_old_content(tmp_path, monkeypatch):
    """A file that is not finished has another name, and nobody can remove it."""
    path = tmp_path / "out.yaml"
    path.write_text("old")
    child = os.fork()
    if child == 0:
        files.os.fdopen = lambda handle, mode: _Cut(open(handle, mode), signal.SIGKILL)  # noqa: PTH123, SIM115
        try:
            files.write_file(path, "new content", force=True)
        finally:
            os._exit(0)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == -signal.SIGKILL
    assert path.read_text() == "old"
    assert [other.name[:10] for other in tmp_path.iterdir() if other != path] == [".out.yaml."]
