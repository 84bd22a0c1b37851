"""Every endpoint, new ones included: foreign, shapeless and oversized requests are refused."""

from __future__ import annotations

import pytest
from starlette.routing import Route

from lmkit.web.answers import MAX_JSON
from lmkit.web.app import routes

ENDPOINTS = [
    (method, route.path) for route in routes() if isinstance(route, Route) for method in sorted(route.methods or ())
]
CHANGES = [(method, path) for method, path in ENDPOINTS if method in ("POST", "PUT")]
# Endpoints without a body, or with a body that is not JSON and has its own tests.
WITHOUT_JSON = {
    "photos/{name}",
    "map/undo",
    "rig",
    "rig/undo",
    "floor/{name}",
    "jobs/{id}/cancel",
    "jobs/{id}/finish",
    "films/{name}",
}


def _filled(path: str) -> str:
    named = path.replace("{name:path}", "prints/x").replace("{name}", "x.png")
    return named.replace("{id}", "99").replace("{verb}", "run")


@pytest.mark.parametrize(("method", "path"), ENDPOINTS)
def test_foreign_hosts_and_foreign_origins_are_refused(client, method, path):
    assert client.request(method, _filled(path), headers={"host": "evil.example"}).status_code == 403
    if method in ("POST", "PUT"):
        reply = client.request(method, _filled(path), headers={"origin": "http://evil.example"}, content=b"{}")
        assert reply.status_code == 403 and reply.json()["hint"]


@pytest.mark.parametrize(("method", "path"), [c for c in CHANGES if c[1].removeprefix("/api/") not in WITHOUT_JSON])
def test_shapeless_and_oversized_bodies_are_refused_with_a_hint(client, method, path):
    bodies = (b"\xff{", b"[]", b"null", b'"x"', b'{"no_such_key": 1}', b'{"x": NaN}', b"[" * 100_000)
    for body in bodies:
        reply = client.request(method, _filled(path), content=body)
        assert reply.status_code == 400 and reply.json()["hint"], (body[:20], reply.text)
    assert client.request(method, _filled(path), content=b" " * (MAX_JSON + 1)).status_code == 413


@pytest.mark.parametrize(("method", "path"), ENDPOINTS)
def test_other_methods_are_refused_and_answers_carry_the_policy(client, method, path):
    reply = client.request("DELETE", _filled(path))
    assert reply.status_code == 405 and "default-src 'none'" in reply.headers["content-security-policy"]
    assert reply.headers["x-content-type-options"] == "nosniff"
