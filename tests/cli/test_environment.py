"""Full disks, read-only folders, closed streams, signals and little memory: one line or a clean end, no half file."""

from __future__ import annotations

import contextlib
import os
import resource
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from command_cases import write_inputs
from command_line import Answer, run_command

from lmkit.io.landmark_map import map_to_yaml
from lmkit.simulation.recording import make_drive

RUN = [sys.executable, "-m", "lmkit"]
MOVED = "--detections detections.csv --rig rig.yaml --odometry odometry.csv"
# Every command that writes a file, with its cheapest input.
WRITERS = {
    "generate": "generate --code 3 -o out.pdf",
    "board": "board chessboard:9x6:20mm -o out.pdf",
    "track": f"track {MOVED} --map map.yaml --tum out.tum",
    "survey": f"survey {MOVED} -o out.yaml",
    "map": "map form.csv --room 8x5m -o out.yaml",
    "plan coverage": "plan coverage --floor floor.yaml --map map.yaml --rig rig.yaml --plan out.png",
    "plan route": "plan route 1,1 6,3 --floor floor.yaml --map map.yaml --rig rig.yaml --csv out.csv",
    "convert": "convert rig.yaml --to kalibr -o out.yaml",
    "simulate": "simulate --pairs 1 --boards 0 --landmarks 3 -o out",
}
SOON_S = 60.0  # on a busy machine
WORKING_S = 0.5  # CPU time after which a command has begun its work
ENDS = (signal.SIGTERM, signal.SIGINT, signal.SIGKILL)
READ_ONLY = Path("/sys/kernel")  # permissions make a folder read-only for everyone but root


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("environment")
    (folder / "map.yaml").write_text(map_to_yaml(make_drive(1, seconds=2).landmarks))
    (folder / "poses.tum").write_text("".join(f"{k} {k} 0 0 0 0 0 1\n" for k in range(50)))
    return folder


@pytest.fixture(scope="module")
def inputs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("inputs")
    write_inputs(folder, images=False)
    return folder


@pytest.fixture
def copied(inputs, tmp_path):
    """The input files in a folder of their own."""
    return Path(shutil.copytree(inputs, tmp_path / "work"))


def run(words, folder, **how):
    """Run a command in a process of its own, which takes seconds."""
    done = subprocess.run([*RUN, *words.split()], cwd=folder, capture_output=True, text=True, check=False, **how)
    return Answer(done.returncode, done.stdout, done.stderr)


def names(folder):
    return {path.name for path in folder.iterdir()}


def assert_one_line(done, code):
    assert done.code == code, done.err
    lines = [line for line in done.err.splitlines() if "warning" not in line and "may be lost" not in line]
    assert lines[-1].startswith("lmkit: "), done.err
    assert "Traceback" not in done.err and "internal error" not in done.err


