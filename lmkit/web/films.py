"""Films of a board or of a recording, uploaded into ``films/`` once their first frame can be read."""

from __future__ import annotations

import secrets
from pathlib import PurePosixPath

from starlette.requests import Request
from starlette.responses import Response

from lmkit.errors import InputError
from lmkit.web.answers import answer
from lmkit.web.project import FILMS, NAME, Project
from lmkit.web.state import state_of

FOLDER = "films"
MOST_BYTES = 1 << 30
MOST_PIXELS = 1 << 26  # of one frame


async def upload(request: Request) -> Response:
    """Store a film; it is removed if the upload is incomplete or has no readable frame."""
    state, given = state_of(request), request.path_params["name"]
    suffix = PurePosixPath(given).suffix.lower()
    if suffix not in FILMS:
        kinds = ", ".join(sorted(kind[1:].upper() for kind in FILMS))
        raise InputError("not_film", f"{given[:80]}: not a film by its name", f"give {kinds}")
    folder = state.project.path(FOLDER)
    folder.mkdir(exist_ok=True)
    part = folder / f".part-{secrets.token_hex(8)}{suffix}"
    try:
        size = 0
        with part.open("xb") as stream:
            async for data in request.stream():
                size += len(data)
                if size > MOST_BYTES:
                    raise InputError(
                        "too_large", f"more than {MOST_BYTES >> 20} MiB", "copy it into the project instead"
                    )
                stream.write(data)
        await state.workers.run(require_frame, str(part))
        name = _free_name(state.project, given, suffix)
        part.rename(state.project.path(name))
    finally:
        part.unlink(missing_ok=True)
    return answer({"name": name})


def require_frame(path: str) -> None:
    """Refuse a file without a readable frame.

    Raises:
        InputError: it is not a film, or its frames are too large.
    """
    from lmkit.io.image_sources import video_frames

    frame = next(video_frames(path))
    if frame.image is None:
        raise InputError("not_film", "no frame of this film can be read", "give MP4 (H.264), AVI, MOV, MKV or WebM")
    if frame.image.shape[0] * frame.image.shape[1] > MOST_PIXELS:
        raise InputError("too_large", "its frames have too many pixels", "film at 4K or less")


def _free_name(project: Project, given: str, suffix: str) -> str:
    stem = "".join(c if NAME.fullmatch(f"a{c}") else "-" for c in PurePosixPath(given).stem)[:60].strip(" .-")
    return project.unused(FOLDER, stem or "film", suffix)
