"""A folder with one of each file that the examples of the public functions name."""

from __future__ import annotations

from pathlib import Path

import pytest
from shared_folders import written_once

from lmkit.demos.example_files import write_example_files


@pytest.fixture(scope="session")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder; copy it where a test writes."""
    return written_once(tmp_path_factory, "example_files", write_example_files)
