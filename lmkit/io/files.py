"""Writing files: whole or not at all, and never over something without leave."""

from __future__ import annotations

import contextlib
import os
import tempfile
from pathlib import Path

from lmkit.errors import InputError

OVERWRITE = "give another name, or overwrite it (--force, in Python overwrite=True)"


def check_writable(path: Path, force: bool) -> None:
    """Refuse early what :func:`write_file` would refuse at the end of a long run.

    Raises:
        InputError: the file exists and ``force`` is off, or its folder cannot be written to.
    """
    try:
        is_folder, exists = path.is_dir(), path.exists()
    except OSError as error:  # a name that is too long
        raise InputError("not_writable", f"cannot write {path}: {error.strerror or error}", _HINT) from None
    if is_folder:
        raise InputError("is_folder", f"{path} is a folder, not a file", "give a file name")
    if exists and not force:
        raise InputError("file_exists", f"{path} exists already", OVERWRITE)
    folder = path.parent
    while not folder.exists():
        folder = folder.parent
    if not folder.is_dir() or not os.access(folder, os.W_OK | os.X_OK):
        raise InputError("not_writable", f"cannot write {path}: no permission to write into {folder}", _HINT)


def write_file(path: Path, content: bytes | str, force: bool = False) -> None:
    """Write a file whole or not at all: under another name first, then moved into place.

    Raises:
        InputError: the file exists and ``force`` is off, or the folder cannot be written to.
    """
    check_writable(path, force)
    data = content.encode("utf-8") if isinstance(content, str) else content
    partial: str | None = None
    made = [folder for folder in (path.parent, *path.parent.parents) if not folder.exists()]
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, partial = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
        with os.fdopen(handle, "wb") as stream:
            stream.write(data)
        umask = os.umask(0)
        os.umask(umask)
        Path(partial).chmod(0o666 & ~umask)
        Path(partial).replace(path)
    except BaseException as error:  # Ctrl-C as well
        if partial is not None:
            Path(partial).unlink(missing_ok=True)
        with contextlib.suppress(OSError):  # another's file may be in one of them by now
            for folder in made:
                folder.rmdir()
        if not isinstance(error, OSError):
            raise
        raise InputError("not_writable", f"cannot write {path}: {error.strerror or error}", _HINT) from None


_HINT = "choose a folder you may write to, with space left"
