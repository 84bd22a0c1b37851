"""Links, images and Python code of the documentation."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import numpy as np
import pytest
import yaml
from doc_pages import NOTEBOOKS, PAGES, ROOT, blocks_of, text_of

import lmkit

ALL = [pytest.param(path, id=str(path.relative_to(ROOT))) for path in [*PAGES, *NOTEBOOKS]]


@pytest.mark.parametrize("path", ALL)
def test_links_lead_somewhere(path: Path) -> None:
    for target, anchor in re.findall(r"\]\(([^)#:\s]*)(?:#([^)\s]*))?\)", text_of(path)):
        page = path.parent / target if target else path
        assert page.exists(), f"{target} does not exist"
        if anchor and page.suffix == ".md":
            titles = re.findall(r"^#+ (.+)$", page.read_text(encoding="utf-8"), re.MULTILINE)
            assert anchor in {slug(title) for title in titles}, f"{target}#{anchor} does not exist"


def slug(title: str) -> str:
    """Anchor of a heading, as GitHub and MyST make it."""
    return re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-")


@pytest.mark.parametrize("path", ALL)
def test_images_exist_and_say_what_they_show(path: Path) -> None:
    for alt, target in re.findall(r"!\[([^\]]*)\]\(([^)]+)\)", text_of(path)):
        assert (path.parent / target).is_file(), f"{target} does not exist"
        assert len(alt.split()) >= 5, f"{target}: alternative text {alt!r} is too short"


@pytest.mark.parametrize("path", ALL)
def test_python_code_names_what_exists(path: Path) -> None:
    for language, code in blocks_of(path):
        if language == "python":
            for node in ast.walk(ast.parse(code)):
                if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "lmkit":
                    assert node.attr in lmkit.__all__ or node.attr == "navigation", node.attr


def test_every_page_is_in_the_navigation() -> None:
    index = (ROOT / "docs/index.md").read_text(encoding="utf-8")
    for path in [*(ROOT / "docs").glob("*.md"), *NOTEBOOKS]:
        name = path.relative_to(ROOT / "docs").with_suffix("").as_posix()
        assert name == "index" or f"<{name}>" in index, f"{name} is not in docs/index.md"


def test_every_decision_is_listed() -> None:
    listed = (ROOT / "docs/decisions/README.md").read_text(encoding="utf-8")
    for path in (ROOT / "docs/decisions").glob("0*.md"):
        assert f"({path.name})" in listed, f"{path.name} is not in the table of decisions"


def test_the_map_of_the_tutorial_faces_into_the_room(tmp_path: Path) -> None:
    (text,) = [code for language, code in blocks_of(ROOT / "docs/real-room.md") if language == "yaml"]
    (tmp_path / "map.yaml").write_text(text, encoding="utf-8")
    landmarks = list(lmkit.read_map(tmp_path / "map.yaml"))
    assert len(landmarks) == 8
    for landmark in landmarks:
        x, y, _ = landmark.T_map_landmark.t
        inwards = [int(x == 0) - int(x == 6), int(y == 0) - int(y == 4), 0]
        np.testing.assert_allclose(landmark.T_map_landmark.R[:, 2], inwards, atol=1e-3)
        np.testing.assert_allclose(landmark.T_map_landmark.R[:, 1], [0, 0, 1], atol=1e-3)


@pytest.mark.parametrize(("facing", "quaternion"), [(0, [0.5] * 4), (90, [0, 0.7071, 0.7071, 0])])
def test_the_formula_of_the_tutorial(
    facing: int, quaternion: list[float], capsys: pytest.CaptureFixture[str]
) -> None:
    (code,) = [code for language, code in blocks_of(ROOT / "docs/real-room.md") if language == "python"]
    exec(code.replace("facing_deg = 225", f"facing_deg = {facing}"), {})
    assert yaml.safe_load(capsys.readouterr().out) == pytest.approx(quaternion)


def test_notebooks_are_stored_without_results() -> None:
    for path in NOTEBOOKS:
        assert '"outputs": []' in path.read_text(encoding="utf-8")
        assert '"output_type"' not in path.read_text(encoding="utf-8")
