"""Writing files: completely or not at all; existing files are replaced only with ``force``."""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Mapping
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
    if path == Path("-"):
        raise InputError("is_stream", "- is no file: standard output takes no files", "give a file name")
    if exists and not path.is_file():
        raise InputError("is_device", f"{path} is a device or pipe, not a file", "give a file name")
    if exists and not force:
        raise InputError("file_exists", f"{path} exists already", OVERWRITE)
    folder = path.parent
    while not folder.exists():
        folder = folder.parent
    if not folder.is_dir():
        raise InputError("not_writable", f"cannot write {path}: {folder} is not a folder", _HINT)
    if not os.access(folder, os.W_OK | os.X_OK):
        raise InputError("not_writable", f"cannot write {path}: no permission to write into {folder}", _HINT)


def write_file(path: Path, content: bytes | str, force: bool = False) -> None:
    """Write a file completely or not at all; see :func:`write_files`."""
    write_files({path: content}, force)


def write_files(contents: Mapping[Path, bytes | str], force: bool = False) -> None:
    """Write all files completely or none of them: under temporary names first, then moved into place.

    Raises:
        InputError: a file exists and ``force`` is off, or a folder cannot be written to.
    """
    for path in contents:
        check_writable(path, force)
    missing = {f for path in contents for f in (path.parent, *path.parent.parents) if not f.exists()}
    partials: dict[Path, Path] = {}
    path = Path()
    try:
        for path, content in contents.items():
            path.parent.mkdir(parents=True, exist_ok=True)
            _write_partial(path, _encoded(content), partials)
        for path, partial in partials.items():
            partial.replace(path)
    except BaseException as error:  # Ctrl-C as well
        for partial in partials.values():
            partial.unlink(missing_ok=True)
        with contextlib.suppress(OSError):  # another program may have written a file there
            for folder in sorted(missing, key=lambda folder: -len(folder.parts)):
                folder.rmdir()
        if not isinstance(error, OSError):
            raise
        raise InputError("not_writable", f"cannot write {path}: {error.strerror or error}", _HINT) from None


def _encoded(content: bytes | str) -> bytes:
    """UTF-8; undecodable bytes of file names are escaped, as in JSON."""
    return content.encode("utf-8", "backslashreplace") if isinstance(content, str) else content


def _write_partial(path: Path, data: bytes, partials: dict[Path, Path]) -> None:
    """Write the data beside ``path``, under a name that is noted in ``partials`` before anything can fail."""
    handle, name = tempfile.mkstemp(prefix=f".{path.name[:40]}.", dir=path.parent)
    partials[path] = Path(name)
    with os.fdopen(handle, "wb") as stream:
        stream.write(data)
    umask = os.umask(0)
    os.umask(umask)
    partials[path].chmod(0o666 & ~umask)


_HINT = "choose a folder you may write to, with space left"
