# /// script
# requires-python = ">=3.11"
# dependencies = ["ziglang>=0.13"]
# ///
"""Runs kernels compiled for arm64 under an emulator, and compares them with this machine's.

    uv run tools/check_arm64.py        (needs qemu-user-static)

The library is linked into a small program (kernel_driver.c) for both processors; what they print must be equal.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

TOOLS = Path(__file__).resolve().parent
sys.path.insert(0, str(TOOLS.parent))

from lmkit.kernels import build  # noqa: E402  (standard library only)

EMULATOR = "qemu-aarch64-static"


def program(target: str, out: Path) -> Path:
    """The driver with all kernels, for one target."""
    command = [sys.executable, "-m", "ziglang", "cc", "-target", target, "-static", *build.FLAGS]
    files = [TOOLS / "kernel_driver.c", *build.sources()]
    subprocess.run([*command, f"-I{build.HERE}", *map(str, files), "-o", str(out)], check=True)
    return out


def main() -> int:
    """The exit code is 1 when the answers differ, 2 without an emulator."""
    if shutil.which(EMULATOR) is None:
        print(f"{EMULATOR} is not here; install qemu-user-static")
        return 2
    with tempfile.TemporaryDirectory() as name:
        here = program("x86_64-linux-musl", Path(name) / "x86_64")
        there = program("aarch64-linux-musl", Path(name) / "arm64")
        ours, theirs = (
            subprocess.run(command, capture_output=True, text=True, check=True).stdout
            for command in ([str(here)], [EMULATOR, str(there)])
        )
    print(theirs + ("equal on x86-64 and arm64" if ours == theirs else f"but on x86-64:\n{ours}"))
    return int(ours != theirs)


if __name__ == "__main__":
    sys.exit(main())
