"""Page 3, cameras: one image from every camera, side by side, with its problems."""

from __future__ import annotations

import base64
import os
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import cv2
import numpy as np
from pydantic import Field
from starlette.requests import Request
from starlette.responses import Response

import lmkit as lm
from lmkit.arrays import ByteArray
from lmkit.errors import InputError, LmkitError
from lmkit.pipelines.board_absence import DARK
from lmkit.web.answers import Body, answer, read_body
from lmkit.web.camera_clocks import time_between
from lmkit.web.project import FILMS, Project, listing
from lmkit.web.state import state_of
from lmkit.web.verbs import CAMERA

DEVICES = Path("/dev")
SETTLING = 8  # images of a camera until its exposure has settled
SHOWN_PX = 640
BURNT = 0.05  # share of clipped pixels
GRAY = 3.0  # mean difference of the channels
APART_S = 0.005  # larger differences are reported
LEAST_SHARED = 2  # landmarks in both images, to distinguish left from right


class LookBody(Body):
    """Sources in the order of the rig: ``camera:0``, a film, or a folder with left and right."""

    sources: Annotated[list[Annotated[str, Field(max_length=300)]], Field(min_length=1, max_length=4)]


async def sources(request: Request) -> Response:
    """Cameras of this machine, and sources of the project that can replace a camera."""
    project = state_of(request).project
    found = listing(project)
    devices = DEVICES.glob("video*") if os.name == "posix" else []
    numbers = sorted(int(p.name[5:]) for p in devices if p.name[5:].isdecimal())
    cameras = [f"camera:{number}" for number in numbers]
    stand_ins = [entry["name"] for kind in ("pairs", "films") for entry in found[kind]]
    return answer({"cameras": cameras[:16], "stand_ins": stand_ins[:50]})


async def look(request: Request) -> Response:
    """One image of every camera, with its problems in words."""
    state, body = state_of(request), await read_body(request, LookBody)
    for source in body.sources:
        _require_source(state.project, source)
    seen = await state.workers.run(look_through, str(state.project.root), list(body.sources))
    return answer(seen | {"command": shlex.join(["lmkit", "detect", *seen.pop("names"), "--json"])})


def look_through(root: str, names: list[str]) -> dict[str, Any]:
    """Images with exposure, color and landmarks of each; a camera that fails is an entry with its error."""
    views: list[dict[str, Any]] = []
    read: list[Any] = []
    words: list[str] = []
    for source, label in (pair for name in names for pair in _cameras_of(root, name)):
        words.append(label)
        try:
            image = _one_image(source)
        except LmkitError as error:
            views.append({"name": label, "error": str(error)})
            continue
        found = lm.detect(image)
        read.append(found)
        views.append({"name": label, **_described(image), "landmarks": [str(d.id) for d in found]})
    problems, apart_s = [], None
    if len(read) == 2 and _are_swapped(*read):
        swapped = "the two cameras look swapped: landmarks are further left in the first image"
        problems.append({"message": swapped, "hint": "give them in the other order, or change the cables"})
    if len(read) == 2 and all(CAMERA.fullmatch(word) for word in words):
        try:
            apart_s = time_between(words)
        except InputError as error:
            problems.append({"message": error.message, "hint": error.hint})
    if apart_s is not None and apart_s > APART_S:
        late = f"the images of the two cameras are {1000 * apart_s:.0f} ms apart: a turning robot gets false depths"
        problems.append({"message": late, "hint": "use cameras with a common trigger, or turn slowly"})
    return {"views": views, "problems": problems, "names": words, "apart_s": apart_s}


def _cameras_of(root: str, name: str) -> Iterator[tuple[str, str]]:
    """Sources of one entry, with their labels; a folder of pairs has two."""
    folder = Path(root) / name
    if not CAMERA.fullmatch(name) and folder.is_dir():
        for side in ("left", "right"):
            yield str(folder / side), f"{name}/{side}"
        return
    yield (name if CAMERA.fullmatch(name) else str(folder)), name


def _one_image(source: str) -> ByteArray:
    from lmkit.io.image_sources import frames

    newest = None
    for count, frame in enumerate(frames([source])):
        newest = frame
        if count >= (SETTLING if CAMERA.fullmatch(source) else 0):
            break
    if newest is None:
        raise InputError("no_image", "the source gives no image", "check the camera, or the folder")
    return newest.pixels


def _described(image: ByteArray) -> dict[str, Any]:
    from lmkit.visualization.overlay import encode_jpeg

    height, width = image.shape[:2]
    faults = []
    channels = image.astype(np.int16)
    if float(np.abs(channels.max(axis=2) - channels.min(axis=2)).mean()) < GRAY:
        faults.append("gray: ring landmarks need color; use AprilTags with this camera")
    if float(image.mean()) < DARK:
        faults.append("dark: more light, or a longer exposure")
    if float((image.min(axis=2) >= 252).mean()) > BURNT:
        faults.append("overexposed: a shorter exposure")
    factor = min(1.0, SHOWN_PX / width)
    small = cv2.resize(image, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)
    jpeg = encode_jpeg(np.asarray(small, dtype=np.uint8), 80)
    return {
        "image": f"data:image/jpeg;base64,{base64.b64encode(jpeg).decode()}",
        "width": width,
        "height": height,
        "sharpness": _sharpness(image),
        "faults": faults,
    }


def _sharpness(image: ByteArray) -> float:
    """Steepest edges over the image's contrast, 0 to 1; comparable between cameras that show the same scene."""
    gray = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY).astype(np.float32)
    steps = np.abs(np.diff(gray, axis=1))
    contrast = float(np.percentile(gray, 99) - np.percentile(gray, 1))
    return float(np.clip(np.percentile(steps, 99.9) / max(contrast, 1.0), 0, 1))


def _are_swapped(first: Any, second: Any) -> bool:
    """Whether common landmarks are further left in the first image than in the second."""
    places = [{str(d.id): float(d.center[0]) for d in found} for found in (first, second)]
    shared = places[0].keys() & places[1].keys()
    return len(shared) >= LEAST_SHARED and float(np.median([places[0][k] - places[1][k] for k in shared])) < 0


def _require_source(project: Project, source: str) -> None:
    """Refuse a source that is not a camera, film or folder of pairs.

    Raises:
        InputError: it is none of these, or is outside the project.
    """
    if CAMERA.fullmatch(source):
        return
    path = project.path(source)
    pairs = (path / "left").is_dir() and (path / "right").is_dir()
    if not pairs and not (path.is_file() and path.suffix.lower() in FILMS):
        hint = "give camera:0, a film, or a folder with left and right"
        raise InputError("no_source", f"{source[:80]!r} is no camera", hint)
