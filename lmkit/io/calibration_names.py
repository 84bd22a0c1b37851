"""Names of camera matrices, distortions and relative poses in files that OpenCV's users write."""

from __future__ import annotations

import re
from collections.abc import Iterable

_MATRIX = frozenset({"k", "m", "cm", "mtx", "cameramatrix", "cameramat", "cammatrix", "cammat", "intrinsicmatrix"})
_DISTORTION = frozenset({
    "d", "dist", "distortion", "distcoef", "distcoefs", "distcoeff", "distcoeffs",
    "distortioncoef", "distortioncoefs", "distortioncoeff", "distortioncoeffs", "distortioncoefficients",
})  # fmt: skip
_OTHERS = {
    "R": frozenset({"r", "rot", "rotation", "rotationmatrix"}),
    "T": frozenset({"t", "trns", "translation", "translationvector"}),
    "model": frozenset({"model"}),
    "image_width": frozenset({"imagewidth", "imgwidth", "framewidth", "width", "w"}),
    "image_height": frozenset({"imageheight", "imgheight", "frameheight", "height", "h"}),
    "image_size": frozenset({"imagesize", "imgsize", "framesize", "size", "resolution"}),
}
SHORT = 2  # letters of names that are no matrices in lower case: k1 and k2 are distortion coefficients
_SIDES = {"left": "1", "right": "2", "l": "1", "r": "2", "0": "0", "1": "1", "2": "2"}
_FIELDS = (
    {stem: field for field, stems in (("K", _MATRIX), ("D", _DISTORTION)) for stem in stems}
    | {
        name: field + number
        for field, stems in (("M", _MATRIX), ("D", _DISTORTION))
        for stem in stems
        for side, number in _SIDES.items()
        for name in (stem + side, side + stem)
    }
    | {name: field for field, names in _OTHERS.items() for name in names}
)
LONGEST = 40  # letters of a name


def fields_by_name(names: Iterable[str]) -> dict[str, str]:
    """Fields that names stand for: M1 D1 M2 D2 of a pair, K D of one camera, R T model and the image's size.

    Names that are not understood are missing.

    Examples:
        >>> fields_by_name(["mtx_left", "distR", "Rot", "P1"])
        {'mtx_left': 'M1', 'distR': 'D2', 'Rot': 'R'}
        >>> fields_by_name(["K0", "K1"])
        {'K0': 'M1', 'K1': 'M2'}
    """
    fields = {name: field for name in names if (field := _field_of(name)) is not None}
    if any(field in ("M0", "D0") for field in fields.values()):
        return {name: _next_number(field) for name, field in fields.items()}
    return fields


def names_a_camera(names: Iterable[str]) -> bool:
    """Whether a name stands for a camera matrix."""
    return not {"K", "M1", "M2"}.isdisjoint(fields_by_name(names).values())


def _field_of(name: str) -> str | None:
    if len(name) > LONGEST:
        return None
    plain = re.sub(r"[^a-z0-9]", "", name.lower())
    field = _FIELDS.get(plain)
    is_coefficient = name.islower() and len(plain) <= SHORT and plain not in ("r", "t", "w", "h")
    return None if is_coefficient else field


def _next_number(field: str) -> str:
    """M1 for M0: of cameras that are counted from 0."""
    return f"{field[0]}{int(field[1]) + 1}" if re.fullmatch("[MD][01]", field) else field
