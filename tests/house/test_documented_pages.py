"""Links, images and Python code of the documentation."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import numpy as np
import pytest
from doc_pages import NOTEBOOKS, PAGES, ROOT, blocks_of, text_of

import lmkit
from lmkit.io.floor_plan import rectangular_room
from lmkit.io.measured_map import FormDefaults, read_measured_map

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


def test_every_benchmark_is_listed() -> None:
    listed = (ROOT / "benchmarks/README.md").read_text(encoding="utf-8")
    for path in (ROOT / "benchmarks").glob("*.py"):
        assert f"`{path.name}`" in listed, f"{path.name} is not in benchmarks/README.md"


def test_the_form_of_the_tutorial_gives_the_map_that_it_shows(tmp_path: Path) -> None:
    form, shown = [
        code for language, code in blocks_of(ROOT / "docs/real-room.md") if language == "text" and "1.504" in code
    ]
    (tmp_path / "form.csv").write_text(form, encoding="utf-8")
    landmarks = list(
        read_measured_map(
            tmp_path / "form.csv", rectangular_room(6.0, 4.0).walls, FormDefaults("lm8", sigma=(0.01, 0.02))
        )
    )
    assert len(landmarks) == 8
    for landmark in landmarks:
        x, y, z = landmark.T_map_landmark.t
        inward = [int(x < 0.01) - int(x > 5.99), int(y < 0.01) - int(y > 3.99), 0]
        np.testing.assert_allclose(landmark.T_map_landmark.R[:, 2], inward, atol=1e-9)
        line = f"{landmark.id}: x {x:.3f} y {y:.3f} z {z:.3f} m"
        assert line in shown or landmark.code > 1


def test_notebooks_are_stored_without_results() -> None:
    for path in NOTEBOOKS:
        assert '"outputs": []' in path.read_text(encoding="utf-8")
        assert '"output_type"' not in path.read_text(encoding="utf-8")
