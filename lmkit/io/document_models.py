"""Documents that a model of pydantic describes; rigs and maps, which most commands read, have `layouts.py`."""

from __future__ import annotations

from pathlib import Path
from typing import TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from lmkit.errors import InputError
from lmkit.io.documents import read_keys
from lmkit.io.field_problems import first_problem


class Document(BaseModel):
    """Base of every model: unknown keys and values that are not finite are refused."""

    # Most models that are imported are not needed: each is prepared when a file of it is read.
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, defer_build=True)


DocumentT = TypeVar("DocumentT", bound=Document)


def read_document(path: Path, model: type[DocumentT], what: str) -> DocumentT:
    """Read and validate a YAML (or JSON) file.

    Args:
        model: what it must follow; the default of its field ``format`` is the kind of file.
        what: its kind in error messages, e.g. ``floor file``.

    Raises:
        InputError: anything wrong with it, with the path of the offending key.
    """
    data = read_keys(path, model.model_fields["format"].default, what)
    try:
        return model.model_validate(data)
    except ValidationError as error:
        where, problem = first_problem(error)
        raise InputError("bad_value", f"{path}: {where}: {problem}", "see docs/formats.md") from None
