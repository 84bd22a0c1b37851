"""Each command with none, one and just enough of each input, and with damaged inputs: answered or refused."""

from __future__ import annotations

import json
import random
from pathlib import Path

import pytest
import yaml
from command_cases import CASES, run_harmed, run_unharmed, write_inputs
from command_line import run_command

QUICK = [case for case in CASES if case.files and not any(name.endswith((".png", ".pdf")) for name in case.files)]
TABLES = (".csv", ".tum")


@pytest.fixture(scope="module")
def inputs(tmp_path_factory) -> tuple[Path, dict[str, bytes]]:
    """A folder with a valid file of every kind but images, and the contents by name."""
    folder = tmp_path_factory.mktemp("inputs")
    write_inputs(folder, images=False)
    return folder, {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.fixture
def runnable(inputs, monkeypatch):
    """Cases whose files are there, in their folder."""
    monkeypatch.chdir(inputs[0])
    there = [case for case in QUICK if (inputs[0] / case.folder).is_dir()]
    return [case for case in there if all(name in inputs[1] for name in case.files)]


def few(name: str, data: bytes, count: int) -> bytes:
    """The first ``count`` rows, frames, landmarks or walls of a file."""
    text = data.decode()
    if name.endswith(TABLES):
        head, *rows = text.splitlines(keepends=True)
        if name.startswith(("detections", "readings")):
            times = list(dict.fromkeys(row.partition(",")[0] for row in rows))[:count]
            rows = [row for row in rows if row.partition(",")[0] in times]
            return "".join([head, *rows]).encode()
        return "".join([head, *rows[:count]] if name.endswith(".csv") else [head, *rows][:count]).encode()
    document = json.loads(text) if text.startswith("{") else yaml.safe_load(text)
    for key in ("landmarks", "walls", "tags", "body0"):
        if key in document:
            document[key] = document[key][:count]
    return json.dumps(document).encode()


def assert_clean(answer, what):
    assert answer.code in (0, 1, 2), (what, answer.err)
    assert "Traceback" not in answer.err, what
    assert "Warning:" not in answer.err, (what, answer.err)
    for line in answer.err.strip().splitlines():
        assert line.startswith("lmkit: "), (what, answer.err)
    if "--json" in what:
        for line in answer.out.splitlines():
            json.loads(line, parse_constant=pytest.fail)


@pytest.mark.slow
def test_unharmed_inputs_succeed(runnable, inputs):
    """Otherwise the answers to damaged inputs prove nothing."""
    for case in runnable:
        answer = run_unharmed(case, *inputs)
        assert answer.code == 0, (case.words, answer.err)


@pytest.mark.slow
@pytest.mark.parametrize("count", [0, 1, 2])
def test_few_of_each_input(runnable, inputs, count):
    folder, contents = inputs
    for case in runnable:
        for name in case.files:
            if not name.endswith((*TABLES, "map.yaml", "floor.yaml", ".json")):
                continue
            (folder / name).write_bytes(few(name, contents[name], count))
            try:
                answer = run_command(*case.words.split(), *(["--force"] if "-o" in case.words else []))
                assert_clean(answer, f"{case.words}: {count} of {name}")
            finally:
                (folder / name).write_bytes(contents[name])


@pytest.mark.parametrize(
    ("words", "name", "count", "code", "word"),
    [
        ("survey --readings", "readings.csv", 1, 0, ""),
        ("track --readings", "map.yaml", 3, 1, "no frame was located"),
        ("locate --readings", "map.yaml", 3, 1, "two landmarks"),
        ("track --detections", "map.yaml", 0, 2, "landmarks: contains nothing"),
        ("track --live --readings", "odometry.csv", 1, 2, "fewer than two rows"),
    ],
)
def test_just_too_few(runnable, inputs, words, name, count, code, word):
    folder, contents = inputs
    case = next(case for case in runnable if case.words.startswith(words))
    (folder / name).write_bytes(few(name, contents[name], count))
    try:
        answer = run_command(*case.words.split(), *(["--force"] if "-o" in case.words else []))
    finally:
        (folder / name).write_bytes(contents[name])
    assert (answer.code, word in answer.err) == (code, True), answer


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_harmed_inputs_are_answered_or_refused(runnable, inputs):
    rng = random.Random(1)
    for _ in range(30):
        case = rng.choice(runnable)
        assert_clean(*run_harmed(case, *inputs, rng))
