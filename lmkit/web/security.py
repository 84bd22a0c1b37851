"""Access control of the page, and its content security policy.

Bound to this machine, only requests for its own addresses are answered, so that a foreign site whose name resolves
to this machine has no access.  Bound to a network, every request needs the token of the printed address.
"""

from __future__ import annotations

import hmac
from collections.abc import Mapping
from html import escape
from http.cookies import CookieError, SimpleCookie
from urllib.parse import parse_qs, urlsplit

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import HTMLResponse, JSONResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

COOKIE = "lmkit_token"
LOOPBACK = frozenset({"127.0.0.1", "localhost", "::1"})
SAFE = frozenset({"GET", "HEAD"})
PAGE_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; connect-src 'self'; "
    "font-src 'self'; manifest-src 'self'; media-src 'self' blob:; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'"
)
# Reports contain their own styles and no scripts.
FILE_POLICY = "default-src 'none'; style-src 'unsafe-inline'; img-src data:; sandbox"
HEADERS = {
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cross-origin-resource-policy": "same-origin",
    "x-frame-options": "DENY",
    "permissions-policy": "camera=(self), microphone=(), geolocation=()",
}
# Browsers apply it to trustworthy addresses only, and warn at others, such as network addresses without encryption.
LOCAL_HEADERS = {**HEADERS, "cross-origin-opener-policy": "same-origin"}
REFUSAL = (
    '<!doctype html><html lang="en"><meta charset="utf-8"><meta name="viewport" content="width=device-width">'
    '<meta name="color-scheme" content="light dark"><title>lmkit</title><h1>lmkit</h1><p>{}.</p><p>{}.</p>'
)


class Guard:
    """Refuses foreign requests, and adds the policy to every response.

    Args:
        app: the guarded application.
        token: token required in every request; None if only this machine has access.
    """

    def __init__(self, app: ASGIApp, token: str | None) -> None:
        self.inner = self._app = app
        self._token = token

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        problem = self._problem(scope, headers)
        if problem is None and self._token is not None and not self._carries_token(headers):
            if scope["type"] == "http" and self._in_address(scope):
                # First request from the printed address: the token moves from the address bar to a cookie.
                answer: Response = RedirectResponse("/", status_code=303)
                answer.set_cookie(COOKIE, self._token, httponly=True, samesite="strict", max_age=30 * 86400)
                await self._answer(answer, scope, receive, send)
                return
            problem = "this address needs the token that lmkit web printed"
        if problem is not None:
            await self._refuse(problem, scope, receive, send)
            return
        await self._app(scope, receive, self._with_policy(send) if scope["type"] == "http" else send)

    def _problem(self, scope: Scope, headers: Headers) -> str | None:
        """Why a request is foreign, or None."""
        host = headers.get("host", "")
        if self._token is None and _hostname(host) not in LOOPBACK:
            return f"{host[:80]!r} is not an address of this machine"
        changes = scope["type"] == "websocket" or scope["method"] not in SAFE
        origin = headers.get("origin")
        if changes and origin is not None and urlsplit(origin).netloc != host:
            return "the request comes from another site"
        if changes and headers.get("sec-fetch-site", "same-origin") not in ("same-origin", "none"):
            return "the request comes from another site"
        return None

    def _carries_token(self, headers: Headers) -> bool:
        return self._is_token(_cookies(headers).get(COOKIE, ""))

    def _in_address(self, scope: Scope) -> bool:
        given = parse_qs(scope.get("query_string", b"").decode("latin-1")).get("token", [""])
        return self._is_token(given[0])

    def _is_token(self, text: str) -> bool:
        return hmac.compare_digest(text.encode(), (self._token or "").encode())

    async def _refuse(self, problem: str, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "websocket":
            await receive()
            await send({"type": "websocket.close", "code": 1008})
            return
        hint = "open the address that lmkit web prints in the terminal"
        answer: Response = JSONResponse({"code": "refused", "message": problem, "hint": hint}, 403)
        if "text/html" in Headers(scope=scope).get("accept", ""):  # a user opens the address
            words = problem[:1].upper() + problem[1:], hint[:1].upper() + hint[1:]
            answer = HTMLResponse(REFUSAL.format(*map(escape, words)), 403)
        await self._answer(answer, scope, receive, send)

    async def _answer(self, answer: Response, scope: Scope, receive: Receive, send: Send) -> None:
        await answer(scope, receive, self._with_policy(send))

    def _with_policy(self, send: Send) -> Send:
        return _with_headers(send, LOCAL_HEADERS if self._token is None else HEADERS)


def _with_headers(send: Send, added: Mapping[str, str]) -> Send:
    async def wrapped(message: Message) -> None:
        if message["type"] == "http.response.start":
            headers = MutableHeaders(scope=message)
            for name, value in added.items():
                headers.setdefault(name, value)
            headers.setdefault("content-security-policy", PAGE_POLICY)
            headers.setdefault("cache-control", "no-store")
        await send(message)

    return wrapped


def _hostname(host: str) -> str | None:
    try:
        return urlsplit(f"//{host}").hostname
    except ValueError:
        return None


def _cookies(headers: Headers) -> Mapping[str, str]:
    try:
        return {name: morsel.value for name, morsel in SimpleCookie(headers.get("cookie", "")).items()}
    except CookieError:
        return {}
