"""The project folder: the only files that the page reads and writes."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

from lmkit.errors import InputError
from lmkit.io.images import SUFFIXES as IMAGES

NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9 ._()+-]{0,99}")
FILMS = frozenset({".mp4", ".avi", ".mkv", ".mov", ".webm"})
BAGS = frozenset({".mcap", ".bag", ".db3"})
# Results that a browser may fetch as files.
PUBLIC = ("prints", "photos", "reports")
MOST_ENTRIES = 20_000  # read for a listing
DEEPEST = 4


@dataclass(frozen=True)
class Project:
    """A folder, whose files are named by paths relative to it.

    Attributes:
        root: absolute, without symbolic links.
    """

    root: Path

    def path(self, name: str) -> Path:
        """The file or folder of a relative path such as ``drives/monday/left``.

        Raises:
            InputError: a path that leaves the folder, an unusual name, or a hidden one.
        """
        parts = PurePosixPath(name).parts
        if not parts or "\\" in name or not all(NAME.fullmatch(part) and part[-1] not in ". " for part in parts):
            raise InputError(
                "bad_name",
                f"{name[:80]!r} is not a name of this project",
                "use letters, digits, dots, dashes and spaces, relative to the project's folder",
            )
        path = self.root.joinpath(*parts)
        # A symbolic link may point outside the folder.
        if not path.resolve().is_relative_to(self.root):
            raise InputError("bad_name", f"{name[:80]!r} is outside the project", "keep the files in the folder")
        return path

    def public(self, name: str) -> Path:
        """An existing result by its relative path.

        Raises:
            InputError: not a result, or no such file.
        """
        path = self.path(name)
        if PurePosixPath(name).parts[0] not in PUBLIC or not path.is_file():
            raise InputError("no_file", f"there is no {name[:80]}", "reload the page: the file may have been moved")
        return path

    def unused(self, folder: str, stem: str, suffix: str) -> str:
        """A relative path that does not exist, such as ``prints/landmarks-3.pdf``."""
        for number in range(1, 10_000):
            name = f"{folder}/{stem}{'' if number == 1 else f'-{number}'}{suffix}"
            if not self.path(name).exists():
                return name
        raise InputError("folder_full", f"{folder} holds too many files", "move some of them away")

    def relative(self, path: Path) -> str:
        """The name of a file of this project."""
        return path.relative_to(self.root).as_posix()


def open_project(folder: Path) -> Project:
    """The project of a folder, which is created if missing.

    Raises:
        InputError: it cannot be created or written to.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        writable = os.access(folder, os.W_OK)
    except OSError as error:
        raise InputError("no_folder", f"cannot make {folder}: {error.strerror}", "choose another folder") from None
    if not writable:
        raise InputError("no_folder", f"{folder} cannot be written to", "choose another folder")
    return Project(folder.resolve())


def listing(project: Project) -> dict[str, Any]:
    """Files of the project by purpose, limited in number."""
    found: dict[str, list[dict[str, Any]]] = {"pairs": [], "recordings": [], "films": [], "bags": []}
    for folder, folders, files in _walk(project.root):
        name = project.relative(folder) if folder != project.root else ""
        tables = [f for f in files if f.startswith("detections") and f.endswith(".csv")]
        sides = [s for s in ("left", "right") if s in folders and _image_count(folder / s)]
        if name and len(sides) == 2:
            count = min(_image_count(folder / side) for side in sides)
            found["pairs"].append({"name": name, "count": count})
        if tables or (name and len(sides) == 2 and "boards" not in name and not name.startswith("pairs")):
            others = {k: f"{k}.csv" in files for k in ("odometry", "gyro")}
            own = {"rig": "rig.yaml" in files or "rig" in folders, "map": "map.yaml" in files}
            found["recordings"].append(
                {"name": name, "detections": tables[0] if tables else None, "images": len(sides) == 2, **others}
                | {f"own_{k}": v for k, v in own.items()}
            )
        for file in files:
            kind = "films" if Path(file).suffix.lower() in FILMS else "bags" if _is_bag(file) else None
            if kind is not None:
                found[kind].append({"name": f"{name}/{file}" if name else file})
    return {
        "folder": project.root.name,
        "path": str(project.root),
        "has": {key: (project.root / f"{key}.yaml").is_file() for key in ("rig", "map", "run", "floor", "pins")},
        "prints": _files(project, "prints", (".pdf", ".svg", ".png")),
        "photos": _files(project, "photos", (*IMAGES, ".pdf")),
        "reports": _files(project, "reports", (".html", ".pdf", ".svg", ".png")),
        **found,
    }


def _is_bag(file: str) -> bool:
    return Path(file).suffix.lower() in BAGS


def _walk(root: Path) -> Iterator[tuple[Path, list[str], list[str]]]:
    """Folders with the names of their folders and files, from the top, within bounds."""
    left = MOST_ENTRIES
    for path, folders, files in os.walk(root):
        here = Path(path)
        folders[:] = sorted(f for f in folders if NAME.fullmatch(f) and not (here / f).is_symlink())
        yield here, list(folders), sorted(f for f in files if NAME.fullmatch(f))
        left -= len(folders) + len(files)
        if len(here.relative_to(root).parts) >= DEEPEST or left < 0:
            folders.clear()
        folders[:] = [f for f in folders if f not in ("left", "right", "prints", "photos", "reports")]


def _image_count(folder: Path) -> int:
    with os.scandir(folder) as entries:
        return sum(1 for entry in entries if Path(entry.name).suffix.lower() in IMAGES)


def _files(project: Project, folder: str, suffixes: tuple[str, ...]) -> list[dict[str, Any]]:
    """Files of one folder, the newest first."""
    path = project.root / folder
    if not path.is_dir() or path.is_symlink():
        return []
    entries = [p for p in path.iterdir() if p.suffix.lower() in suffixes and p.is_file() and NAME.fullmatch(p.name)]
    entries.sort(key=lambda p: p.stat().st_mtime, reverse=True)
    return [
        {"name": f"{folder}/{p.name}", "bytes": p.stat().st_size, "time": round(p.stat().st_mtime)}
        for p in entries[:500]
    ]
