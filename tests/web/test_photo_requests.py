"""Photographs of prints: what is stored, what is graded, what is refused."""

from __future__ import annotations

import io

import numpy as np
import pytest
from PIL import Image

from lmkit.web.answers import MAX_UPLOAD


def test_the_check_of_a_print_finds_what_is_printed(client, printed, folder):
    data = (folder / printed["file"]).read_bytes()
    name = client.put("/api/photos/scan.pdf", content=data).json()["name"]
    checked = client.post(f"/api/photos/{name}/check", json={"print": printed["file"]}).json()
    assert sorted(r["code"] for r in checked["results"]) == [3, 7]
    assert all(r["grade"] == "A" for r in checked["results"])
    assert checked["results"][0]["image"].startswith("data:image/jpeg;base64,")
    assert len(checked["history"]["lm8:3"]) == 1
    made = client.post(f"/api/photos/{name}/certificate", json={}).json()
    assert client.get(f"/api/files/{made['file']}").content[:4] == b"%PDF"


def test_an_image_without_a_landmark_says_what_to_do(client):
    image = io.BytesIO()
    Image.fromarray(np.full((200, 300, 3), 160, np.uint8)).save(image, "PNG")
    name = client.put("/api/photos/plain.png", content=image.getvalue()).json()["name"]
    reply = client.post(f"/api/photos/{name}/check", json={"size": "180mm"})
    assert reply.status_code == 400 and "fill" in reply.json()["hint"]


@pytest.mark.parametrize(
    ("name", "data"),
    [
        ("a.png", b"no image"), ("a.png", b""), ("a.svg", b"<svg onload='alert(1)'/>"), ("a.html", b"<script>"),
        ("a.png", b"%PDF-1.7"), ("a.pdf", b"GIF89a"), ("a.png", b"\x89PNG\r\n\x1a\n" + b"\xff" * 99),
    ],
)  # fmt: skip
def test_what_is_no_image_is_not_stored(client, folder, name, data):
    before = set((folder / "photos").glob("*")) if (folder / "photos").exists() else set()
    assert client.put(f"/api/photos/{name}", content=data).status_code == 400
    assert (set((folder / "photos").glob("*")) if (folder / "photos").exists() else set()) == before


def test_an_upload_may_have_64_mib_and_no_byte_more(client, folder, monkeypatch):
    from lmkit.web import photos

    assert MAX_UPLOAD == 64 << 20
    before = set(folder.rglob("*"))
    assert client.put("/api/photos/large.png", content=bytes(MAX_UPLOAD + 1)).json()["code"] == "too_large"
    monkeypatch.setattr(photos, "MAX_UPLOAD", 1000)
    image = io.BytesIO()
    Image.fromarray(np.zeros((8, 8, 3), np.uint8)).save(image, "PNG")
    full = image.getvalue() + bytes(1000 - len(image.getvalue()))
    assert client.put("/api/photos/full.png", content=full).is_success
    assert client.put("/api/photos/over.png", content=full + b"0").status_code == 413
    assert {p.name for p in set(folder.rglob("*")) - before} <= {"full.png", "photos"}
