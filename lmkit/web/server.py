"""Starting the server: address, token, and a port that is free."""

from __future__ import annotations

import secrets
import socket
import webbrowser
from collections.abc import Callable
from pathlib import Path

from lmkit.errors import EXTRA, InputError
from lmkit.web.project import open_project

PORT = 8600
TRIED = 20  # ports after the first
LOOPBACK = ("127.0.0.1", "localhost", "::1")


def serve(folder: Path, host: str, port: int | None, tell: Callable[[str], None], open_browser: bool = False) -> None:
    """Serve the page over a folder until it is interrupted.

    Args:
        host: 127.0.0.1 for this machine only; other addresses require the printed token.
        port: None for the first free one from 8600 on.
        tell: called with the lines for the terminal.

    Raises:
        InputError: the extra is missing, the folder cannot be written to, or the port is taken.
    """
    try:
        import uvicorn
        import websockets  # noqa: F401

        from lmkit.web.app import build_app
    except ImportError as error:
        raise InputError("no_extra", f"the page needs {error.name}", EXTRA.format("web")) from None
    project = open_project(folder)
    local = host in LOOPBACK
    token = None if local else secrets.token_urlsafe(18)
    listener = listen(host, port)
    number = listener.getsockname()[1]
    shown = f"[{host}]" if ":" in host else host
    if not local:
        shown = reachable_name() if host in ("0.0.0.0", "::") else shown
    address = f"http://{shown}:{number}/" + (f"?token={token}" if token else "")
    app = build_app(project, token, None if local else address)
    tell(f"project  {project.root}")
    tell(f"page     {address}")
    tell("stop with Ctrl-C")
    if open_browser:
        webbrowser.open(address)
    config = uvicorn.Config(
        app,
        log_level="warning",
        access_log=False,
        server_header=False,
        ws="websockets-sansio",
        ws_max_size=1 << 20,
        limit_concurrency=100,
        timeout_graceful_shutdown=3,
    )
    uvicorn.Server(config).run(sockets=[listener])


def listen(host: str, port: int | None) -> socket.socket:
    """A listening socket.

    Raises:
        InputError: no such address here, or no port is free.
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    problem = ""
    for number in (port,) if port is not None else range(PORT, PORT + TRIED):
        listener = socket.socket(family, socket.SOCK_STREAM)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listener.bind((host, number))
            listener.listen(128)
            listener.setblocking(False)
            return listener
        except OSError as error:
            listener.close()
            problem = error.strerror or str(error)
    where = f"{host}:{port if port is not None else PORT}"
    raise InputError("no_port", f"cannot listen on {where}: {problem}", "choose another --host or --port")


def reachable_name() -> str:
    """The address at which other machines can probably reach this one."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            # Nothing is sent: connecting a datagram socket only looks up the route.
            probe.connect(("192.0.2.1", 9))
            return str(probe.getsockname()[0])
        except OSError:
            return socket.gethostname()
