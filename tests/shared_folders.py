"""Folders of files that tests read: written once for all workers of a test run."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path

import pytest

LONGEST_S = 300.0


def written_once(factory: pytest.TempPathFactory, name: str, write: Callable[[Path], object]) -> Path:
    """The folder of that name; the first worker writes it, and the others wait until it is complete.

    Args:
        name: the same in all workers, and used for nothing else.
        write: writes into the folder.
    """
    base = factory.getbasetemp()
    root = base.parent if "PYTEST_XDIST_WORKER" in os.environ else base
    folder, done = root / name, root / f"{name}.done"
    try:
        folder.mkdir()
    except FileExistsError:
        until = time.monotonic() + LONGEST_S
        while not done.exists():
            assert time.monotonic() < until, f"the worker that writes {folder} did not end"
            time.sleep(0.05)
        return folder
    write(folder)
    done.touch()
    return folder
