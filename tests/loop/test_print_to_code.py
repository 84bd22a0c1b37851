"""Every code, from the PDF through a foreign rasterizer into a real photograph, and read back."""

from __future__ import annotations

import shutil
import subprocess

import cv2
import numpy as np
import pytest
from scenes import DPI, all_codes_pdf, paste_landmark, sheet_by_pdfium

from lmkit.detection.detector import detect_landmarks

GROUPS = 32


@pytest.mark.parametrize("group", [0, *(pytest.param(k, marks=pytest.mark.slow) for k in range(1, GROUPS))])
def test_every_code_reads_back_from_a_photograph(group, photographs):
    errors, wrong = [], []
    for code in range(group, 256, GROUPS):
        image, truth = _scene(code, photographs, sheet_by_pdfium)
        found = detect_landmarks(image)
        if [d.code for d in found] != [code]:
            wrong.append((code, [d.code for d in found]))
            continue
        errors.append(np.linalg.norm(found[0].corners - truth, axis=1).mean())
    assert not wrong
    assert np.median(errors) < 0.5


def test_poppler_and_pdfium_agree(photographs, tmp_path):
    if shutil.which("pdftoppm") is None:
        pytest.skip("pdftoppm (poppler-utils) is not installed")
    (tmp_path / "all.pdf").write_bytes(all_codes_pdf())
    errors = []
    for code in (0, 15, 137, 200, 255):
        page = str(code + 1)
        call = ["pdftoppm", "-r", str(DPI), "-f", page, "-l", page, "-png", "-singlefile", "all.pdf", f"page{code}"]
        subprocess.run(call, cwd=tmp_path, check=True)
        sheet = np.asarray(cv2.imread(str(tmp_path / f"page{code}.png")))
        image, truth = _scene(code, photographs, lambda _, sheet=sheet: sheet)
        found = detect_landmarks(image)
        assert [d.code for d in found] == [code]
        errors.append(np.linalg.norm(found[0].corners - truth, axis=1).mean())
    assert np.median(errors) < 0.5


def _scene(code, photographs, sheet):
    """A landmark of 40 to 200 px side, tilted up to 50 deg, blurred and noised, in a real photograph."""
    rng = np.random.default_rng(1000 + code)
    side = float(np.exp(rng.uniform(np.log(40), np.log(200))))
    image = photographs[code % len(photographs)]
    image = cv2.resize(image, (420, 320))
    center = np.array([210, 160]) + rng.uniform(-20, 20, 2)
    return paste_landmark(
        image, code, center, side, rng.uniform(0, 50), rng, rng.uniform(0.5, 1.2), rng.uniform(1, 5), sheet
    )
