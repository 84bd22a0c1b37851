"""Image files of several cameras, grouped by name."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image

from lmkit.errors import InputError
from lmkit.io.image_groups import list_groups, list_pairs


def test_one_folder_is_not_two_cameras(tmp_path):
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        Image.fromarray(np.zeros((4, 4, 3), np.uint8)).save(tmp_path / name / "0.png")
    assert len(list_pairs(str(tmp_path / "a"), str(tmp_path / "b"))) == 1
    for sources in (["a", "a"], ["a", "b", "a"], ["a", "b/../a"]):
        with pytest.raises(InputError, match="two cameras"):
            list_groups([str(tmp_path / source) for source in sources])
