"""Page 5, the map: landmarks with their uncertainty, doubts of a survey, edits and pins with undo."""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field
from starlette.requests import Request
from starlette.responses import Response

import lmkit as lm
from lmkit.arrays import FloatArray
from lmkit.errors import InputError
from lmkit.web.answers import Body, answer, read_body
from lmkit.web.floors import FLOOR, describe_floor
from lmkit.web.project import Project
from lmkit.web.state import State, state_of
from lmkit.web.versions import count_versions, keep_versions, restore_versions

MAP, PINS = "map.yaml", "pins.yaml"
UNDONE = (MAP, PINS, FLOOR)  # files changed by this page
PIN_SIGMA_DEG = 2.0
Meters = Annotated[float, Field(ge=-10_000, le=10_000)]


class Edit(Body):
    """Change of one landmark; None leaves a value as it is.

    Attributes:
        pin_mm: standard deviation of its measured place, which surveys use; 0 removes the pin.
    """

    id: Annotated[str, Field(max_length=40)]
    name: Annotated[str, Field(max_length=60)] | None = None
    position: tuple[Meters, Meters, Meters] | None = None
    facing_deg: Annotated[float, Field(ge=-360, le=360)] | None = None
    size_m: Annotated[float, Field(gt=0, le=10)] | None = None
    pin_mm: Annotated[float, Field(ge=0, le=1000)] | None = None
    remove: bool = False


class EditBody(Body):
    """Changes to the browser's version of the map."""

    version: Annotated[str, Field(max_length=64)]
    edits: Annotated[list[Edit], Field(min_length=1, max_length=500)]


async def show(request: Request) -> Response:
    """The map as the page draws it."""
    return answer(await _shown(state_of(request)))


async def drawn(state: State) -> dict[str, Any]:
    """Landmarks and walls of the project, as a plan draws them."""
    shown = await _shown(state)
    return {"landmarks": shown["landmarks"], "walls": shown["floor"]["walls"]}


async def edit(request: Request) -> Response:
    """Change landmarks; the previous map is kept for undo."""
    state, body = state_of(request), await read_body(request, EditBody)
    path = state.project.path(MAP)
    if not path.is_file():
        raise InputError("no_file", "the project has no map.yaml", "survey a recording first")
    if body.version != _version(path):
        raise InputError("changed", "map.yaml has changed meanwhile", "look at the new map, then edit again")
    landmarks, pins = await state.workers.run(edited, str(path), str(state.project.path(PINS)), body)
    keep_versions(state.project, MAP, PINS)
    lm.write_map(landmarks, path, overwrite=True)
    if pins is not None:
        lm.write_map(pins, state.project.path(PINS), overwrite=True)
    else:
        state.project.path(PINS).unlink(missing_ok=True)
    return answer(await _shown(state))


async def undo(request: Request) -> Response:
    """Undo one change of landmarks, pins or walls."""
    state = state_of(request)
    restore_versions(state.project, *UNDONE)
    return answer(await _shown(state))


def edited(path: str, pins: str, body: EditBody) -> tuple[lm.LandmarkMap, lm.LandmarkMap | None]:
    """The map and the pins of two files with these changes; None without a pin."""
    landmarks = {str(landmark.id): landmark for landmark in lm.read_map(path)}
    held = {str(landmark.id): landmark for landmark in lm.read_map(pins)} if Path(pins).is_file() else {}
    for change in body.edits:
        if change.id not in landmarks:
            raise InputError("no_landmark", f"there is no landmark {change.id} in the map", "reload the page")
        if change.remove:
            del landmarks[change.id]
            held.pop(change.id, None)
            continue
        landmark = landmarks[change.id] = _changed(landmarks[change.id], change)
        sigma_mm = change.pin_mm
        if sigma_mm is None and change.id in held:
            sigma_mm = _pin_mm(held[change.id])  # the pin moves with the landmark
        if sigma_mm:
            held[change.id] = replace(landmark, covariance=_pin_covariance(sigma_mm))
        else:
            held.pop(change.id, None)
    if not landmarks:
        raise InputError("empty_map", "a map needs one landmark at least", "keep one")
    return lm.LandmarkMap(list(landmarks.values())), lm.LandmarkMap(list(held.values())) if held else None


