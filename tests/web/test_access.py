"""Which requests are answered, and which files can be reached."""

from __future__ import annotations

from pathlib import Path

import pytest
from starlette.testclient import TestClient
from starlette.websockets import WebSocketDisconnect

import lmkit
from lmkit.errors import InputError
from lmkit.web.app import build_app
from lmkit.web.project import open_project
from lmkit.web.workers import Workers

HOSTILE = [
    "../secret", "..%2fsecret", "%2e%2e/secret", "/etc/passwd", "prints/../../secret", "prints\\..\\secret",
    ".lmkit-undo/x", "prints/.hidden", "prints/a%00b", "reports/" + "a" * 300, "map.yaml", "photos/link/secret",
]  # fmt: skip


@pytest.mark.parametrize("name", HOSTILE)
def test_no_path_leads_out_of_the_project(client, folder, name):
    (folder.parent / "secret").write_text("TOP SECRET")
    (folder / "map.yaml").touch()
    (folder / "photos").mkdir(exist_ok=True)
    link = folder / "photos" / "link"
    if not link.is_symlink():
        link.symlink_to(folder.parent)
    try:
        reply = client.get(f"/api/files/{name}")
        assert reply.status_code in (400, 404) and "TOP" not in reply.text
        with pytest.raises(InputError):
            open_project(folder).public(name)
        assert client.get(f"/static/{name}").status_code in (404, 405)
        body = {"source": name, "board": "chessboard:9x6:25mm"}
        for verb in ("survey", "track", "calibrate", "guide"):
            assert client.post(f"/api/jobs/{verb}", json=body).status_code == 400
    finally:
        link.unlink()
        (folder / "map.yaml").unlink()


def test_foreign_sites_are_refused(client):
    assert client.get("/api/project", headers={"host": "evil.example"}).status_code == 403
    opened = client.get("/", headers={"host": "<b>.example", "accept": "text/html"})
    assert opened.status_code == 403 and "<h1>lmkit" in opened.text and "<b>" not in opened.text
    for headers in ({"origin": "http://evil.example"}, {"origin": "null"}, {"sec-fetch-site": "cross-site"}):
        assert client.post("/api/jobs/example", json={}, headers=headers).status_code == 403
    assert client.post(
        "/api/prints/preview", json={"codes": "1"}, headers={"origin": "http://127.0.0.1:8600"}
    ).is_success
    foreign = {"host": "127.0.0.1:8600", "origin": "http://evil.example"}
    with pytest.raises(WebSocketDisconnect), client.websocket_connect("/api/live", headers=foreign):
        pass


def test_with_a_host_every_request_needs_the_token(tmp_path):
    app = build_app(open_project(tmp_path), "sesame", "http://10.0.0.2:8600/?token=sesame", Workers(0))
    with TestClient(app, base_url="http://10.0.0.2:8600") as page:
        for path in ("/", "/static/app.js", "/api/project", "/?token=wrong", "/api/phone.png"):
            assert page.get(path).status_code == 403
        with pytest.raises(WebSocketDisconnect), page.websocket_connect("/api/live"):
            pass
        first = page.get("/?token=sesame", follow_redirects=False)
        assert first.status_code == 303 and first.headers["location"] == "/"
        assert "HttpOnly" in first.headers["set-cookie"] and "samesite=strict" in first.headers["set-cookie"].lower()
        assert page.get("/api/project").json()["address"].endswith("sesame")
        assert page.get("/api/phone.png").content[:4] == b"\x89PNG"


def test_the_page_asks_for_nothing_from_elsewhere(client):
    reply = client.get("/")
    assert "default-src 'none'" in reply.headers["content-security-policy"]
    static = Path(lmkit.__file__).parent / "web/static"
    own = [path for path in static.rglob("*.*") if "vendor" not in path.parts]
    for path in own:
        text = path.read_text(encoding="utf-8").replace("http://www.w3.org/2000/svg", "")
        assert "http://" not in text and "https://" not in text and "innerHTML" not in text, path.name
    assert sum(path.stat().st_size for path in own) < 500_000
