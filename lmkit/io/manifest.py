"""Print manifests: a JSON file beside every print, and inside the PDF's metadata."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, ValidationError

from lmkit.errors import InputError
from lmkit.io.document_models import Document, read_document
from lmkit.io.field_problems import first_problem

MANIFEST: Literal["lmkit-prints/1"] = "lmkit-prints/1"
Positive = Annotated[float, Field(gt=0)]


class PrintedEntry(Document):
    """One landmark on one page.

    Attributes:
        page: from 1.
        code, family, version: the landmark.
        size_mm: nominal size over the border's outer edges.
        centre_mm: its center, from the paper's top left corner; outside the paper for tiles.
        upside_down: whether it is rotated by 180 degrees.
        tile: whether the page has only a part of it.
    """

    page: Annotated[int, Field(ge=1)]
    code: Annotated[int, Field(ge=0)]
    family: str
    version: int
    size_mm: Positive
    centre_mm: tuple[float, float]
    upside_down: bool = False
    tile: bool = False


class PrintManifest(Document):
    """Contents of a printed file.

    Attributes:
        lmkit: version of lmkit.
        template: its name, ``tiles`` for a landmark over several sheets.
        paper_mm: of every page.
        mirrored: for the inside of a window.
        stretch: factors of the drawing in x and y that compensate the printer.
        landmarks: all of them, page by page.
        file, sha256: name and hash of the file; only in the JSON beside it.
    """

    format: Literal["lmkit-prints/1"] = MANIFEST
    lmkit: str
    template: str
    paper_mm: tuple[tuple[float, float], ...]
    mirrored: bool = False
    stretch: tuple[float, float] = (1.0, 1.0)
    landmarks: tuple[PrintedEntry, ...]
    file: str | None = None
    sha256: str | None = None

    def of_file(self, name: str, content: bytes) -> PrintManifest:
        """Values of the JSON file beside the print."""
        return self.model_copy(update={"file": name, "sha256": hashlib.sha256(content).hexdigest()})

    def to_json(self, indent: int | None = None) -> str:
        """JSON text; values at their default are left out."""
        data = {"format": self.format} | self.model_dump(mode="json", exclude_defaults=True)
        return json.dumps(data, indent=indent, separators=(",", ":") if indent is None else None)


def manifest_path(path: Path) -> Path:
    """Path of the manifest of a print."""
    return path.with_name(f"{path.name}.json")


def parse_manifest(text: str, where: str) -> PrintManifest:
    """A manifest from its text.

    Raises:
        InputError: it is not a manifest.
    """
    try:
        return PrintManifest.model_validate_json(text)
    except ValidationError as error:
        place, problem = first_problem(error)
        raise InputError(
            "bad_manifest", f"{where}: {place}: {problem}", "generate the print again, or delete the manifest"
        ) from None


def read_manifest_beside(path: Path) -> PrintManifest | None:
    """The manifest beside a print, or None without one.

    Raises:
        InputError: it exists but cannot be read.
    """
    beside = manifest_path(path)
    return read_manifest(beside) if beside.is_file() else None


def read_manifest(path: Path) -> PrintManifest:
    """The manifest in a file.

    Raises:
        InputError: it cannot be read, or is not a manifest.
    """
    return read_document(path, PrintManifest, "manifest")
