"""House rules: no heavy module is loaded early, and the docs name what exists."""

from __future__ import annotations

import ast
import importlib
import re
import subprocess
import sys
from functools import cache
from itertools import pairwise
from pathlib import Path

import pytest
import typer
from PIL import Image

import lmkit
from lmkit.cli.app import public_commands
from lmkit.cli.commands import COMMANDS, list_of_commands
from lmkit.cli.main import app
from lmkit.io.landmark_map import map_to_yaml
from lmkit.io.rig import rig_to_yaml
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import LandmarkMap, MappedLandmark, wall_pose
from lmkit.simulation.scene import make_rig

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "lmkit"

MODULES = sorted(p for p in PACKAGE.rglob("*.py") if p.name != "__init__.py")


@pytest.mark.parametrize("arguments", [["--help"], ["--version"], ["detect", "--help"]])
def test_help_loads_nothing_heavy(arguments):
    code = (
        "import sys\nfrom lmkit.cli import main\n"
        f"main.guarded(lambda: main.app({arguments!r}, standalone_mode=False), False)\n"
        "heavy = {'numpy', 'scipy', 'cv2', 'PIL', 'reportlab', 'yaml', 'pydantic', 'pypdfium2'} & set(sys.modules)\n"
        "sys.exit(f'loaded: {heavy}' if heavy else 0)\n"
    )
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr


def test_no_address_is_taken_of_an_array_that_nobody_holds():
    """A temporary array is freed before the kernel reads it: ``addresses(np.empty(3))``."""
    found = [
        f"{path.name}:{call.lineno}"
        for path in MODULES
        for call in ast.walk(ast.parse(path.read_text()))
        if isinstance(call, ast.Call) and isinstance(call.func, ast.Name) and call.func.id in ("address", "addresses")
        if any(isinstance(one, ast.Call | ast.BinOp) for one in call.args)
    ]
    assert not found


def test_reading_a_map_loads_no_scipy():
    """The import of this module takes longer than `lmkit locate` without it."""
    code = "import sys\nimport lmkit.io.external_maps\nsys.exit('scipy' in sys.modules)\n"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_detecting_and_locating_load_what_they_need(tmp_path):
    """Pydantic alone would take a quarter of `lmkit locate`."""
    left, right, rig, landmarks = (str(tmp_path / name) for name in ("left.png", "right.png", "rig.yaml", "map.yaml"))
    for image in (left, right):
        Image.new("RGB", (64, 48), "gray").save(image)
    Path(rig).write_text(rig_to_yaml(make_rig((64, 48), 60.0)))
    mounted = MappedLandmark(LandmarkId("lm8", 1), 0.18, wall_pose([4.0, 0.0, 1.2], 0.0))
    Path(landmarks).write_text(map_to_yaml(LandmarkMap([mounted])))
    heavy = {"pydantic", "scipy", "rich", "multiprocessing", "lmkit.detection.tag_detector"}
    for arguments, needed, not_needed in (
        (["detect", left], "lmkit.detection.detector", heavy | {"yaml", "lmkit.visualization"}),
        (["locate", left, right, "--rig", rig, "--map", landmarks], "lmkit.localization.absolute_pose", heavy),
    ):
        code = (
            "import sys\nfrom lmkit.cli import main\n"
            f"main.guarded(lambda: main.run_arguments({arguments!r}), False)\n"
            f"assert {needed!r} in sys.modules\nloaded = {not_needed!r} & set(sys.modules)\n"
            "sys.exit(f'loaded: {loaded}' if loaded else 0)\n"
        )
        ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
        assert ended.returncode == 0, ended.stderr


def test_the_list_of_commands_loads_no_typer():
    code = (
        "import sys\nfrom lmkit.cli import main\n"
        "assert main.run_arguments(['--help']) == 0\n"
        "sys.exit(sorted({'typer', 'numpy', 'traceback', 'inspect'} & set(sys.modules)) or 0)\n"
    )
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr


def test_the_list_of_commands_is_what_typer_would_print():
    command = typer.main.get_command(app)
    context = command.context_class(command, info_name="lmkit", **command.context_settings)
    # Typer lists groups last.
    assert sorted(list_of_commands().splitlines()) == sorted(command.get_help(context).splitlines())


