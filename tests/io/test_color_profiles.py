"""Color profiles (ICC) are applied: equal colors are equal pixels, whatever the file's primaries."""

from __future__ import annotations

import io
import struct
import warnings

import numpy as np
import pytest
from PIL import Image

from lmkit.errors import InputWarning
from lmkit.io.images import decode_image

# Columns of the matrices from linear RGB to XYZ at D50, as the profiles of Apple and Adobe have them.
DISPLAY_P3 = ((0.51512, 0.2412, -0.00105), (0.29198, 0.69225, 0.04189), (0.1571, 0.06657, 0.78407))
ADOBE_RGB = ((0.60974, 0.31111, 0.01947), (0.20528, 0.62567, 0.06087), (0.14919, 0.06322, 0.74457))
SRGB_CURVE = (2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045)


def fixed(*values: float) -> bytes:
    return b"".join(struct.pack(">i", round(65536 * value)) for value in values)


def profile(name: str, primaries, curve=SRGB_CURVE) -> bytes:
    """A display profile of ICC 4: primaries, and one curve for all three."""
    text = name.encode("utf-16-be")
    curve_kind = 3 if len(curve) > 1 else 0
    white = (0.9642, 1.0, 0.8249)
    tags = {b"desc": b"mluc\0\0\0\0" + struct.pack(">II", 1, 12) + b"enUS" + struct.pack(">II", len(text), 28) + text}
    tags |= {key: b"XYZ \0\0\0\0" + fixed(*v) for key, v in zip((b"rXYZ", b"gXYZ", b"bXYZ"), primaries, strict=True)}
    tags[b"wtpt"] = b"XYZ \0\0\0\0" + fixed(*white)
    tags |= {
        key: b"para\0\0\0\0" + struct.pack(">HH", curve_kind, 0) + fixed(*curve)
        for key in (b"rTRC", b"gTRC", b"bTRC")
    }
    table, data = struct.pack(">I", len(tags)), b""
    for key, value in tags.items():
        value += b"\0" * (-len(value) % 4)
        table += key + struct.pack(">II", 128 + 4 + 12 * len(tags) + len(data), len(value))
        data += value
    head = struct.pack(">I4xI", 128 + len(table) + len(data), 0x04000000) + b"mntrRGB XYZ " + bytes(12) + b"acsp"
    return head + bytes(68 - len(head)) + fixed(*white) + bytes(48) + table + data


P3 = profile("Display P3", DISPLAY_P3)


def decoded(color, icc, kind="PNG", mode="RGB"):
    buffer = io.BytesIO()
    Image.new(mode, (20, 10), color).save(buffer, format=kind, icc_profile=icc)
    return decode_image(buffer.getvalue(), "photo")[5, 5, ::-1].astype(int).tolist()


@pytest.mark.parametrize(
    ("icc", "coded", "shown"),
    [
        (P3, (234, 51, 35), (255, 0, 0)),  # the red of sRGB, as phones save it
        (P3, (117, 251, 76), (0, 255, 0)),
        (profile("Adobe RGB (1998)", ADOBE_RGB, (563 / 256,)), (219, 0, 0), (255, 0, 0)),
        (P3, (128, 128, 128), (128, 128, 128)),
        (profile("sRGB IEC61966-2.1", DISPLAY_P3), (234, 51, 35), (234, 51, 35)),  # by its name: no conversion
    ],
    ids=["red", "green", "Adobe RGB", "gray", "sRGB"],
)
def test_colors_are_those_that_a_viewer_shows(icc, coded, shown):
    for kind, mode in (("PNG", "RGB"), ("TIFF", "RGB"), ("PNG", "RGBA")):
        color = coded if mode == "RGB" else (*coded, 255)
        assert decoded(color, icc, kind, mode) == pytest.approx(shown, abs=3)


def test_a_profile_of_another_kind_of_image_is_left_out():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert decoded(77, P3, mode="L") == [77, 77, 77]
        assert decoded((0, 0, 0, 0), P3, "TIFF", "CMYK") == [255, 255, 255]


@pytest.mark.parametrize("icc", [b"no profile", P3[:200], P3[:128] + bytes(len(P3) - 128)])
def test_a_damaged_profile_is_named(icc):
    with pytest.warns(InputWarning, match="photo: its color profile cannot be read"):
        assert decoded((234, 51, 35), icc) == [234, 51, 35]


def test_photographs_in_heic_keep_their_profile(tmp_path):
    pytest.importorskip("pillow_heif", reason="the extra heic is not installed").register_heif_opener()
    assert decoded((234, 51, 35), P3, "HEIF") == pytest.approx([255, 0, 0], abs=8)


def test_an_image_is_the_same_in_every_profile():
    """Equal in Display P3 and in sRGB, to rounding."""
    rng = np.random.default_rng(1)
    linear = rng.uniform(0.05, 0.6, (10, 20, 3))
    to_p3 = (
        np.linalg.inv(np.array(DISPLAY_P3).T)
        @ np.array(((0.43607, 0.22249, 0.01392), (0.38515, 0.71687, 0.09708), (0.14307, 0.06061, 0.7141))).T
    )

    def coded(values):
        return np.round(255 * (1.055 * np.clip(values, 0, 1) ** (1 / 2.4) - 0.055)).astype(np.uint8)

    buffer = io.BytesIO()
    Image.fromarray(coded(linear @ to_p3.T)).save(buffer, format="PNG", icc_profile=P3)
    assert np.abs(decode_image(buffer.getvalue(), "x")[:, :, ::-1].astype(int) - coded(linear)).max() <= 2