@contextlib.contextmanager
def largest_file(count):
    """No file of this process grows beyond so many bytes; modules imported meanwhile are not cached, cut off."""
    limits, cached = resource.getrlimit(resource.RLIMIT_FSIZE), sys.dont_write_bytecode
    sys.dont_write_bytecode = True
    resource.setrlimit(resource.RLIMIT_FSIZE, (count, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        sys.dont_write_bytecode = cached


def few_handles():
    resource.setrlimit(resource.RLIMIT_NOFILE, (8, 8))


def sizes(folder, before):
    """Bytes of each new file by its path."""
    found = {path.relative_to(folder): path.stat().st_size for path in folder.rglob("*") if path.is_file()}
    return {path: size for path, size in found.items() if path.parts[0] not in before}


def test_a_bag_on_a_full_disk_leaves_nothing(folder, monkeypatch):
    pytest.importorskip("rosbags", reason="the extra bags is not installed")
    monkeypatch.chdir(folder)
    before = names(folder)
    with largest_file(2048):
        done = run_command("convert", "poses.tum", "--to", "bag", "-o", "drive")
    assert_one_line(done, 2)
    assert "drive" in done.err
    assert names(folder) == before


@pytest.mark.slow
@pytest.mark.parametrize("command", WRITERS)
def test_a_full_disk_leaves_nothing(copied, command, monkeypatch):
    monkeypatch.chdir(copied)
    before = names(copied)
    with largest_file(0):
        done = run_command(*WRITERS[command].split())
    assert_one_line(done, 2)
    assert sizes(copied, before) == {}


@pytest.mark.skipif(not READ_ONLY.is_dir(), reason="needs Linux")
@pytest.mark.parametrize("command", WRITERS)
def test_a_read_only_folder_is_refused_before_work_begins(inputs, command, monkeypatch):
    """No slow step is reached."""
    monkeypatch.chdir(inputs)
    words = [str(READ_ONLY / word) if word.startswith("out") else word for word in WRITERS[command].split()]
    begun = time.thread_time()
    done = run_command(*words)
    assert_one_line(done, 2)
    assert f"{READ_ONLY}" in done.err
    assert time.thread_time() - begun < SOON_S / 20


@pytest.mark.slow
@pytest.mark.parametrize("command", ["track", "convert"])
def test_few_file_handles_are_enough_or_end_in_one_line(copied, command):
    before = names(copied)
    done = run(WRITERS[command], copied, preexec_fn=few_handles)
    if done.code:
        assert_one_line(done, 2)
        assert names(copied) == before


@pytest.mark.slow
@pytest.mark.parametrize(
    ("command", "number"),
    [("board", signal.SIGKILL), ("track", signal.SIGTERM), *(("simulate", n) for n in ENDS)],
)
def test_signals_leave_all_or_nothing(copied, command, number, monkeypatch):
    monkeypatch.chdir(copied)
    before = names(copied)
    words = WRITERS[command].split()
    process = subprocess.Popen(
        [*RUN, *words],
        cwd=copied,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    # A command that writes one file gets the signal during its work; one that writes many, while it writes.
    end = time.monotonic() + SOON_S
    while process.poll() is None and time.monotonic() < end:
        if names(copied) - before or (command != "simulate" and cpu_s(process.pid) > WORKING_S):
            break
        time.sleep(0.005)
    process.send_signal(number)
    _, stated = process.communicate(timeout=SOON_S)
    # Before its first and after its last line, Python leaves signals to the system.
    assert process.returncode in (0, 130, -number, -signal.SIGINT), stated
    assert "internal error" not in stated
    left = sizes(copied, before)
    if number == signal.SIGKILL:  # an unfinished file has another name, and no process is left to remove it
        left = {path: size for path, size in left.items() if path.name[0] != "."}
    with pytest.raises(ProcessLookupError):
        os.killpg(process.pid, 0)
    for name in names(copied) - before:
        path = copied / name
        shutil.rmtree(path) if path.is_dir() else path.unlink()
    assert run_command(*words).code == 0
    whole = sizes(copied, before)
    # After an interruption, a folder of many files contains whole files only.
    assert left.items() <= whole.items()
    assert command == "simulate" or left in ({}, whole)


def cpu_s(pid):
    """CPU time that a process has used; 0 where it has ended."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


@pytest.mark.slow
def test_no_home_and_two_runs_on_one_output(copied):
    words = [*RUN, *WRITERS["convert"].split()]
    both = [
        subprocess.Popen(words, cwd=copied, env={"PATH": os.environ["PATH"]}, stderr=subprocess.PIPE, text=True)
        for _ in range(2)
    ]
    stated = [process.communicate(timeout=SOON_S)[1] for process in both]
    assert sorted({process.returncode for process in both}) in ([0], [0, 2]), stated
    assert not any("Traceback" in text for text in stated)
    assert not [name for name in names(copied) if name.startswith(".")]


@pytest.mark.slow
def test_calibration_with_little_memory_is_refused(folder):
    limit = 500 << 20
    done = run(
        "calibrate --corners none.json", folder,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (limit, limit)),
    )  # fmt: skip
    assert_one_line(done, 2)
    assert "1024 MiB of address space" in done.err


@pytest.mark.slow
@pytest.mark.parametrize(
    ("stdout", "code", "lines"),
    [("> /dev/full", 2, 1), (">&-", 0, 0), ("| head -1 > /dev/null; exit ${PIPESTATUS[0]}", 0, 0)],
)
def test_standard_output_that_is_full_or_closed(folder, stdout, code, lines):
    command = f"{sys.executable} -m lmkit map map.yaml {stdout}"
    done = subprocess.run(["bash", "-c", command], cwd=folder, capture_output=True, text=True, check=False)
    assert (done.returncode, len(done.stderr.splitlines())) == (code, lines), done.stderr


def test_a_name_that_is_too_long_is_refused_before_work_begins(lmkit, folder):
    answer = lmkit("convert", folder / "map.yaml", "--to", "wpilib", "-o", "9" * 400 + ".json")
    assert (answer.code, "File name too long" in answer.err) == (2, True)
