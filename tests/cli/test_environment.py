"""Full disks, closed streams and signals: one line or a clean end, and nothing half written."""

from __future__ import annotations

import resource
import subprocess
import sys

import pytest

from lmkit.io.landmark_map import map_to_yaml
from lmkit.simulation.recording import make_drive

RUN = [sys.executable, "-m", "lmkit"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("environment")
    (folder / "map.yaml").write_text(map_to_yaml(make_drive(1, seconds=2).landmarks))
    (folder / "poses.tum").write_text("".join(f"{k} {k} 0 0 0 0 0 1\n" for k in range(50)))
    return folder


def small_files():
    resource.setrlimit(resource.RLIMIT_FSIZE, (2048, 2048))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "output"),
    [("map map.yaml --plan out.png", "out.png"), ("convert poses.tum --to bag -o drive", "drive")],
)
def test_a_full_disk_leaves_nothing(folder, words, output):
    if "bag" in words:
        pytest.importorskip("rosbags", reason="the extra bags is not installed")
    before = set(folder.iterdir())
    done = subprocess.run(
        [*RUN, *words.split()], cwd=folder, preexec_fn=small_files, capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    assert output in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert set(folder.iterdir()) == before


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
