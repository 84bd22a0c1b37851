"""The rig of the project: shown, replaced by a file of any format that lmkit reads, and undone."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from starlette.requests import Request
from starlette.responses import Response

import lmkit as lm
from lmkit.errors import InputError
from lmkit.web.answers import MAX_JSON, answer, read_bytes
from lmkit.web.project import Project
from lmkit.web.state import state_of
from lmkit.web.versions import count_versions, keep_versions, restore_versions

RIG = "rig.yaml"


async def show(request: Request) -> Response:
    """Cameras of the rig; none where the project has no rig."""
    state = state_of(request)
    return answer(await state.workers.run(describe_rig, state.project))


async def replace(request: Request) -> Response:
    """Replace the rig by the file in the body; the rig before is kept for undo."""
    state, data = state_of(request), await read_bytes(request, MAX_JSON)
    rig = await state.workers.run(rig_of, data)
    keep_versions(state.project, RIG)
    lm.write_rig(rig, state.project.path(RIG), overwrite=True)
    return answer(await state.workers.run(describe_rig, state.project))


async def undo(request: Request) -> Response:
    """Go back by one change."""
    state = state_of(request)
    restore_versions(state.project, RIG)
    return answer(await state.workers.run(describe_rig, state.project))


def rig_of(data: bytes) -> Any:
    """The rig of a file's bytes.

    Raises:
        InputError: no rig file of a format that lmkit reads.
    """
    with TemporaryDirectory() as folder:
        path = Path(folder) / RIG
        path.write_bytes(data)
        try:
            return lm.read_rig(path)
        except InputError as error:
            # The file has no name that its sender knows.
            raise InputError(error.code, error.message.replace(str(path), "this file"), error.hint) from None


def describe_rig(project: Project) -> dict[str, Any]:
    """Cameras of ``rig.yaml`` with their focal lengths, and how far apart they are."""
    from lmkit.geometry.rig import mounted_cameras

    path = project.path(RIG)
    undo = count_versions(project, RIG)
    if not path.is_file():
        return {"cameras": [], "undo": undo}
    cameras = [
        {"name": c.name, "size": list(c.model.image_size), "focal_px": float(c.model.K[0, 0])}
        for c in mounted_cameras(lm.read_rig(path))
    ]
    return {"cameras": cameras, "undo": undo, "command": f"lmkit convert NEW_RIG -o {RIG} --force"}
