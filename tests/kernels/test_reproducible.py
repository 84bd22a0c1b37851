"""Equal images give equal bytes of JSON: in two runs, and with every variant of the kernels."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import cv2
import kernel_pairs
import numpy as np
import pytest
from scenes import paste_landmark

from lmkit.kernels import build, load

DETECT = "from lmkit.cli.main import main; main()"
# Numpy computes in double precision; if a step is just small enough to be the last one, numpy may take one more.
NUMPY_PX, STEP_PX = 1e-4, 1e-3


@pytest.fixture(scope="module")
def folder(photographs, tmp_path_factory) -> Path:
    """An image with five landmarks of different sizes."""
    folder = tmp_path_factory.mktemp("scene")
    image, rng = cv2.resize(photographs[0], (640, 480)), np.random.default_rng(3)
    for code, center, side, tilt in (
        (3, (110, 130), 70, 30),
        (52, (300, 130), 34, 20),
        (137, (480, 130), 24, 10),
        (9, (150, 350), 50, 55),
        (240, (420, 350), 110, 5),
    ):
        image, _ = paste_landmark(image, code, center, side, tilt, rng)
    cv2.imwrite(str(folder / "scene.png"), image)
    return folder


@pytest.fixture(scope="module")
def native(folder) -> str:
    """The answer of the library that is loaded by default."""
    return detect(folder, "")


def detect(folder: Path, kernels: str) -> str:
    """Standard output of the command."""
    return run([sys.executable, "-c", DETECT, "detect", "scene.png", "--json"], folder, kernels)


def run(command: list[str], folder: Path, kernels: str) -> str:
    """Standard output of a fresh process with that library."""
    environment = {**os.environ, load.SWITCH: kernels, "PYTHONPATH": str(Path(load.__file__).parents[2])}
    ended = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr
    return ended.stdout


def corners(answer: str) -> dict[str, np.ndarray]:
    return {found["id"]: np.array(found["corners"]) for found in json.loads(answer)["detections"]}


@pytest.mark.slow
def test_two_runs_write_the_same_bytes(folder, native):
    assert len(corners(native)) == 5
    assert detect(folder, "") == native


@pytest.mark.slow
def test_numpy_alone_finds_the_same_corners(folder, native):
    compiled, defined = corners(native), corners(detect(folder, "numpy"))
    assert compiled.keys() == defined.keys()
    off = sorted(np.abs(found - defined[key]).max() for key, found in compiled.items())
    assert off[-2] < NUMPY_PX and off[-1] < STEP_PX


@pytest.mark.slow(seconds=20)
@pytest.mark.skipif(next(build.compilers(), None) is None, reason="no C compiler here")
def test_the_baseline_writes_the_same_bytes_as_the_native_library(folder, native, tmp_path):
    """Without fused multiply-add and with lanes of fixed width, registers of any width sum in the same order.

    The baseline is the variant that differs most from the native library.  Every kernel gives the same bits on random
    and hostile arguments, so that what holds for the native library's kernels holds for the baseline's.
    """
    baseline = tmp_path / "baseline.so"
    build.compile_library(build.HERE, baseline, build.this_target().variants[0], build.this_target())
    assert detect(folder, str(baseline)) == native
    assert digests(str(baseline)) == digests("")


def digests(kernels: str) -> list[str]:
    """A line for each kernel with the digest of all that it returns."""
    program = [sys.executable, str(Path(kernel_pairs.__file__))]
    return run(program, Path(__file__).parent, kernels).splitlines()
