"""Files of landmark information: NumPy's npz, without pickled objects."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path

import numpy as np

from lmkit.errors import InputError
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_information import LandmarkInformation

FORMAT = "lmkit-information/1"


def information_to_bytes(information: LandmarkInformation) -> bytes:
    """The content of a file."""
    buffer = io.BytesIO()
    np.savez_compressed(
        buffer,
        format=np.array(FORMAT),
        ids=np.array([str(id_) for id_ in information.ids], dtype=str),
        R=information.R,
        p=information.p,
        H=information.H,
        b=information.b,
        cost=np.array(information.cost),
    )
    return buffer.getvalue()


def read_information(path: Path) -> LandmarkInformation:
    """Landmark information from its file.

    Raises:
        InputError: not readable, or not such a file.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise InputError("file_missing", f"{path}: {error.strerror or error}", "check the path") from None
    return information_from_bytes(content, str(path))


def information_from_bytes(content: bytes, where: str) -> LandmarkInformation:
    """Landmark information from a file's content.

    Args:
        where: what error messages call the file.

    Raises:
        InputError: not such a file, or damaged.
    """
    hint = "write it again with lmkit survey --save-information"
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as data:
            if str(data["format"]) != FORMAT:
                raise InputError("bad_format", f"{where}: format is {data['format']}, not {FORMAT}", hint)
            ids = tuple(LandmarkId.parse(str(text)) for text in data["ids"])
            R, p, H, b = (np.asarray(data[name], dtype=np.float64) for name in "RpHb")
            cost = float(data["cost"])
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise InputError("bad_file", f"{where}: not a file of landmark information ({error})", hint) from None
    count = len(ids)
    fits = R.shape == (count, 3, 3) and p.shape == (count, 3) and b.shape in ((6 * count,), (2 * count,))
    finite = all(np.isfinite(values).all() for values in (R, p, H, b, cost))
    if not (fits and finite and H.shape == (len(b), len(b)) and len(set(ids)) == count):
        raise InputError("bad_file", f"{where}: the arrays do not fit each other, or are not finite", hint)
    return LandmarkInformation(ids, R, p, H, b, cost)
