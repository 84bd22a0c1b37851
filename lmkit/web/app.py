"""The server: one page, its files, and its routes."""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator
from pathlib import Path

from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import FileResponse, Response
from starlette.routing import BaseRoute, Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp
from starlette.websockets import WebSocket, WebSocketDisconnect

from lmkit.errors import InputError
from lmkit.version import __version__
from lmkit.web import cameras, films, floors, maps, photos, prints, rigs, verbs
from lmkit.web.answers import Handler, answer, guarded
from lmkit.web.jobs import Jobs
from lmkit.web.project import Project, listing
from lmkit.web.security import FILE_POLICY, Guard
from lmkit.web.state import State, state_of
from lmkit.web.workers import Workers, warm_up

STATIC = Path(__file__).parent / "static"


def build_app(
    project: Project, token: str | None = None, address: str | None = None, workers: Workers | None = None
) -> ASGIApp:
    """The page over one project.

    Args:
        token: token required in every request; None if only this machine has access.
        address: address of the page for a phone, shown as a QR code; None if only this machine has access.
        workers: run work that takes seconds; None: new worker processes.
    """
    app = Starlette(routes=routes(), lifespan=_lifespan)
    app.state.lmkit = State(project, workers or Workers(), Jobs(project.root), address=address)
    app.state.token = token
    return Guard(app, token)


def state_of_app(app: ASGIApp) -> State:
    """The state of a built app, for producers outside the server, such as a live run."""
    assert isinstance(app, Guard)
    inner = app.inner
    assert isinstance(inner, Starlette)
    state = inner.state.lmkit
    assert isinstance(state, State)
    return state


@contextlib.asynccontextmanager
async def _lifespan(app: Starlette) -> AsyncIterator[None]:
    import asyncio

    state: State = app.state.lmkit
    # Loads the libraries while the user looks at the first page.
    warming = asyncio.create_task(_warm(state))
    yield
    warming.cancel()
    await state.jobs.close()
    state.workers.close()


async def _warm(state: State) -> None:
    with contextlib.suppress(InputError):
        await state.workers.run(warm_up)


def routes() -> list[BaseRoute]:
    """All routes of the server."""

    def route(path: str, handler: Handler, method: str = "GET") -> Route:
        return Route(path, guarded(handler), methods=[method])

    return [
        Route("/", _index),
        route("/api/project", _project),
        route("/api/phone.png", _phone),
        route("/api/files/{name:path}", _file),
        route("/api/prints/choices", prints.choices),
        route("/api/prints/preview", prints.preview, "POST"),
        route("/api/prints/pdf", prints.make, "POST"),
        route("/api/photos/{name}", photos.upload, "PUT"),
        route("/api/photos/{name}/check", photos.check, "POST"),
        route("/api/photos/{name}/certificate", photos.certify, "POST"),
        route("/api/films/{name}", films.upload, "PUT"),
        route("/api/cameras", cameras.sources),
        route("/api/cameras/look", cameras.look, "POST"),
        route("/api/map", maps.show),
        route("/api/map", maps.edit, "PUT"),
        route("/api/map/undo", maps.undo, "POST"),
        route("/api/floor", floors.show),
        route("/api/floor", floors.edit, "PUT"),
        route("/api/floor/{name}", floors.load, "PUT"),
        route("/api/rig", rigs.show),
        route("/api/rig", rigs.take, "PUT"),
        route("/api/rig/mount", rigs.mount, "PUT"),
        route("/api/rig/undo", rigs.undo, "POST"),
        route("/api/jobs", _jobs),
        route("/api/jobs/{verb}", verbs.start, "POST"),
        route("/api/jobs/{id}", _job),
        route("/api/jobs/{id}/cancel", _cancel, "POST"),
        route("/api/jobs/{id}/finish", _finish, "POST"),
        route("/api/live/map", _live_map),
        WebSocketRoute("/api/live", _live),
        Mount("/static", StaticFiles(directory=STATIC)),
    ]


async def _index(request: Request) -> Response:
    return FileResponse(STATIC / "index.html", headers={"cache-control": "no-cache"})


async def _project(request: Request) -> Response:
    state = state_of(request)
    facts = listing(state.project)
    return answer(facts | {"version": __version__, "can_run": verbs.can_run(), "address": state.address})


async def _phone(request: Request) -> Response:
    """The address as a QR code."""
    state = state_of(request)
    if state.address is None:
        hint = "start lmkit web with --host 0.0.0.0"
        raise InputError("no_file", "this page is reachable from this machine only", hint)
    return Response(await state.workers.run(qr_code, state.address), media_type="image/png")


def qr_code(text: str) -> bytes:
    """A QR code as PNG."""
    import cv2
    import numpy as np

    from lmkit.visualization.overlay import encode_png

    code = np.asarray(cv2.QRCodeEncoder.create().encode(text), dtype=np.uint8)
    large = cv2.resize(code, None, fx=8, fy=8, interpolation=cv2.INTER_NEAREST)
    return encode_png(np.repeat(np.asarray(large, dtype=np.uint8)[:, :, None], 3, axis=2))


async def _file(request: Request) -> Response:
    """A result of the project, to view or to save."""
    name = request.path_params["name"]
    path = state_of(request).project.public(name)
    headers = {"content-security-policy": FILE_POLICY}
    kind = "attachment" if "download" in request.query_params else "inline"
    return FileResponse(path, headers=headers, filename=path.name, content_disposition_type=kind)


async def _jobs(request: Request) -> Response:
    return answer({"jobs": [job.as_dict() for job in state_of(request).jobs.all()]})


async def _job(request: Request) -> Response:
    return answer(state_of(request).jobs.find(request.path_params["id"]).as_dict(with_log=True))


async def _cancel(request: Request) -> Response:
    jobs = state_of(request).jobs
    job = jobs.find(request.path_params["id"])
    jobs.cancel(job)
    return answer(job.as_dict())


async def _finish(request: Request) -> Response:
    jobs = state_of(request).jobs
    job = jobs.find(request.path_params["id"])
    jobs.finish(job)
    return answer(job.as_dict())


async def _live_map(request: Request) -> Response:
    """Landmarks and walls of the newest run, or of the project before there was one."""
    state = state_of(request)
    hub = state.live
    if hub.landmarks is not None:
        return answer({"landmarks": hub.landmarks, "walls": hub.walls, "run": hub.run})
    return answer(await maps.drawn(state) | {"run": hub.run})


async def _live(socket: WebSocket) -> None:
    """Live states, until the browser leaves."""
    hub = state_of(socket).live
    queue = hub.watch()
    await socket.accept()
    if queue is None:
        await socket.close(1013)
        return
    import asyncio

    gone = asyncio.create_task(_until_gone(socket))
    try:
        while not gone.done():
            getting = asyncio.create_task(queue.get())
            done, _ = await asyncio.wait({getting, gone}, return_when=asyncio.FIRST_COMPLETED)
            if getting not in done:
                getting.cancel()
                return
            await socket.send_bytes(getting.result())
    except (WebSocketDisconnect, RuntimeError):
        pass
    finally:
        gone.cancel()
        hub.leave(queue)


async def _until_gone(socket: WebSocket) -> None:
    with contextlib.suppress(WebSocketDisconnect, RuntimeError):
        while True:
            await socket.receive_bytes()
