"""Prints: previews, proven files, and requests that are refused."""

from __future__ import annotations

import pytest


def test_a_print_is_previewed_and_its_command_parses(client):
    p = client.post("/api/prints/preview", json={"codes": "0-11", "size": "180mm", "paper": "a4"}).json()
    assert (p["landmarks"], p["count"], len(p["pages"])) == (12, 12, 6)
    assert p["pages"][0]["svg"].startswith("<?xml") and p["command"].startswith("lmkit generate --codes 0-11")
    assert p["reads_from_m"] == pytest.approx(0.18 * 600 / 17.5)


def test_the_pdf_is_proven_and_can_be_fetched(client, printed, folder):
    assert printed["landmarks"] == 2
    reply = client.get(f"/api/files/{printed['file']}?download")
    assert reply.content[:4] == b"%PDF" and "sandbox" in reply.headers["content-security-policy"]
    assert reply.headers["content-disposition"].startswith("attachment")
    assert (folder / f"{printed['file']}.json").is_file()


@pytest.mark.parametrize(
    ("body", "code"),
    [
        ({"codes": "0-99999"}, None),
        ({"codes": "x"}, None),
        ({"codes": "1", "size": "-4mm"}, None),
        ({"codes": "1", "template": "../../etc/passwd"}, "unknown_template"),
        ({"codes": "1", "family": "nope"}, "unknown_family"),
        ({"codes": "1", "else": 1}, "bad_value"),
        ({}, "bad_value"),
    ],
)
def test_a_wrong_print_is_refused_with_a_hint(client, body, code):
    for end in ("preview", "pdf"):
        reply = client.post(f"/api/prints/{end}", json=body)
        assert reply.status_code == 400 and reply.json()["hint"]
        assert code is None or reply.json()["code"] == code