def _pin_covariance(sigma_mm: float) -> FloatArray:
    return np.diag([(sigma_mm / 1000) ** 2] * 3 + [np.radians(PIN_SIGMA_DEG) ** 2] * 3)


def _pin_mm(pin: lm.MappedLandmark) -> float:
    return 1000 * float(np.sqrt(pin.covariance[0, 0])) if pin.covariance is not None else 1.0


def _changed(landmark: lm.MappedLandmark, change: Edit) -> lm.MappedLandmark:
    pose, covariance = landmark.T_map_landmark, landmark.covariance
    t = pose.t if change.position is None else np.array(change.position)
    R = pose.R
    if change.facing_deg is not None:
        turn = np.radians(change.facing_deg - facing_deg(R))
        c, s = np.cos(turn), np.sin(turn)
        R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ R
    if change.position is not None or change.facing_deg is not None:
        covariance = None  # the survey's covariance was for the previous pose
        pose = lm.Pose("map", "landmark", R, t)
    name = landmark.name if change.name is None else change.name.strip() or None
    size_m = landmark.size_m if change.size_m is None else change.size_m
    return replace(landmark, T_map_landmark=pose, covariance=covariance, name=name, size_m=size_m)


def facing_deg(R: FloatArray) -> float:
    """Direction of the landmark's normal in the plan, degrees."""
    return float(np.degrees(np.arctan2(R[1, 2], R[0, 2])))


def describe_map(path: str) -> list[dict[str, Any]]:
    """Landmarks of a map file as the page draws them."""
    return describe_landmarks(lm.read_map(path))


def describe_landmarks(landmarks: lm.LandmarkMap) -> list[dict[str, Any]]:
    """Landmarks as the page draws them."""
    entries = []
    for landmark in landmarks:
        pose, C = landmark.T_map_landmark, landmark.covariance
        entries.append(
            {
                "id": str(landmark.id),
                "code": landmark.code,
                "family": landmark.family,
                "size_m": landmark.size_m,
                "position": pose.t.tolist(),
                "quaternion": pose.quaternion_xyzw.tolist(),
                "facing_deg": facing_deg(pose.R),
                "name": landmark.name,
                "spread": None if C is None else C[:3, :3].tolist(),
                "sigma_m": None if C is None else float(np.sqrt(np.trace(C[:3, :3]))),
            }
        )
    return entries


def describe_pins(path: str) -> dict[str, float]:
    """Standard deviation of each pinned landmark, mm."""
    return {str(pin.id): _pin_mm(pin) for pin in lm.read_map(path)}


async def _shown(state: State) -> dict[str, Any]:
    project = state.project
    path, pins = project.path(MAP), project.path(PINS)
    shown: dict[str, Any] = {"landmarks": [], "pins": {}, "version": None, "doubts": {}, "warnings": []}
    shown |= {"undo": count_versions(project, *UNDONE), "floor": await state.workers.run(describe_floor, project)}
    if not path.is_file():
        return shown
    doubts, warnings = _doubts(project)
    return shown | {
        "landmarks": await state.workers.run(describe_map, str(path)),
        "pins": await state.workers.run(describe_pins, str(pins)) if pins.is_file() else {},
        "version": _version(path),
        "doubts": doubts,
        "warnings": warnings,
        "command": f"lmkit map {MAP}",
    }


def _version(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()[:16]


def _doubts(project: Project) -> tuple[dict[str, str], list[str]]:
    """Sentences of the newest survey: by contradicted landmark, and all."""
    folder = project.root / "reports"
    tables = sorted(folder.glob("*-survey.json"), key=lambda p: p.stat().st_mtime) if folder.is_dir() else []
    if not tables:
        return {}, []
    try:
        data = json.loads(tables[-1].read_text(encoding="utf-8"))
        doubts = {
            entry["id"]: f"{entry['off']} of {entry['of']} observations contradict its place"
            for entry in data["contradicted"]
        }
        return doubts, [str(text) for text in data["warnings"]]
    except (ValueError, KeyError, TypeError):
        return {}, []
