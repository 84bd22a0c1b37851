"""Documents described by pydantic models; for rigs and maps, which most commands read, see `layouts.py`."""

from __future__ import annotations

from pathlib import Path
from typing import TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from lmkit.errors import InputError
from lmkit.io.documents import read_keys
from lmkit.io.field_problems import first_problem


class Document(BaseModel):
    """Base of every model: unknown keys and values that are not finite are refused."""

    # Most imported models are not needed: pydantic builds each one when its first file is read.
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, defer_build=True)


DocumentT = TypeVar("DocumentT", bound=Document)


def read_document(path: Path, model: type[DocumentT], what: str) -> DocumentT:
    """Read and validate a YAML (or JSON) file.

    Args:
        model: model of the file; the default of its field ``format`` is the kind of file.
        what: its kind in error messages, e.g. ``floor file``.

    Raises:
        InputError: not readable or not valid; names the path of the key.
    """
    data = read_keys(path, model.model_fields["format"].default, what)
    try:
        return model.model_validate(data)
    except ValidationError as error:
        where, problem = first_problem(error)
        raise InputError("bad_value", f"{path}: {where}: {problem}", "see docs/formats.md") from None
