"""The house: imports go down, nothing heavy is loaded early, the docs name what exists."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

import lmkit
from lmkit.cli.main import public_commands

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "lmkit"

# docs/architecture.md tells why.  A module may import from lower floors and from its own folder.
FLOORS = [
    {"errors", "arrays", "version"},
    {"units", "workers", "html_page"},
    {"model"},
    {"formats"},
    {"chain", "motion"},
    {"pose_motion"},
    {"generate", "detect", "calibrate", "locate", "evaluate", "overlay", "room_plan"},
    {"floor_picture"},
    {
        "survey",
        "verify",
        "simulate",
        "drive_pictures",
        "board_pairs",
        "landmark_pairs",
        "detect_batch",
        "locate_batch",
        "installation",
    },
    {"track", "plan", "picture_eyes"},
    {"navigate", "drive_report", "drive_recording"},
    {"board_capture", "demo", "demo_drive", "demo_navigate"},
    {"cli"},
]


def room(module: str) -> str:
    return module.split(".")[1] if "." in module else ""


def floor(name: str) -> int:
    return next(number for number, rooms in enumerate(FLOORS) if name in rooms)


def imports(path: Path) -> set[str]:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("lmkit."):
            found.add(node.module)
    return found


MODULES = sorted(p for p in PACKAGE.rglob("*.py") if p.name != "__init__.py")


@pytest.mark.parametrize("path", MODULES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_imports_go_down(path):
    here = path.relative_to(PACKAGE).parts[0].removesuffix(".py")
    for module in imports(path):
        there = room(module)
        assert there == here or floor(there) < floor(here), f"{here} imports {module}"


def test_simulation_never_uses_detection():
    for path in (PACKAGE / "simulate").glob("*.py"):
        assert not any(room(module) == "detect" for module in imports(path))


@pytest.mark.parametrize("arguments", [["--help"], ["--version"], ["detect", "--help"]])
def test_help_loads_nothing_heavy(arguments):
    code = (
        "import sys\nfrom lmkit.cli import main\n"
        f"main.guarded(lambda: main.app({arguments!r}, standalone_mode=False), False)\n"
        # Typer itself loads pydantic once a command has parameters.
        "heavy = {'numpy', 'scipy', 'cv2', 'PIL', 'reportlab', 'yaml', 'pypdfium2'} & set(sys.modules)\n"
        "sys.exit(f'loaded: {heavy}' if heavy else 0)\n"
    )
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr


def test_public_names_exist():
    for name in lmkit.__all__:
        assert getattr(lmkit, name) is not None


def test_every_command_is_in_the_readme():
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    for name in public_commands():
        assert f"lmkit {name}" in readme


def test_links_of_the_docs_lead_somewhere():
    for page in [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")]:
        for target in re.findall(r"\]\(([^)#:]+?)(?:#[^)]*)?\)", page.read_text(encoding="utf-8")):
            assert (page.parent / target).exists(), f"{page.name} links to {target}"


def test_code_cites_pages_that_exist():
    for path in MODULES:
        for page in re.findall(r"docs/[\w/.-]+\.md", path.read_text(encoding="utf-8")):
            assert (ROOT / page).is_file(), f"{path.name} cites {page}"


def test_templates_are_found():
    from lmkit.formats.template import load_template, templates_folder

    names = [path.stem for path in templates_folder().glob("*.toml")]
    assert {"a4", "letter"} <= set(names)
    assert all(load_template(name).name == name for name in names)
