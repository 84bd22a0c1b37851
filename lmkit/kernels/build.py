"""Compiles ``lmkit/kernels/*.c`` into one shared library for each processor variant.

``python -m lmkit.kernels.build`` compiles for this machine, into the package folder.  The build hook
(``hatch_build.py``) loads this file by its path before lmkit or numpy are installed, so it needs the standard
library only.  The compiler is ``$CC``, else cc, gcc or clang on the PATH, else ``ziglang`` from the package index.
Microsoft's cl is not used: it knows neither ``restrict`` nor the vector pragmas.
"""

from __future__ import annotations

import hashlib
import os
import platform
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

HERE = Path(__file__).resolve().parent
LOG = "build-failure.txt"  # why no library was built, for `lmkit doctor`
ZIGLANG = "ziglang>=0.13"
ZIGLANG_MACHINES = {"x86_64", "amd64", "arm64", "aarch64"}

# No -ffast-math: NaN must stay NaN, and sums keep their order, so that a library gives the same bits in every run.
# Without errno and floating-point traps, sqrt, floor and selections become vector instructions.
# No fused multiply-add, because not every processor has it: all variants give the same bits, in 5 % more time.
# -fopenmp-simd vectorizes the loops marked `#pragma omp simd`; no OpenMP runtime is linked, and no thread is started.
FLAGS = ["-std=c11", "-O3", "-fno-math-errno", "-fno-trapping-math", "-ffp-contract=off", "-fopenmp-simd"]
_X86_V2 = ["-mssse3", "-msse4.1", "-msse4.2", "-mpopcnt", "-mcx16"]
_X86_V3 = [*_X86_V2, "-mavx", "-mavx2", "-mfma", "-mf16c", "-mbmi", "-mbmi2", "-mlzcnt", "-mmovbe"]
_X86_V4 = [*_X86_V3, "-mavx512f", "-mavx512cd", "-mavx512bw", "-mavx512dq", "-mavx512vl"]
# Feature flags instead of -march=x86-64-v3, which GCC 10 does not know.
VARIANT_FLAGS = {"v2": _X86_V2, "v3": _X86_V3, "v4": _X86_V4}


class BuildError(Exception):
    """No library was built; the message states the reason in one line."""


@dataclass(frozen=True)
class Target:
    """A platform that wheels are built for.

    Attributes:
        system: linux, macos or windows.
        variants: names of the libraries in the wheel, the baseline first.
        zig: target triple for ``zig cc``; empty means this machine.
        wheel_tag: platform tag of the wheel; empty means this machine's.
    """

    system: str
    variants: tuple[str, ...]
    zig: str = ""
    wheel_tag: str = ""


X86 = ("v2", "v3", "v4")
TARGETS = {
    "linux-x86_64": Target("linux", X86, "x86_64-linux-gnu.2.17", "manylinux_2_17_x86_64.manylinux2014_x86_64"),
    "linux-arm64": Target(
        "linux", ("arm64",), "aarch64-linux-gnu.2.17", "manylinux_2_17_aarch64.manylinux2014_aarch64"
    ),
    "macos-x86_64": Target("macos", X86, "x86_64-macos.10.15", "macosx_10_15_x86_64"),
    "macos-arm64": Target("macos", ("arm64",), "aarch64-macos.11.0", "macosx_11_0_arm64"),
    "windows-x86_64": Target("windows", X86, "x86_64-windows-gnu", "win_amd64"),
}


@dataclass(frozen=True)
class Compiler:
    """A command that compiles C, and whether it is ``zig cc``."""

    command: tuple[str, ...]
    is_zig: bool = False


def this_system() -> str:
    """linux, macos or windows (other systems count as linux: they load .so files)."""
    return {"darwin": "macos", "win32": "windows"}.get(sys.platform, "linux")


def this_target() -> Target:
    """Variants that a wheel for this machine holds."""
    machine = platform.machine().lower()
    if machine in {"x86_64", "amd64"}:
        return Target(this_system(), X86)
    return Target(this_system(), ("arm64",) if machine in {"arm64", "aarch64"} else ("generic",))


def sources(folder: Path = HERE) -> list[Path]:
    """C files that make up the library, sorted by name."""
    return sorted(folder.glob("*.c"))


