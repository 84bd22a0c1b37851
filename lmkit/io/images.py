"""The only reader of images: every image becomes 8 bit BGR.

Policy: files over ``MAX_BYTES`` or ``MAX_PIXELS`` and files that end early are refused; 16 bit is
scaled to 8; transparent pixels are blended with white; gray becomes three equal channels; CMYK is converted; the
EXIF orientation is applied, so that pixels agree with image viewers; colors become sRGB.
"""

from __future__ import annotations

import io
import re
import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np
from PIL import Image, ImageOps, UnidentifiedImageError

from lmkit.arrays import AnyArray, BoolArray, ByteArray, FloatArray
from lmkit.errors import EXTRA, InputError
from lmkit.io.color_profiles import in_srgb

MAX_BYTES = 256 * 1024 * 1024
MAX_PIXELS = 100_000_000
MIN_SIDE = 8
Pixels = TypeVar("Pixels")
SUFFIXES = frozenset({".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp", ".pgm", ".ppm", ".heic", ".heif"})
_VIDEO = re.compile(rb"....ftyp|RIFF....AVI |\x1aE\xdf\xa3", re.DOTALL)  # MP4 and MOV, AVI, MKV and WebM
_HEIF = re.compile(rb"....ftyp(?:hei[cxms]|hev[cxms]|mif1|msf1)", re.DOTALL)


def read_image(path: Path) -> ByteArray:
    """An image from a file: (H,W,3) BGR, 8 bit.

    Raises:
        InputError: no such file, too large, not an image, or cut off.
    """
    return decode_image(_bytes(path), str(path))


def read_gray(path: Path) -> tuple[FloatArray, BoolArray]:
    """Mean of the color channels of an image, 0 black to 1 white, and whether each pixel is opaque; (H,W) both.

    Raises:
        InputError: as for :func:`read_image`.
    """
    return _loaded(_bytes(path), str(path), _to_gray)


def _bytes(path: Path) -> bytes:
    try:
        if path.is_dir():
            raise InputError("is_folder", f"{path} is a folder, not an image", "give an image file")
        size = path.stat().st_size
        if size > MAX_BYTES:
            raise InputError(
                "image_too_large",
                f"{path}: {size >> 20} MiB, more than the {MAX_BYTES >> 20} MiB that are read",
                "store it smaller",
            )
        return path.read_bytes()
    except OSError as error:
        raise InputError(
            "file_unreadable",
            f"cannot read image {path}: {error.strerror}",
            "check the path and its permissions",
        ) from None
    except ValueError as error:  # a null character in the path
        raise InputError("file_unreadable", f"cannot read image {str(path)!r}: {error}", "check the path") from None


def decode_image(data: bytes, name: str) -> ByteArray:
    """An image from the bytes of a file; see :func:`read_image`.

    Args:
        name: name of the image in errors.
    """
    return np.ascontiguousarray(_loaded(data, name, partial(_to_rgb, name=name))[:, :, ::-1])


def _loaded(data: bytes, name: str, convert: Callable[[Image.Image], Pixels]) -> Pixels:
    """An upright image of bounded size, converted."""
    if not data:
        raise InputError("image_empty", f"{name}: the file is empty", "copy or take the image again")
    if _HEIF.match(data):
        _open_heif(name)
    try:
        with warnings.catch_warnings():
            # The size is checked below, against MAX_PIXELS.
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)
            loaded: Image.Image = Image.open(io.BytesIO(data))
    except (UnidentifiedImageError, Image.DecompressionBombError, OSError, ValueError, SyntaxError):
        kinds = "give PNG, JPEG, TIFF, BMP, WebP or PNM"
        if _VIDEO.match(data):
            raise InputError(
                "is_video", f"{name}: a video, not an image", "give its file name, with .mp4, .mov, .avi or .mkv"
            ) from None
        hint = f"lmkit verify reads prints in PDF; otherwise {kinds}" if data.startswith(b"%PDF") else kinds
        raise InputError("not_an_image", f"{name}: not an image that can be read", hint) from None
    width, height = loaded.size
    if width * height > MAX_PIXELS:
        raise InputError(
            "image_too_large",
            f"{name}: {width} x {height} pixels, more than the {MAX_PIXELS // 1_000_000} million that are read",
            "scale it down",
        )
    if min(width, height) < MIN_SIDE:
        raise InputError("image_too_small", f"{name}: only {width} x {height} pixels", "give a larger image")
    try:
        loaded.load()
        return convert(ImageOps.exif_transpose(loaded))
    except (OSError, ValueError, SyntaxError, EOFError, MemoryError) as error:
        raise InputError(
            "image_truncated", f"{name}: the image is cut off or damaged ({error})", "copy or take it again"
        ) from None


def _open_heif(name: str) -> None:
    """Register HEIC with Pillow."""
    try:
        from pillow_heif import register_heif_opener
    except ImportError:
        raise InputError(
            "extra_missing", f"{name}: HEIC needs the package pillow-heif", EXTRA.format("heic")
        ) from None
    register_heif_opener()


def _to_rgb(loaded: Image.Image, name: str) -> ByteArray:
    profile = loaded.info.get("icc_profile")
    if loaded.mode.startswith(("I;16", "I", "F")):
        return np.repeat(gray_to_8_bit(np.asarray(loaded))[:, :, None], 3, axis=2)
    if loaded.mode in ("RGBA", "LA", "PA", "La", "RGBa") or "transparency" in loaded.info:
        layers = loaded.convert("RGBA")
        white = Image.new("RGBA", layers.size, (255, 255, 255, 255))
        loaded = Image.alpha_composite(white, layers).convert("RGB")
    if loaded.mode == "P":
        loaded = loaded.convert("RGB")
    return np.asarray(in_srgb(loaded, profile, name).convert("RGB"), dtype=np.uint8)


def _to_gray(loaded: Image.Image) -> tuple[FloatArray, BoolArray]:
    if loaded.mode.startswith(("I;16", "I", "F")):
        gray = gray_to_8_bit(np.asarray(loaded)) / 255.0
        return gray, np.ones(gray.shape, dtype=bool)
    layers = np.asarray(loaded.convert("RGBA"), dtype=np.uint8)
    return layers[:, :, :3].mean(axis=2) / 255.0, layers[:, :, 3] == 255


def gray_to_8_bit(values: AnyArray) -> ByteArray:
    """8 bit gray from 10, 12, 14 or 16 bit (the fewest that fit the largest value), or from floats up to 1 or 255."""
    wide = values.astype(np.float64)
    most = wide.max(initial=0)
    scales = (1.0, 255.0) if values.dtype.kind == "f" else (1023.0, 4095.0, 16383.0, 65535.0)
    top = next((scale for scale in scales if most <= scale), scales[-1])
    return np.clip(np.round(wide * (255.0 / top)), 0, 255).astype(np.uint8)
