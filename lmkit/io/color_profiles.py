"""Color profiles (ICC) in images: colors become sRGB, as a viewer shows them.

Phones save Display P3, cameras at times Adobe RGB, printers' files CMYK; read as sRGB, their colors would be too
dull.
"""

from __future__ import annotations

import io
from functools import lru_cache
from typing import TYPE_CHECKING

from PIL import Image

from lmkit.errors import InputWarning, warn_caller

if TYPE_CHECKING:
    from PIL.ImageCms import ImageCmsTransform

MAX_BYTES = 8 * 1024 * 1024
_MODES = {"RGB ": "RGB", "CMYK": "CMYK"}  # color space of a profile: mode of its images


def in_srgb(image: Image.Image, profile: object, name: str) -> Image.Image:
    """An RGB or CMYK image, converted to sRGB by its color profile; images of other modes or in sRGB are unchanged.

    Args:
        profile: bytes of the ICC profile; any other value is ignored.
        name: name of the image in warnings.

    Warns:
        InputWarning: the profile is damaged, or cannot be applied.
    """
    if not isinstance(profile, bytes) or not profile or image.mode not in _MODES.values():
        return image
    from PIL import ImageCms

    try:
        transform = _to_srgb(profile, image.mode)
        return image if transform is None else ImageCms.applyTransform(image, transform) or image
    except (ImportError, OSError, ValueError, TypeError, ImageCms.PyCMSError):
        sentence = f"{name}: its color profile cannot be read, and is not applied: colors are taken as sRGB"
        warn_caller(InputWarning(sentence))
        return image


@lru_cache(maxsize=8)
def _to_srgb(profile: bytes, mode: str) -> ImageCmsTransform | None:
    """Transform of images of this mode to sRGB; None for images in sRGB, and for profiles of another mode.

    Raises:
        OSError, PyCMSError: the profile is damaged.
    """
    from PIL import ImageCms

    if len(profile) > MAX_BYTES:
        raise OSError("a profile too large")
    opened = ImageCms.ImageCmsProfile(io.BytesIO(profile))
    described = opened.profile.profile_description or ""
    if _MODES.get(opened.profile.xcolor_space) != mode or "srgb" in described.lower():
        return None
    return ImageCms.buildTransform(opened, ImageCms.createProfile("sRGB"), mode, "RGB")
