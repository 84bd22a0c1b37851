"""Loads the compiled kernels: the library of this processor's variant, or none, in which case numpy computes.

``LMKIT_KERNELS`` chooses for tests: ``numpy`` (none), a variant (``v2``, ``v3``, ``v4``, ``arm64``, ``native``), or
the path of a library.
"""

from __future__ import annotations

import ctypes
import os
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lmkit.kernels.build import HERE, LOG, digest, library_name, this_system

SWITCH = "LMKIT_KERNELS"
VARIANTS = ("native", "v4", "v3", "arm64", "generic", "v2")  # best first
REBUILD = "install a C compiler or `pip install ziglang`, then run `python -m lmkit.kernels.build`"


@dataclass(frozen=True)
class Loaded:
    """The loaded library.

    Attributes:
        library: None if numpy computes.
        variant: its name; ``numpy`` without a library.
        reason: reason why there is none, in a few words.
    """

    library: ctypes.CDLL | None
    variant: str
    reason: str = ""


@lru_cache(maxsize=1)
def loaded() -> Loaded:
    """The library for this processor, loaded once per process.

    Raises:
        ImportError: ``LMKIT_KERNELS`` names a variant that is not here or does not run on this processor.
    """
    wanted = os.environ.get(SWITCH, "")
    if wanted == "numpy":
        return Loaded(None, "numpy", f"{SWITCH}=numpy")
    if wanted:
        found = _open(_path(wanted, digest()), wanted)
        if found.library is None:
            raise ImportError(f"{SWITCH}={wanted}: {found.reason}")
        return found
    return _best()


def library() -> ctypes.CDLL | None:
    """The library for this processor; None if numpy computes."""
    return loaded().library


def function(name: str, *argument_types: Any) -> Callable[..., int] | None:
    """A kernel by its C name, which returns its status; None if numpy computes."""
    found = library()
    if found is None:
        return None
    kernel = getattr(found, name)
    kernel.argtypes, kernel.restype = argument_types, ctypes.c_int
    return kernel  # type: ignore[no-any-return]


_begin = (ctypes.c_char * 0).from_buffer


def address(array: NDArray[Any]) -> int:
    """Address of a contiguous array's data; keep the array alive while the kernel runs."""
    try:
        # Four times as fast as array.ctypes.
        return ctypes.addressof(_begin(array))  # type: ignore[arg-type]
    except (TypeError, ValueError, BufferError):  # read-only, or empty
        return array.ctypes.data


def addresses(*arrays: NDArray[Any] | None) -> list[int | None]:
    """Addresses of arrays, in this order; null for None."""
    return [None if array is None else address(array) for array in arrays]


def contiguous(array: Any, shape: tuple[int, ...], dtype: Any = np.float64) -> NDArray[Any]:
    """The array in the form for a kernel: contiguous, of this dtype; -1 in ``shape`` means any length.

    Raises:
        ValueError: the shape differs.
    """
    ready: NDArray[Any] = np.ascontiguousarray(array, dtype=dtype)
    have = ready.shape
    if have == shape or (shape[0] == -1 and len(have) == len(shape) and have[1:] == shape[1:]):
        return ready
    if len(have) != len(shape) or any(want not in (-1, size) for want, size in zip(shape, have, strict=True)):
        raise ValueError(f"an array of shape {have}, expected {shape}")
    return ready


def describe() -> str:
    """One line for `lmkit doctor`."""
    found = loaded()
    if found.library is not None:
        return f"compiled kernels: {found.variant}"
    return f"numpy only: {found.reason}"


def _path(variant: str, content: str) -> Path:
    given = Path(variant)
    return given if given.suffix else HERE / library_name(variant, this_system(), content)


def _best() -> Loaded:
    content, reason = digest(), ""
    for variant in VARIANTS:
        path = _path(variant, content)
        if not path.is_file():
            continue
        found = _open(path, variant)
        if found.library is not None:
            return found
        reason = found.reason
    return Loaded(None, "numpy", reason or _why_none())


def _open(path: Path, variant: str) -> Loaded:
    if not path.is_file():
        return Loaded(None, "numpy", f"{path.name} is not here")
    try:
        opened = ctypes.CDLL(str(path))
        built = ctypes.c_uint32.in_dll(opened, "lmkit_built_features").value
        opened.lmkit_cpu_features.restype = ctypes.c_uint32
        missing = built & ~opened.lmkit_cpu_features()
    except (OSError, ValueError, AttributeError) as error:
        return Loaded(None, "numpy", f"{path.name} cannot be loaded: {error}")
    if missing:
        return Loaded(None, "numpy", f"the {variant} library was compiled for another processor; {REBUILD}")
    return Loaded(opened, variant)


def _why_none() -> str:
    """Reason why no library fits; an outdated or missing one gives a warning, since slow results look normal."""
    if any(HERE.glob("_kernels-*-*.*")):
        reason = f"the compiled kernels are older than their sources; {REBUILD}"
        warnings.warn(reason, RuntimeWarning, stacklevel=2)
        return reason
    try:
        logged = (HERE / LOG).read_text(encoding="utf-8").strip()
    except OSError:
        logged = ""
    reason = f"{logged or 'no library was built'}; {REBUILD}"
    if not logged:
        # A cleaned checkout: installers do not notice that the built libraries are gone.
        warnings.warn(f"no compiled kernels, numpy is many times slower: {reason}", RuntimeWarning, stacklevel=2)
    return reason
