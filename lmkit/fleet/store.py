"""Store: Parquet tables and files under one URI, a local folder or a bucket."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any
from uuid import uuid4

import numpy as np
from numpy.typing import NDArray

from lmkit.errors import EXTRA, InputError

ROWS_KEY = b"lmkit"  # key of the JSON in a table's metadata


def require_arrow() -> None:
    """Require pyarrow.

    Raises:
        InputError: pyarrow is not installed.
    """
    try:
        import pyarrow  # noqa: F401
    except ImportError:
        raise InputError("no_pyarrow", "lmkit fleet needs pyarrow", EXTRA.format("fleet")) from None


@dataclass(frozen=True)
class Store:
    """Tables and files by name below a URI; pickles, so that workers can open it.

    Attributes:
        uri: a folder, or a URI that pyarrow reads: ``s3://bucket/site``, ``gs://``, ``abfs://``, ``file://``.
    """

    uri: str

    def __getstate__(self) -> dict[str, Any]:
        # A worker has another working folder.
        return {"uri": self.uri if "://" in self.uri else str(Path(self.uri).absolute())}

    @cached_property
    def _place(self) -> tuple[Any, str]:
        require_arrow()
        return open_uri(self.uri)

    def exists(self, name: str) -> bool:
        """Whether a file of this name exists."""
        files, root = self._place
        from pyarrow import fs

        return bool(files.get_file_info(f"{root}/{name}").type == fs.FileType.File)

    def names(self, folder: str) -> list[str]:
        """Names of the files in a folder, without incomplete files; empty if there is no such folder."""
        files, root = self._place
        from pyarrow import fs

        selector = fs.FileSelector(f"{root}/{folder}", allow_not_found=True)
        found = [info.base_name for info in files.get_file_info(selector) if info.type == fs.FileType.File]
        return sorted(name for name in found if not name.startswith("."))

    def read(self, name: str) -> bytes:
        """Content of a file.

        Raises:
            InputError: it cannot be read.
        """
        files, root = self._place
        try:
            with files.open_input_stream(f"{root}/{name}") as stream:
                return bytes(stream.read())
        except OSError as error:
            raise InputError("store_unreadable", f"{self.uri}: cannot read {name} ({error})", _HINT) from None

    def write(self, name: str, content: bytes | str) -> None:
        """Write a file completely or not at all; an existing file is replaced.

        Raises:
            InputError: it cannot be written.
        """
        files, root = self._place
        from pyarrow import fs

        data = content.encode() if isinstance(content, str) else content
        folder, _, last = name.rpartition("/")
        where, target = f"{root}/{folder}".rstrip("/"), f"{root}/{name}"
        # Objects in a bucket appear when they are closed; files are written under another name and moved.
        local = isinstance(files, fs.LocalFileSystem)
        written = f"{where}/.{last}.{uuid4().hex}" if local else target
        try:
            if local:
                files.create_dir(where, recursive=True)
            with files.open_output_stream(written) as stream:
                stream.write(data)
            if local:
                files.move(written, target)
        except OSError as error:
            raise InputError("store_unwritable", f"{self.uri}: cannot write {name} ({error})", _HINT) from None

    def read_table(self, name: str) -> tuple[dict[str, Any], dict[str, Any]]:
        """Columns of a Parquet file, and the JSON object written with it.

        Numbers are arrays, (N,) or (N,K); other columns are lists.

        Raises:
            InputError: it cannot be read, or is not such a file.
        """
        require_arrow()
        import pyarrow as pa
        from pyarrow import parquet

        try:
            # Running pyarrow threads sometimes abort the interpreter at exit.
            table = parquet.ParquetFile(pa.BufferReader(self.read(name))).read(use_threads=False)
        except (pa.ArrowException, OSError) as error:
            raise InputError("store_damaged", f"{self.uri}: {name} is damaged ({error})", "delete it") from None
        about = json.loads((table.schema.metadata or {}).get(ROWS_KEY, b"{}"))
        return {name: _values(table[name].combine_chunks()) for name in table.column_names}, about

    def write_table(
        self, name: str, columns: Mapping[str, Sequence[Any] | NDArray[Any]], about: Mapping[str, Any] | None = None
    ) -> None:
        """Write columns, lists or arrays (N,) or (N,K), as a Parquet file, with a JSON object in its metadata."""
        require_arrow()
        import pyarrow as pa
        from pyarrow import parquet

        table = pa.table({key: _column(values) for key, values in columns.items()})
        table = table.replace_schema_metadata({ROWS_KEY: json.dumps(dict(about or {})).encode()})
        buffer = pa.BufferOutputStream()
        parquet.write_table(table, buffer, compression="zstd")
        self.write(name, buffer.getvalue().to_pybytes())


def _column(values: Sequence[Any] | NDArray[Any]) -> Any:
    """Arrow's array; rows of K numbers are lists of that length."""
    import pyarrow as pa

    if isinstance(values, np.ndarray) and values.ndim == 2:
        return pa.FixedSizeListArray.from_arrays(pa.array(values.ravel()), values.shape[1])
    return pa.array(values)


def _values(column: Any) -> NDArray[Any] | list[Any]:
    """Values of an Arrow array."""
    import pyarrow as pa

    if pa.types.is_fixed_size_list(column.type):
        return np.asarray(column.flatten()).reshape(len(column), -1)
    return np.asarray(column) if pa.types.is_primitive(column.type) and not column.null_count else column.to_pylist()


_HINT = "check the store's URI, the permissions and the space left"


def open_uri(uri: str) -> tuple[Any, str]:
    """File system and path of a folder or URI.

    Raises:
        InputError: no such kind of URI.
    """
    import pyarrow as pa
    from pyarrow import fs

    if "://" not in uri:
        return fs.LocalFileSystem(), str(Path(uri).absolute())
    try:
        files, path = fs.FileSystem.from_uri(uri)
    except (pa.ArrowException, ValueError, OSError) as error:
        raise InputError(
            "bad_uri", f"cannot open {uri} ({error})", "give a folder, or s3://, gs:// or file://"
        ) from None
    return files, path.rstrip("/")
