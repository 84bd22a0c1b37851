"""The manifest of pages."""

from __future__ import annotations

from collections.abc import Sequence

from lmkit.generation.page import Page
from lmkit.io.manifest import PrintedEntry, PrintManifest
from lmkit.version import __version__


def manifest_of(pages: Sequence[Page], template: str) -> PrintManifest:
    """The manifest of pages: every landmark and its place."""
    entries = tuple(
        PrintedEntry(
            page=number,
            code=face.code,
            family=face.family.name,
            version=face.family.version,
            size_mm=face.size_mm,
            centre_mm=(round(face.centre_mm[0], 4), round(face.centre_mm[1], 4)),
            upside_down=face.upside_down,
            tile=page.window is not None,
        )
        for number, page in enumerate(pages, start=1)
        for face in page.faces
    )
    last = pages[-1]
    papers = tuple(dict.fromkeys(page.size_mm for page in pages))
    return PrintManifest(
        lmkit=__version__,
        template=template,
        paper_mm=papers,
        mirrored=last.mirrored,
        stretch=last.stretch,
        landmarks=entries,
    )
