"""The rig of the project: shown, replaced by a file of any format that lmkit reads, placed on the robot, undone."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import numpy as np
from pydantic import Field
from starlette.requests import Request
from starlette.responses import Response

import lmkit as lm
from lmkit.errors import InputError
from lmkit.geometry.stereo_rig import mounted_ahead
from lmkit.web.answers import MAX_JSON, Body, answer, read_body, read_bytes
from lmkit.web.project import Project
from lmkit.web.state import state_of
from lmkit.web.versions import count_versions, keep_versions, restore_versions

RIG = "rig.yaml"
Meters = Annotated[float, Field(ge=-20, le=20)]


class MountBody(Body):
    """Pose of the left camera on the robot, whose base is on the floor.

    Attributes:
        height_m, forward_m, left_m: from the base, meters.
        turned_deg: rotation of its view to the robot's left.
        raised_deg: elevation of its view above the horizon.
    """

    height_m: Annotated[float, Field(gt=0, le=20)]
    forward_m: Meters = 0.0
    left_m: Meters = 0.0
    turned_deg: Annotated[float, Field(ge=-180, le=180)] = 0.0
    raised_deg: Annotated[float, Field(ge=-90, le=90)] = 0.0


async def show(request: Request) -> Response:
    """Cameras of the rig; none if the project has no rig."""
    state = state_of(request)
    return answer(await state.workers.run(describe_rig, state.project))


async def take(request: Request) -> Response:
    """Replace the rig by the file in the body; the previous rig is kept for undo."""
    state, data = state_of(request), await read_bytes(request, MAX_JSON)
    rig = await state.workers.run(rig_of, data)
    keep_versions(state.project, RIG)
    lm.write_rig(rig, state.project.path(RIG), overwrite=True)
    return answer(await state.workers.run(describe_rig, state.project))


async def mount(request: Request) -> Response:
    """Set the pose of the left camera on the robot; the previous rig is kept for undo."""
    state, body = state_of(request), await read_body(request, MountBody)
    path = state.project.path(RIG)
    if not path.is_file():
        raise InputError("no_rig", "the project has no rig.yaml", "calibrate first, or take a file")
    rig = await state.workers.run(lm.read_rig, path)
    keep_versions(state.project, RIG)
    lm.write_rig(replace(rig, T_base_left=mounted(body)), path, overwrite=True)
    return answer(await state.workers.run(describe_rig, state.project))


async def undo(request: Request) -> Response:
    """Undo one change of the rig."""
    state = state_of(request)
    restore_versions(state.project, RIG)
    return answer(await state.workers.run(describe_rig, state.project))


def mounted(body: MountBody) -> lm.Pose:
    """T_base_left; x ahead, y to the left, z up."""
    (c, s), (d, e) = ((np.cos(a), np.sin(a)) for a in np.radians([body.turned_deg, body.raised_deg]))
    ahead = mounted_ahead(body.height_m)
    raised = np.array([[d, 0.0, -e], [0.0, 1.0, 0.0], [e, 0.0, d]])
    R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ raised @ ahead.R
    return lm.Pose("base", "left", R, np.array([body.forward_m, body.left_m, body.height_m]))


def _mount_of(T_base_left: lm.Pose | None) -> dict[str, float] | None:
    """Values of `MountBody` for a pose; None where it is not known."""
    if T_base_left is None:
        return None
    (x, y, z), view = T_base_left.t, T_base_left.R[:, 2]
    turned, raised = np.degrees([np.arctan2(view[1], view[0]), np.arcsin(np.clip(view[2], -1, 1))])
    values = {"height_m": z, "forward_m": x, "left_m": y, "turned_deg": turned, "raised_deg": raised}
    return {name: round(float(value), 6) for name, value in values.items()}


def rig_of(data: bytes) -> Any:
    """The rig of a file's bytes.

    Raises:
        InputError: not a rig file of a format that lmkit reads.
    """
    with TemporaryDirectory() as folder:
        path = Path(folder) / RIG
        path.write_bytes(data)
        try:
            return lm.read_rig(path)
        except InputError as error:
            # The temporary file's name is unknown to the sender.
            raise InputError(error.code, error.message.replace(str(path), "this file"), error.hint) from None


def describe_rig(project: Project) -> dict[str, Any]:
    """Cameras of ``rig.yaml`` with their focal lengths, and their distances from the first."""
    from lmkit.geometry.rig import mounted_cameras

    path = project.path(RIG)
    undo = count_versions(project, RIG)
    if not path.is_file():
        return {"cameras": [], "undo": undo, "mount": None}
    rig = lm.read_rig(path)
    cameras = [
        {
            "name": c.name,
            "size": list(c.model.image_size),
            "focal_px": float(c.model.K[0, 0]),
            "apart_m": float(np.linalg.norm(c.T_camera_left.t)),
        }
        for c in mounted_cameras(rig)
    ]
    mount = _mount_of(rig.T_base_left)
    return {
        "cameras": cameras,
        "undo": undo,
        "mount": mount,
        "command": f"lmkit convert NEW_RIG --to lmkit -o {RIG} --force",
    }
