"""Earlier versions of `map.yaml`, `rig.yaml`, `floor.yaml` and `pins.yaml`, for undo."""

from __future__ import annotations

from pathlib import Path

from lmkit.errors import InputError
from lmkit.io.files import write_file
from lmkit.web.project import Project

FOLDER = ".lmkit-undo"
KEPT = 50


def keep_versions(project: Project, *names: str) -> None:
    """Keep copies of files that are replaced together, under one number; an empty copy: there was no file."""
    folder = project.root / FOLDER
    number = max((_number(path) for path in folder.glob("*-[0-9][0-9][0-9][0-9][0-9].*")), default=0) + 1
    for name in names:
        path = project.path(name)
        write_file(folder / f"{path.stem}-{number:05d}{path.suffix}", _content(path))
        for old in _versions(project, name)[:-KEPT]:
            old.unlink()


def count_versions(project: Project, *names: str) -> int:
    """Number of changes that `restore_versions` can undo."""
    return len({_number(path) for name in names for path in _changed(project, name)})


def restore_versions(project: Project, *names: str) -> None:
    """Undo the newest change of any of these files; a file that did not exist before is removed.

    Raises:
        InputError: there is no change.
    """
    changed = {name: _changed(project, name) for name in names}
    newest = max((_number(versions[-1]) for versions in changed.values() if versions), default=None)
    if newest is None:
        raise InputError("nothing_to_undo", f"there is no earlier {names[0]}", "it has not been changed here")
    for name, versions in changed.items():
        if not versions or _number(versions[-1]) != newest:
            continue
        data = versions[-1].read_bytes()
        if data:
            write_file(project.path(name), data, force=True)
        else:
            project.path(name).unlink(missing_ok=True)
        for version in _versions(project, name)[len(versions) - 1 :]:
            version.unlink()


def _changed(project: Project, name: str) -> list[Path]:
    """Versions up to the newest one that differs from the file: a job may have written nothing."""
    versions, now = _versions(project, name), _content(project.path(name))
    while versions and versions[-1].read_bytes() == now:
        versions.pop()
    return versions


def _number(version: Path) -> int:
    return int(version.stem.rpartition("-")[2])


def _content(path: Path) -> bytes:
    return path.read_bytes() if path.is_file() else b""


def _versions(project: Project, name: str) -> list[Path]:
    path = Path(name)
    return sorted((project.root / FOLDER).glob(f"{path.stem}-[0-9][0-9][0-9][0-9][0-9]{path.suffix}"))
