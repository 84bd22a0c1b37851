"""`lmkit web`: the page in the browser."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from lmkit.errors import InputError


def run(
    folder: Annotated[Path, typer.Argument(help="Project folder; created if missing.")] = Path(),
    host: Annotated[
        str,
        typer.Option("--host", help="Address to listen on. 0.0.0.0 lets phones in the network connect with a token."),
    ] = "127.0.0.1",
    port: Annotated[int | None, typer.Option("--port", help="Port. Default: the first free one from 8600.")] = None,
    browser: Annotated[bool, typer.Option("--open", help="Open the page in the browser.")] = False,
) -> None:
    """Serve lmkit as a page in the browser. Print, check prints, calibrate, survey, and look at the map."""
    if port is not None and not 0 <= port <= 65535:
        raise InputError("out_of_range", f"--port {port} is outside 0 to 65535", "leave it out for a free one")
    from lmkit.web.server import serve

    def tell(line: str) -> None:
        sys.stdout.write(line + "\n")
        sys.stdout.flush()

    serve(folder, host, port, tell, browser)
