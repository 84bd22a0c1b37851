"""Reading of images: which files are accepted, and with which message others are refused."""

from __future__ import annotations

import io
import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from lmkit.errors import InputError
from lmkit.io import images
from lmkit.io.images import decode_image, read_image

RED_RGB = (200, 30, 40)


def encoded(photo: Image.Image, kind: str = "PNG", **options) -> bytes:
    buffer = io.BytesIO()
    photo.save(buffer, format=kind, **options)
    return buffer.getvalue()


def plain(mode: str, color) -> Image.Image:
    return Image.new(mode, (20, 10), color)


def test_colors_come_as_bgr():
    assert tuple(decode_image(encoded(plain("RGB", RED_RGB)), "x")[0, 0]) == RED_RGB[::-1]


@pytest.mark.parametrize(
    ("photo", "expected"),
    [
        (plain("L", 77), (77, 77, 77)),
        (plain("RGBA", (0, 0, 0, 0)), (255, 255, 255)),
        (plain("RGBA", (*RED_RGB, 255)), RED_RGB[::-1]),
        (plain("LA", (50, 0)), (255, 255, 255)),
        (plain("1", 1), (255, 255, 255)),
        (plain("P", 0), (0, 0, 0)),
        (Image.fromarray(np.full((10, 20), 257 * 90, np.uint16)), (90, 90, 90)),
    ],
    ids=["gray", "transparent", "opaque", "gray alpha", "bilevel", "palette", "16 bit"],
)
def test_every_kind_becomes_8_bit_bgr(photo, expected):
    image = decode_image(encoded(photo), "x")
    assert image.shape == (10, 20, 3)
    assert image.dtype == np.uint8
    assert tuple(int(v) for v in image[5, 5]) == expected


def test_cmyk_is_converted():
    image = decode_image(encoded(plain("CMYK", (0, 255, 255, 0)), "JPEG"), "x")
    assert image[5, 5, 2] > 200
    assert image[5, 5, 0] < 60


@pytest.mark.parametrize(
    ("orientation", "corner"),
    [(1, (0, 0)), (2, (0, -1)), (3, (-1, -1)), (4, (-1, 0)), (5, (0, 0)), (6, (0, -1)), (7, (-1, -1)), (8, (-1, 0))],
)
def test_exif_orientation_is_applied(orientation, corner):
    """The stored image is white at its first row and column; a viewer shows that corner where EXIF says."""
    stored = np.zeros((16, 32, 3), dtype=np.uint8)
    stored[:8, :8] = 255
    photo = Image.fromarray(stored)
    exif = photo.getexif()
    exif[0x0112] = orientation
    shown = decode_image(encoded(photo, "JPEG", exif=exif), "x")
    assert shown.shape == ((32, 16, 3) if orientation > 4 else (16, 32, 3))
    corners = {place: shown[place].mean() > 128 for place in ((0, 0), (0, -1), (-1, 0), (-1, -1))}
    assert corners == {place: place == corner for place in corners}


@pytest.mark.parametrize("kind", ["JPEG", "PNG"])
def test_half_a_file_is_refused(kind):
    noise = np.random.default_rng(0).integers(0, 255, (80, 80, 3), dtype=np.uint8)
    data = encoded(Image.fromarray(noise), kind)
    with pytest.raises(InputError) as caught:
        decode_image(data[: len(data) // 2], "half.jpg")
    assert caught.value.code == "image_truncated"
    assert "half.jpg" in caught.value.message


@pytest.mark.parametrize(("data", "code"), [(b"", "image_empty"), (b"hello", "not_an_image")])
def test_what_is_no_image_is_refused(data, code):
    with pytest.raises(InputError) as caught:
        decode_image(data, "x")
    assert caught.value.code == code


@given(st.binary(max_size=200))
def test_junk_never_brings_anything_but_a_clear_error(data):
    for start in (b"", b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff\xe0", b"BM", b"II*\x00"):
        with pytest.raises(InputError):
            decode_image(start + data, "junk")


def test_bombs_are_refused_before_they_unfold(monkeypatch):
    monkeypatch.setattr(images, "MAX_PIXELS", 199)
    with pytest.raises(InputError) as caught:
        decode_image(encoded(plain("RGB", RED_RGB)), "bomb.png")
    assert caught.value.code == "image_too_large"


def test_large_files_are_refused_unread(monkeypatch, tmp_path):
    (tmp_path / "big.png").write_bytes(encoded(plain("RGB", RED_RGB)))
    monkeypatch.setattr(images, "MAX_BYTES", 10)
    with pytest.raises(InputError) as caught:
        read_image(tmp_path / "big.png")
    assert caught.value.code == "image_too_large"


def test_paths_of_any_script_are_read(tmp_path):
    path = tmp_path / "объект-図-ü.png"
    path.write_bytes(encoded(plain("RGB", RED_RGB)))
    assert read_image(path).shape == (10, 20, 3)


def test_photographs_in_heic_are_read_or_their_extra_is_named(tmp_path, monkeypatch):
    pillow_heif = pytest.importorskip("pillow_heif")
    shown = np.zeros((64, 80, 3), np.uint8)
    shown[:, 40:] = (30, 200, 90)
    path = tmp_path / "photo.heic"
    pillow_heif.from_pillow(Image.fromarray(shown)).save(path, quality=95)
    found = read_image(path)
    assert found.shape == (64, 80, 3)
    assert np.abs(found[:, [10, 70]].astype(int) - shown[:, [10, 70], ::-1]).max() < 12
    monkeypatch.setitem(sys.modules, "pillow_heif", None)
    with pytest.raises(InputError, match="pillow-heif"):
        read_image(path)