def digest(folder: Path = HERE) -> str:
    """Twelve hex digits of all C files, headers and this file: part of the library's name, checked at load."""
    total = hashlib.sha256()
    for path in [*sources(folder), *sorted(folder.glob("*.h")), folder / "build.py"]:
        total.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
    return total.hexdigest()[:12]


def library_name(variant: str, system: str, content: str) -> str:
    """File name of a library; ``content`` is :func:`digest`."""
    return f"_kernels-{variant}-{content}.{ {'windows': 'dll', 'macos': 'dylib'}.get(system, 'so') }"


def compilers() -> Iterator[Compiler]:
    """Compilers of this machine that produce a library, best first; ``ziglang`` last."""
    yield from filter(_works, _system_compilers())
    if has_ziglang():
        yield Compiler((sys.executable, "-m", "ziglang", "cc"), is_zig=True)


def has_ziglang() -> bool:
    """True if the package ``ziglang`` is installed."""
    import importlib.util

    return importlib.util.find_spec("ziglang") is not None


def needs_ziglang() -> bool:
    """True if no compiler of the system works and ``ziglang`` has a wheel for this machine."""
    has_wheel = platform.machine().lower() in ZIGLANG_MACHINES and sys.platform in {"linux", "darwin", "win32"}
    return has_wheel and not any(map(_works, _system_compilers()))


def build_native(folder: Path = HERE) -> Path:
    """Compile for this machine, in place, and remove libraries of older sources.

    Raises:
        BuildError: no compiler works; the folder then holds the reason for `lmkit doctor`.
    """
    system, content = this_system(), digest(folder)
    out = folder / library_name("native", system, content)
    try:
        compile_library(folder, out, "native", this_target())
    except (BuildError, OSError) as error:
        _try_write(folder / LOG, f"{error}\n")
        raise BuildError(str(error)) from error
    for path in [*folder.glob("_kernels-*-*.*"), folder / LOG]:
        if content not in path.name:
            _try_remove(path)
    return out


def build_variants(out_folder: Path, target: Target, folder: Path = HERE) -> list[Path]:
    """Compile all variants of a wheel into ``out_folder``, side by side.

    Raises:
        BuildError: a variant cannot be compiled.
    """
    from concurrent.futures import ThreadPoolExecutor

    content = digest(folder)
    outs = [out_folder / library_name(variant, target.system, content) for variant in target.variants]
    with ThreadPoolExecutor() as pool:
        jobs = [
            pool.submit(compile_library, folder, out, variant, target)
            for out, variant in zip(outs, target.variants, strict=True)
        ]
        for job in jobs:
            job.result()
    return outs


def compile_library(folder: Path, out: Path, variant: str, target: Target, extra: Sequence[str] = ()) -> None:
    """One library, with the first compiler that succeeds; written whole or not at all.

    Args:
        variant: a key of ``VARIANT_FLAGS``, ``native`` or, for the baseline, any other name.
        extra: further flags, such as those of a sanitizer.

    Raises:
        BuildError: no compiler succeeds.
    """
    reasons: list[str] = []
    candidates = [Compiler((sys.executable, "-m", "ziglang", "cc"), True)] if target.zig else compilers()
    for compiler in candidates:
        for flags in _machine_flags(compiler, variant):
            try:
                _compile(compiler, folder, out, flags, target, extra)
            except BuildError as error:
                reasons.append(str(error))
            else:
                return
    raise BuildError("; ".join(dict.fromkeys(reasons)) or "no compiler found")


def _machine_flags(compiler: Compiler, variant: str) -> list[list[str]]:
    """Flags to try, one list after the other."""
    if variant == "native":
        return [["-march=native"], ["-mcpu=native"], []]
    if compiler.is_zig and variant in VARIANT_FLAGS:
        return [[f"-mcpu=x86_64_{variant}"]]
    return [VARIANT_FLAGS.get(variant, [])]


