"""Earlier versions of `map.yaml` and `rig.yaml`, for undo."""

from __future__ import annotations

from pathlib import Path

from lmkit.errors import InputError
from lmkit.io.files import write_file
from lmkit.web.project import Project

FOLDER = ".lmkit-undo"
KEPT = 50


def keep_version(project: Project, name: str) -> None:
    """Keep a copy of a file before it is replaced, if it exists."""
    path = project.path(name)
    if not path.is_file():
        return
    versions = _versions(project, name)
    number = int(versions[-1].stem.rpartition("-")[2]) + 1 if versions else 1
    write_file(project.root / FOLDER / f"{path.stem}-{number:05d}{path.suffix}", path.read_bytes())
    for old in versions[: max(0, len(versions) + 1 - KEPT)]:
        old.unlink()


def count_versions(project: Project, name: str) -> int:
    """How often `restore_version` can go back."""
    return len(_versions(project, name))


def restore_version(project: Project, name: str) -> None:
    """Go back to the version before.

    Raises:
        InputError: there is none.
    """
    versions = _versions(project, name)
    if not versions:
        raise InputError("nothing_to_undo", f"there is no earlier {name}", "it has not been changed here")
    write_file(project.path(name), versions[-1].read_bytes(), force=True)
    versions[-1].unlink()


def _versions(project: Project, name: str) -> list[Path]:
    path = Path(name)
    return sorted((project.root / FOLDER).glob(f"{path.stem}-?????{path.suffix}"))
