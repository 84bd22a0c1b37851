"""The layers: every import goes to a lower row of the table in docs/architecture.md."""

from __future__ import annotations

import ast
import re
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "lmkit"
MODULES = sorted(p for p in PACKAGE.rglob("*.py") if p.name != "__init__.py")
AT_ROOT = 6  # loose modules beside the folders
CLI_LINES = 160  # a command parses, calls and prints


def read_rows() -> dict[str, int]:
    """Row number of every folder and loose module."""
    rows = {}
    for line in (ROOT / "docs/architecture.md").read_text(encoding="utf-8").splitlines():
        if found := re.match(r"\| (\d+) \| ([^|]+) \|", line):
            rows.update({name: int(found[1]) for name in re.findall(r"`(\w+)/?`", found[2])})
    return rows


ROWS = read_rows()


def imported(path: Path) -> set[str]:
    """Modules of lmkit that a file imports, at the top or inside functions."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module:
            assert node.level == 0, f"{path.name} has a relative import"
            found |= {node.module} if node.module.startswith("lmkit.") else set()
            found |= {f"lmkit.{a.name}" for a in node.names} if node.module == "lmkit" else set()
        elif isinstance(node, ast.Import):
            found |= {a.name for a in node.names if a.name.startswith("lmkit.")}
    return found


def test_imports_go_down() -> None:
    upward = []
    for path in MODULES:
        here = path.relative_to(PACKAGE).parts[0].removesuffix(".py")
        for module in imported(path) if here != "__main__" else ():
            there = module.split(".")[1]
            if there != here and ROWS[there] >= ROWS[here]:
                upward.append(f"{path}: {here} (row {ROWS[here]}) imports {module} (row {ROWS[there]})")
    assert not upward, "\n".join(upward)


def test_no_modules_import_each_other() -> None:
    graph = {".".join(path.relative_to(ROOT).with_suffix("").parts): imported(path) for path in MODULES}
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        pytest.fail(" <- ".join(error.args[1]))


def test_every_folder_stands_on_a_row() -> None:
    folders = {p.name for p in PACKAGE.iterdir() if (p / "__init__.py").exists()}
    loose = {p.stem for p in PACKAGE.glob("*.py")} - {"__init__", "__main__"}
    assert folders | loose <= set(ROWS)
    assert len(loose) <= AT_ROOT


def test_simulation_never_uses_detection() -> None:
    for path in (PACKAGE / "simulation").glob("*.py"):
        assert not any(module.startswith("lmkit.detection") for module in imported(path))


def test_commands_hold_no_product_logic() -> None:
    lengths = {p.name: len(p.read_text(encoding="utf-8").splitlines()) for p in (PACKAGE / "cli").glob("*.py")}
    assert not {name: lines for name, lines in lengths.items() if lines > CLI_LINES}


def test_the_architecture_page_names_what_exists() -> None:
    page = (ROOT / "docs/architecture.md").read_text(encoding="utf-8")
    named = re.findall(r"`([\w/]+(?:\.py|\.c|/))`", page.split("## Where to find things")[1])
    assert named
    folders = [ROOT, PACKAGE, PACKAGE / "api"]
    assert not [name for name in named if not any((folder / name).exists() for folder in folders)]