def _compile(
    compiler: Compiler, folder: Path, out: Path, flags: Sequence[str], target: Target, extra: Sequence[str]
) -> None:
    import tempfile
    from concurrent.futures import ThreadPoolExecutor

    common = [*FLAGS, *extra, "-fvisibility=hidden"]
    if target.system != "windows":
        common.append("-fPIC")
    if compiler.is_zig:
        # By default, zig adds traps for undefined behavior and builds for the processor of this machine.
        common += ["-fno-sanitize=undefined", "-g0", *(["-target", target.zig] if target.zig else [])]
        flags = flags or ["-mcpu=baseline"]
    with tempfile.TemporaryDirectory(prefix="lmkit-kernels-") as name:
        temporary = Path(name)

        def compile_one(path: Path) -> str:
            # cpu.c queries the processor's features, so it must run on every processor: no flags of a variant.
            baseline = ["-mcpu=baseline"] if compiler.is_zig else []
            own = [*(baseline if path.name == "cpu.c" else flags)]
            out = temporary / f"{path.stem}.o"
            _run([*compiler.command, *common, *own, "-c", str(path), "-o", str(out)], temporary)
            return str(out)

        with ThreadPoolExecutor(os.cpu_count()) as pool:
            objects = list(pool.map(compile_one, sources(folder)))
        library = temporary / out.name
        link = {"linux": ["-lm"], "macos": [f"-Wl,-install_name,@rpath/{out.name}"], "windows": []}[target.system]
        _run([*compiler.command, *common, *flags, "-shared", *objects, "-o", str(library), *link], temporary)
        _place(library, out)


def _place(library: Path, out: Path) -> None:
    """Copy beside the target and rename, so that a process that loads it sees the whole library or none."""
    import shutil

    beside = out.with_name(f".{out.name}.{os.getpid()}")
    try:
        shutil.copyfile(library, beside)
        beside.replace(out)
    finally:
        _try_remove(beside)


def _run(command: Sequence[str], cache: Path) -> None:
    import subprocess

    environment = {**os.environ, "ZIG_LOCAL_CACHE_DIR": str(cache / "zig")}
    try:
        ended = subprocess.run(
            command, capture_output=True, text=True, errors="replace", check=False, timeout=600, env=environment
        )
    except (OSError, subprocess.SubprocessError) as error:
        raise BuildError(f"{command[0]}: {error}") from error
    if ended.returncode != 0:
        lines = [line.strip() for line in ended.stderr.splitlines() if "error" in line.lower()]
        raise BuildError(f"{Path(command[0]).name} failed: {(lines or [f'exit code {ended.returncode}'])[0]}")


def _system_compilers() -> list[Compiler]:
    import shlex
    import shutil

    named = os.environ.get("CC", "")
    commands = [tuple(shlex.split(named, posix=os.name == "posix"))] if named.strip() else []
    commands += [(path,) for path in map(shutil.which, ("cc", "gcc", "clang")) if path]
    if sys.platform == "darwin" and not _has_command_line_tools():
        # Apple's /usr/bin/cc would open a window that offers to install them.
        commands = [command for command in commands if not command[0].startswith("/usr/bin/")]
    return [Compiler(command) for command in commands if command]


def _has_command_line_tools() -> bool:
    try:
        _run(["xcode-select", "-p"], Path())
    except BuildError:
        return False
    return True


def _works(compiler: Compiler) -> bool:
    """True if the compiler builds a library that calls the mathematics library."""
    import tempfile

    with tempfile.TemporaryDirectory(prefix="lmkit-kernels-") as name:
        probe = Path(name) / "probe.c"
        probe.write_text("#include <math.h>\n#include <stdint.h>\nint probe(double x) { return x > floor(x); }\n")
        try:
            _run([*compiler.command, *FLAGS, "-shared", str(probe), "-o", str(probe.with_suffix(".out"))], Path(name))
        except BuildError:
            return False
    return True


def _try_write(path: Path, text: str) -> None:
    import contextlib

    with contextlib.suppress(OSError):
        path.write_text(text, encoding="utf-8")


def _try_remove(path: Path) -> None:
    import contextlib

    # Windows cannot remove a library in use; the digest in its name marks it as outdated.
    with contextlib.suppress(OSError):
        path.unlink(missing_ok=True)


def main() -> int:
    """Compile in place and print the library's path, or why there is none."""
    try:
        sys.stdout.write(f"{build_native()}\n")
    except BuildError as error:
        sys.stderr.write(f"no compiled kernels: {error}; install a C compiler or `pip install ziglang`\n")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
