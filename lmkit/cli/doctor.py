"""`lmkit doctor`: check of this installation."""

from __future__ import annotations

import platform
import re
import sys
from dataclasses import dataclass
from typing import Annotated

import typer

from lmkit.cli.output import print_line
from lmkit.errors import NegativeAnswer


def run(
    cameras: Annotated[
        bool, typer.Option("--cameras", help="List the cameras of this machine, and check nothing else.")
    ] = False,
) -> None:
    """Check the installation."""
    if cameras:
        _cameras()
        return
    findings = check_installation()
    for finding in findings:
        print_line(f"{'ok  ' if finding.good else 'BAD '} {finding.text}")
    bad = [finding for finding in findings if not finding.good]
    if bad:
        raise NegativeAnswer("unsound", f"{len(bad)} of {len(findings)} checks fail", bad[0].hint)


def _cameras() -> None:
    from lmkit.live.captures import list_cameras

    found = list_cameras()
    for address, text in found:
        print_line(f"{address}  {text}")
    if not any("image" in text and "no image" not in text for _, text in found):
        raise NegativeAnswer("no_cameras", "no camera gives images", "plug one in, and close other programs")


DISTRIBUTION = "lmkit-landmarks"


OPENCV_OURS = "opencv-contrib-python-headless"


OPENCV_OTHERS = ("opencv-python", "opencv-python-headless", "opencv-contrib-python")


NEEDED = ("numpy", "scipy", "pillow", "pydantic", "pypdfium2", "reportlab", "scikit-image", "typer", "pyyaml")


@dataclass(frozen=True)
class Finding:
    """One check of the installation."""

    good: bool
    text: str
    hint: str = ""


def check_installation() -> list[Finding]:
    """All checks, none of which changes anything."""
    findings = [Finding(True, f"Python {platform.python_version()} on {platform.system()} {platform.machine()}")]
    findings += [_opencv(), *(_package(name) for name in NEEDED), _templates(), _kernels(), _extras()]
    return findings


def _version(name: str) -> str | None:
    import importlib.metadata

    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return None


def _opencv() -> Finding:
    others = [name for name in OPENCV_OTHERS if _version(name) is not None]
    hint = f"pip uninstall -y {' '.join(others)} {OPENCV_OURS} && pip install {OPENCV_OURS}"
    if others:
        return Finding(False, f"{', '.join(others)} overwrites the cv2 of {OPENCV_OURS}", hint)
    try:
        import cv2
    except ImportError as error:
        return Finding(False, f"cv2 cannot be imported: {error}", f"pip install {OPENCV_OURS}")
    if not hasattr(cv2, "aruco") or not hasattr(cv2, "approxPolyN"):
        return Finding(False, f"cv2 {cv2.__version__} lacks aruco or approxPolyN", f"pip install -U {OPENCV_OURS}")
    return Finding(True, f"OpenCV {cv2.__version__}")


def _package(name: str) -> Finding:
    version = _version(name)
    if version is None:
        return Finding(False, f"{name} is missing", f"pip install {name}")
    return Finding(True, f"{name} {version}")


def _templates() -> Finding:
    from lmkit.io.template import templates_folder

    names = sorted(path.stem for path in templates_folder().glob("*.toml"))
    return Finding(bool(names), f"templates: {', '.join(names) or 'none'}", "install lmkit again")


def _extras() -> Finding:
    from lmkit.errors import EXTRA

    there = {
        extra: all(_version(name) is not None for name in names) for extra, names in _packages_of_extras().items()
    }
    have = ", ".join(extra for extra, complete in there.items() if complete) or "none"
    lack = ", ".join(extra for extra, complete in there.items() if not complete)
    # Extras are for single commands: without them the installation is sound.
    return Finding(True, f"extras: {have}" + (f"; not installed: {lack} ({EXTRA.format('NAME')})" if lack else ""))


def _packages_of_extras() -> dict[str, list[str]]:
    """Packages of every extra that users may want, on this platform."""
    import importlib.metadata

    packages: dict[str, list[str]] = {}
    for line in importlib.metadata.requires(DISTRIBUTION) or []:
        found = re.match(r"([\w.-]+)", line), re.search(r"extra == ['\"]([\w-]+)['\"]", line)
        if found[0] is None or found[1] is None or found[0][1] == DISTRIBUTION or found[1][1] == "benchmark":
            continue
        if "sys_platform" not in line or sys.platform != "win32":
            packages.setdefault(found[1][1], []).append(found[0][1])
    return dict(sorted(packages.items()))


def _kernels() -> Finding:
    from lmkit.kernels.load import describe

    # Without compiled kernels lmkit is slow, not unsound.
    return Finding(True, describe())