def test_public_names_exist():
    for name in lmkit.__all__:
        assert getattr(lmkit, name) is not None


def test_every_command_is_in_the_readme():
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    for name in public_commands():
        assert f"lmkit {name}" in readme


@pytest.mark.parametrize("name", COMMANDS)
def test_the_list_of_commands_says_what_the_command_says(name):
    module = importlib.import_module(f"lmkit.cli.{name}")
    said = getattr(module, "HELP", None) or module.run.__doc__
    assert said.split("\n\n")[0].split(". ")[0].rstrip(".") == COMMANDS[name].rstrip(".")


def test_code_cites_pages_that_exist():
    for path in (*MODULES, ROOT / "pyproject.toml"):
        for page in re.findall(r"docs/[\w/.-]+\.md", path.read_text(encoding="utf-8")):
            assert (ROOT / page).is_file(), f"{path.name} cites {page}"


def test_code_cites_modules_that_exist():
    there = {path.name for path in (*PACKAGE.rglob("*.*"), *ROOT.glob("*.py"), *ROOT.glob("benchmarks/*.py"))}
    cited = {
        (str(path.relative_to(ROOT)), name)
        for path in MODULES
        for name in re.findall(r"`(?:[\w/]+/)?(\w+\.(?:py|c|h))`", path.read_text(encoding="utf-8"))
    }
    assert cited
    assert not {(path, name) for path, name in cited if name not in there}


def test_templates_are_found():
    from lmkit.io.template import load_template, templates_folder

    names = [path.stem for path in templates_folder().glob("*.toml")]
    assert {"a4", "letter"} <= set(names)
    assert all(load_template(name).name == name for name in names)


def test_no_text_asks_to_install_the_package_of_another_project():
    """The registry's package called lmkit is not ours (docs/decisions/0015-name.md)."""
    wrong = re.compile(
        r"(pip install|uv add|uv pip install|pipx install|uvx)\s+(-\S+\s+)*['\"]?lmkit\b(?!-landmarks)|lmkit\["
    )
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=False).stdout.split()
    texts = [
        ROOT / name for name in listed if Path(name).suffix in {".py", ".md", ".toml", ".yaml", ".ipynb", ".html"}
    ]
    for path in texts or [*PACKAGE.rglob("*.py"), *ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")]:
        if path == Path(__file__):
            continue
        found = wrong.search(path.read_text(encoding="utf-8"))
        assert found is None, f"{path.relative_to(ROOT)}: {found and found.group()}"


def test_no_statement_stands_below_one_that_leaves_its_block():
    leaving = ast.Return | ast.Raise | ast.Continue | ast.Break
    for path in MODULES:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            for block in (getattr(node, name, None) for name in ("body", "orelse", "finalbody")):
                below = [b for a, b in pairwise(block) if isinstance(a, leaving)] if isinstance(block, list) else []
                assert not below, f"{path.relative_to(ROOT)}:{below[0].lineno} is never reached"


@cache
def names_of(path: Path) -> set[str]:
    """Names that a module defines, assigns or imports."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            names.add(node.name)
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            names.add(node.id)
        elif isinstance(node, ast.ImportFrom | ast.Import):
            names |= {(alias.asname or alias.name).split(".")[0] for alias in node.names}
    return names


def test_scripts_import_names_that_exist():
    """No test runs benchmarks, tools and decisions: only their next user would notice a name that moved."""
    modules = {
        ".".join(p.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): p
        for p in PACKAGE.rglob("*.py")
    }
    for path in (p for folder in ("benchmarks", "tools", "docs") for p in (ROOT / folder).rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                own = {alias.name for alias in node.names if alias.name.startswith("lmkit.")}
                assert own <= modules.keys(), f"{path.name} imports {sorted(own - modules.keys())}"
            if not (isinstance(node, ast.ImportFrom) and (node.module or "").startswith("lmkit.")):
                continue
            assert node.module in modules, f"{path.name} imports {node.module}, which is not there"
            submodules = {alias.name for alias in node.names if f"{node.module}.{alias.name}" in modules}
            missing = {alias.name for alias in node.names} - submodules - names_of(modules[node.module])
            assert not missing, f"{path.name}: {node.module} has no {sorted(missing)}"
