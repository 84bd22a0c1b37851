# /// script
# requires-python = ">=3.11"
# dependencies = ["hatchling>=1.25", "ziglang>=0.13", "lief>=0.16"]
# ///
"""Cross-builds the wheels of all platforms with ziglang, and checks the libraries in them.

    uv run tools/build_wheels.py [-o dist] [PLATFORM...]

Checked in every library: file format, processor, that each kernel of the sources is exported, and that nothing but
the C library and the mathematics library is needed.  The libraries of this machine's own platform are loaded, too.
"""

from __future__ import annotations

import argparse
import ctypes
import os
import re
import subprocess
import sys
import zipfile
from pathlib import Path

import lief

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from lmkit.kernels import build  # noqa: E402  (standard library only)

FORMATS = {"linux": lief.Binary.FORMATS.ELF, "macos": lief.Binary.FORMATS.MACHO, "windows": lief.Binary.FORMATS.PE}
MACHINES = {"x86_64": lief.Header.ARCHITECTURES.X86_64, "arm64": lief.Header.ARCHITECTURES.ARM64}
# C library, mathematics library, and what Windows and macOS call them.
ALLOWED = re.compile(
    r"lib[cm]\.so\.6|ld-linux.*|/usr/lib/libSystem\.B\.dylib|api-ms-win-.*|KERNEL32\.dll|ntdll\.dll", re.I
)


def exported_names() -> set[str]:
    """C names that the sources export."""
    text = "".join(path.read_text(encoding="utf-8") for path in build.sources())
    return set(re.findall(r"LMKIT_EXPORT[^;(={]*?\b(lmkit_\w+)", text))


def build_wheel(platform: str, folder: Path) -> Path:
    """The wheel of one platform."""
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    subprocess.run(command, cwd=ROOT, env={**os.environ, "LMKIT_BUILD_KERNELS": platform}, check=True)
    return max(folder.glob(f"*-{build.TARGETS[platform].wheel_tag}.whl"), key=lambda path: path.stat().st_mtime)


def check_library(data: bytes, platform: str) -> list[str]:
    """Faults of a library; empty when there is none."""
    system, _, machine = platform.partition("-")
    binary = lief.parse(list(data))
    if binary is None or binary.format != FORMATS[system]:
        return [f"no {system} library"]
    wrong = []
    if binary.abstract.header.architecture != MACHINES[machine]:
        wrong.append(f"compiled for {binary.abstract.header.architecture}")
    present = {symbol.name.removeprefix("_") if system == "macos" else symbol.name for symbol in exports(binary)}
    wrong += [f"lacks {name}" for name in sorted(exported_names() - present)]
    return wrong + [f"needs {name}" for name in needed(binary) if not ALLOWED.fullmatch(name)]


def needed(binary: lief.Binary) -> list[str]:
    """Libraries that it is linked to."""
    if isinstance(binary, lief.MachO.Binary):
        own = lief.MachO.LoadCommand.TYPE.ID_DYLIB
        return [library.name for library in binary.libraries if library.command != own]
    return [str(name) for name in binary.libraries]


def exports(binary: lief.Binary) -> list[lief.Symbol]:
    """Exported functions and data."""
    if isinstance(binary, lief.PE.Binary):
        return list(binary.get_export().entries)
    return [symbol for symbol in binary.symbols if symbol.name]


def check_wheel(wheel: Path, platform: str) -> list[str]:
    """Faults of the libraries of a wheel; empty when there is none."""
    target, wrong = build.TARGETS[platform], []
    with zipfile.ZipFile(wheel) as archive:
        for variant in target.variants:
            name = f"lmkit/kernels/{build.library_name(variant, target.system, build.digest())}"
            if name not in archive.namelist():
                wrong.append(f"{variant}: no library")
                continue
            wrong += [f"{variant}: {reason}" for reason in check_library(archive.read(name), platform)]
            if target.system == build.this_system() and set(target.variants) == set(build.this_target().variants):
                ctypes.CDLL(archive.extract(name, wheel.parent / "checked")).lmkit_cpu_features()
    return wrong


def main() -> int:
    """Build and check; the exit code is 1 when a library is not as it should be."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("platforms", nargs="*", default=list(build.TARGETS), metavar="PLATFORM")
    parser.add_argument("-o", "--out", type=Path, default=ROOT / "dist")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    failed = False
    for platform in options.platforms:
        wheel = build_wheel(platform, options.out)
        wrong = check_wheel(wheel, platform)
        failed |= bool(wrong)
        size = f"{wheel.stat().st_size / 1024:.0f} KB"
        print(f"{platform}: {wheel.name}, {size}, {'; '.join(wrong) or 'libraries sound'}")
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
