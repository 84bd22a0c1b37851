"""Page 2, check a print: upload a photograph, scan or PDF, and see its grades."""

from __future__ import annotations

import json
import shlex
import time
from pathlib import Path, PurePosixPath
from typing import Annotated, Any

import numpy as np
from pydantic import Field
from starlette.requests import Request
from starlette.responses import Response

from lmkit.arrays import ByteArray
from lmkit.errors import InputError
from lmkit.io.images import SUFFIXES
from lmkit.units import parse_length_mm
from lmkit.web.answers import MAX_UPLOAD, Body, answer, read_body, read_bytes
from lmkit.web.state import State, state_of

SHOWN_PX = 1400  # longer side of the image that the page shows
HISTORY = "photos/history.jsonl"
MOST_HISTORY = 2000


class CheckBody(Body):
    """Statements about the print; empty text if unknown."""

    family: Annotated[str, Field(max_length=80)] = "lm8"
    size: Annotated[str, Field(max_length=40)] = ""
    print: Annotated[str, Field(max_length=200)] = ""


async def upload(request: Request) -> Response:
    """Store a photograph, scan or PDF once it can be read."""
    state = state_of(request)
    data = await read_bytes(request, MAX_UPLOAD)
    name = await state.workers.run(store_photo, data, request.path_params["name"], str(state.project.root))
    return answer({"name": name})


async def check(request: Request) -> Response:
    """Read, measure and grade every landmark of a stored photograph."""
    state, body = state_of(request), await read_body(request, CheckBody)
    path, manifest = _files(state, request.path_params["name"], body)
    found = await state.workers.run(grade_photo, str(path), body.family, body.size, manifest)
    _remember(state, path.name, found)
    return answer({"results": found, "command": _command(path.name, body), "history": _history(state, found)})


async def certify(request: Request) -> Response:
    """Write the certificate of a stored photograph into ``reports/``."""
    state, body = state_of(request), await read_body(request, CheckBody)
    path, manifest = _files(state, request.path_params["name"], body)
    name = state.project.unused("reports", f"certificate-{path.stem}"[:80], ".pdf")
    target = str(state.project.path(name))
    await state.workers.run(write_certificate, str(path), body.family, body.size, manifest, target)
    return answer({"file": name, "command": f"{_command(path.name, body)} --certificate {shlex.quote(name)}"})


def store_photo(data: bytes, name: str, root: str) -> str:
    """Write an upload, a readable image or a PDF, under an unused name; returns the name."""
    from lmkit.io.files import write_file
    from lmkit.io.images import decode_image
    from lmkit.web.project import NAME, Project

    suffix = PurePosixPath(name).suffix.lower()
    is_pdf = data.startswith(b"%PDF")
    if is_pdf != (suffix == ".pdf") or not (is_pdf or suffix in SUFFIXES):
        hint = "give a photograph or scan (JPEG, PNG, TIFF, WebP), or a PDF"
        raise InputError("not_image", f"{name[:80]}: not an image by its name", hint)
    if not is_pdf:
        decode_image(data, name[:80])
    stem = "".join(c if NAME.fullmatch(f"a{c}") else "-" for c in PurePosixPath(name).stem)[:60].strip(" .-")
    project = Project(Path(root))
    target = project.unused("photos", stem or "photo", suffix)
    write_file(project.path(target), data)
    return PurePosixPath(target).name


def grade_photo(path: str, family: str, size: str, manifest: str | None) -> list[dict[str, Any]]:
    """Grades of every landmark, with their image."""
    import base64

    from lmkit.verification.results import print_dict
    from lmkit.visualization.overlay import encode_jpeg

    results: list[dict[str, Any]] = []
    for item in _verified(path, family, size, manifest):
        height, width = item.image.shape[:2]
        entry = print_dict(item, item.grade != "F") | {"width": width, "height": height}
        entry["source"] = Path(item.source).name
        if not any(other["source"] == entry["source"] for other in results):
            jpeg = encode_jpeg(_shown(item.image), 85)
            entry["image"] = f"data:image/jpeg;base64,{base64.b64encode(jpeg).decode()}"
        results.append(entry)
    if not results:
        from lmkit.io.images import decode_image

        data = Path(path).read_bytes()
        if data.startswith(b"%PDF"):
            raise InputError("nothing_read", "no landmark can be read in this file", "was it made by lmkit generate?")
        dark = float(decode_image(data, path).mean()) < 40
        hint = "more light" if dark else "fill a third of the image with the landmark, from the front, in focus"
        raise InputError("nothing_read", "no landmark can be read in this image", hint)
    return results


def write_certificate(path: str, family: str, size: str, manifest: str | None, target: str) -> None:
    """Write the certificate, one page per landmark."""
    from lmkit.io.files import write_file
    from lmkit.reports.certificate import certificate

    found = _verified(path, family, size, manifest)
    if not found:
        raise InputError("nothing_read", "no landmark can be read", "check the photograph first")
    write_file(Path(target), certificate(found))


def _verified(path: str, family: str, size: str, manifest: str | None) -> list[Any]:
    from lmkit.detection.config import DetectOptions
    from lmkit.io.manifest import read_manifest
    from lmkit.model.families import families_named
    from lmkit.verification.prints import Stated, stated_by_manifest, verify_print

    stated: tuple[Stated, ...] = ()
    if manifest is not None:
        stated = stated_by_manifest(read_manifest(Path(manifest)))
    elif size:
        stated = (Stated(None, None, parse_length_mm(size, "size")),)
    return verify_print(Path(path), DetectOptions(families_named(family)), stated)


def _shown(image: ByteArray) -> ByteArray:
    import cv2

    factor = SHOWN_PX / max(image.shape[:2])
    if factor >= 1:
        return image
    small = cv2.resize(image, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)
    return np.asarray(small, dtype=np.uint8)


def _files(state: State, name: str, body: CheckBody) -> tuple[Path, str | None]:
    """The photograph, and the manifest of its print."""
    path = state.project.public(f"photos/{name}")
    if not body.print:
        return path, None
    from lmkit.io.manifest import manifest_path

    printed = state.project.public(body.print)
    return path, str(manifest_path(printed))


def _command(name: str, body: CheckBody) -> str:
    words = ["lmkit", "verify", f"photos/{name}"]
    if body.print:
        words += ["--manifest", f"{body.print}.json"]
    elif body.size:
        words += ["--size", body.size]
    return shlex.join([*words, *(["--family", body.family] if body.family != "lm8" else [])])


def _remember(state: State, name: str, found: list[dict[str, Any]]) -> None:
    path = state.project.path(HISTORY)
    with path.open("a", encoding="utf-8") as stream:
        for item in found:
            entry = {"id": f"{item['family']}:{item['code']}", "photo": name, "grade": item["grade"]}
            stream.write(json.dumps(entry | {"time": round(time.time())}) + "\n")


def _history(state: State, found: list[dict[str, Any]]) -> dict[str, list[dict[str, Any]]]:
    """Checks of these landmarks so far, the oldest first."""
    wanted = {f"{item['family']}:{item['code']}" for item in found}
    lines = state.project.path(HISTORY).read_text(encoding="utf-8").splitlines()[-MOST_HISTORY:]
    history: dict[str, list[dict[str, Any]]] = {id_: [] for id_ in wanted}
    for line in lines:
        try:
            entry = json.loads(line)
        except ValueError:
            continue
        if isinstance(entry, dict) and entry.get("id") in wanted:
            history[entry["id"]].append(entry)
    return history
