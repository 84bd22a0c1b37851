"""Libraries are built for this machine and chosen by content and processor; without one, numpy computes."""

from __future__ import annotations

import ast
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from lmkit.kernels import build, load

ROOT = Path(__file__).resolve().parents[2]
# Without optimization: at -O1 the checks of inlined blocks take a minute to compile.
SANITIZERS = ["-O0", "-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-g", "-Wall", "-Wextra", "-Werror"]
has_compiler = pytest.mark.skipif(next(build.compilers(), None) is None, reason="no C compiler here")


def kernels_copy(folder: Path) -> Path:
    """The files that every library contains, without the kernels; they compile quickly."""
    copy = folder / "kernels"
    copy.mkdir()
    for name in ("build.py", "cpu.c", "built.c", "cpu_features.h", "kernels.h"):
        shutil.copy(build.HERE / name, copy)
    return copy


def describe(monkeypatch, folder: Path, wanted: str = "") -> load.Loaded:
    """Variant that a fresh process would load from this folder."""
    monkeypatch.setattr(load, "HERE", folder)
    monkeypatch.setattr(load, "digest", lambda: build.digest(folder))
    monkeypatch.setenv(load.SWITCH, wanted)
    return load.loaded.__wrapped__()


def test_kernels_import_numpy_and_themselves_only():
    allowed = {"lmkit.kernels", "numpy", *sys.stdlib_module_names}
    for path in build.HERE.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            names += [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            for name in names:
                assert name.startswith("lmkit.kernels") or name.split(".")[0] in allowed, f"{path.name}: {name}"


def test_every_kernel_has_its_numpy_definition_beside_it():
    for path in build.sources():
        assert path.stem in {"cpu", "built"} or path.with_suffix(".py").is_file(), path.name


@has_compiler
def test_a_build_is_loaded_until_a_source_changes(tmp_path, monkeypatch):
    folder = kernels_copy(tmp_path)
    first = build.build_native(folder)
    assert describe(monkeypatch, folder).variant == "native"
    (folder / "cpu.c").write_text((folder / "cpu.c").read_text() + "\n/* changed */\n")
    with pytest.warns(RuntimeWarning, match="older than their sources"):
        assert describe(monkeypatch, folder).library is None
    second = build.build_native(folder)
    assert second.is_file() and not first.exists()
    assert describe(monkeypatch, folder).variant == "native"


def test_a_library_that_is_gone_is_reported_aloud(tmp_path, monkeypatch):
    folder = kernels_copy(tmp_path)
    with pytest.warns(RuntimeWarning, match=r"no compiled kernels.*python -m lmkit\.kernels\.build"):
        assert describe(monkeypatch, folder).library is None


def test_without_a_compiler_numpy_computes_and_the_reason_is_stated(tmp_path, monkeypatch):
    folder = kernels_copy(tmp_path)
    monkeypatch.setattr(build, "compilers", lambda: iter(()))
    with pytest.raises(build.BuildError, match="no compiler found"):
        build.build_native(folder)
    found = describe(monkeypatch, folder)
    assert found.library is None and found.reason.startswith("no compiler found")
    assert "pip install ziglang" in found.reason


@has_compiler
def test_a_library_for_another_processor_is_refused(tmp_path, monkeypatch):
    folder = kernels_copy(tmp_path)
    built = folder / "built.c"
    built.write_text(built.read_text().replace("lmkit_built_features = 0", "lmkit_built_features = 1u << 31"))
    build.build_native(folder)
    found = describe(monkeypatch, folder)
    assert found.library is None and "another processor" in found.reason
    with pytest.raises(ImportError, match="another processor"):
        describe(monkeypatch, folder, "native")


def test_the_switch_takes_numpy_and_refuses_what_is_not_here(tmp_path, monkeypatch):
    folder = kernels_copy(tmp_path)
    assert describe(monkeypatch, folder, "numpy").variant == "numpy"
    with pytest.raises(ImportError, match="v9"):
        describe(monkeypatch, folder, "v9")


def test_a_broken_library_is_reported_not_raised(tmp_path, monkeypatch):
    folder = kernels_copy(tmp_path)
    (folder / build.library_name("native", build.this_system(), build.digest(folder))).write_bytes(b"no library")
    found = describe(monkeypatch, folder)
    assert found.library is None and "cannot be loaded" in found.reason


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="the address sanitizer is preloaded on Linux only")
def test_sanitizers_find_nothing(tmp_path):
    """A library built with address and undefined-behavior checks runs every kernel on every hostile shape."""
    gcc = shutil.which("gcc")
    if gcc is None:
        pytest.skip("no gcc here")
    asan = subprocess.run([gcc, "-print-file-name=libasan.so"], capture_output=True, text=True, check=True)
    if not Path(asan.stdout.strip()).is_file():
        pytest.skip("gcc has no address sanitizer here")
    out = tmp_path / "sanitized.so"
    build.compile_library(build.HERE, out, "generic", build.this_target(), SANITIZERS)
    environment = {
        **os.environ,
        load.SWITCH: str(out),
        "LD_PRELOAD": asan.stdout.strip(),
        "ASAN_OPTIONS": "detect_leaks=0",
        "PYTHONPATH": str(ROOT),
    }
    program = [sys.executable, str(ROOT / "tests" / "kernel_pairs.py")]
    ended = subprocess.run(program, env=environment, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr[-3000:]
    assert "calls" in ended.stdout
