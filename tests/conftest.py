"""Fixtures that the tests share: the folder of real data, real photographs, and the command line in process."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

# As the command line does: threads of the linear algebra library slow small problems down.
for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

import cv2
import numpy as np
import pytest
from command_line import Answer
from hypothesis import HealthCheck, settings

from lmkit.arrays import ByteArray

cv2.setNumThreads(1)
# A law also holds on a slow machine, and its examples are the same in every run.
# `pytest --hypothesis-profile=default` tries others.
settings.register_profile("lmkit", deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("lmkit")
DATA = Path(__file__).resolve().parents[2] / "shared" / "data"


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Run long tests first: a long test at the end would leave the other processor idle."""

    def seconds(item: pytest.Item) -> float:
        slow = item.get_closest_marker("slow")
        return float(slow.kwargs.get("seconds", 1)) if slow else 0.0

    items.sort(key=seconds, reverse=True)


@pytest.fixture(scope="session")
def data() -> Path:
    """The folder of real data made by others; the test is skipped if it is missing."""
    if not DATA.is_dir():
        pytest.skip("the folder of real data (../shared/data) is not here")
    return DATA


@pytest.fixture(scope="session")
def photographs() -> list[ByteArray]:
    """Real photographs without landmarks: those of the data folder, otherwise those that scikit-image ships."""
    files = sorted((DATA / "photos").glob("*.jpg"))
    if files:
        return [np.asarray(cv2.imread(str(file))) for file in files]
    import skimage.data

    shipped = [skimage.data.astronaut(), skimage.data.coffee(), skimage.data.chelsea()]
    return [np.ascontiguousarray(image[:, :, ::-1]) for image in shipped]


@pytest.fixture
def lmkit(
    capfd: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Callable[..., Answer]:
    """Runs the command line in process, in an empty folder."""
    from lmkit.cli import main

    monkeypatch.chdir(tmp_path)

    def run(*arguments: object) -> Answer:
        words = [str(a) for a in arguments]
        code = main.guarded(lambda: main.run_arguments(words), debug=False)
        printed = capfd.readouterr()
        return Answer(code, printed.out, printed.err)

    return run
