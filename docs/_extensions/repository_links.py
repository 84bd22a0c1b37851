"""Links that leave ``docs/`` in the repository lead to the site's own copy of that page."""

from __future__ import annotations

from typing import Any

from sphinx.application import Sphinx

PAGES = {
    "../benchmarks/README.md": "benchmarks.md",
    "../CONTRIBUTING.md": "contributing.md",
    "../CHANGELOG.md": "changes.md",
    "../README.md": "index.md",
}


def rewrite(app: Sphinx, name: str, source: list[str]) -> None:
    """Replace the link targets of one page."""
    up = "../" * name.count("/")
    for target, page in PAGES.items():
        source[0] = source[0].replace(f"]({up}{target}", f"]({up}{page}")


def rewrite_included(app: Sphinx, path: Any, name: str, source: list[str]) -> None:
    """Replace the link targets of an included page, which counts from the root of the repository."""
    for target, page in PAGES.items():
        source[0] = (
            source[0].replace(f"]({target.removeprefix('../')}", f"]({page}").replace(f"]({target}", f"]({page}")
        )
    source[0] = source[0].replace("](../docs/", "](").replace("](docs/", "](")


def setup(app: Sphinx) -> dict[str, Any]:
    """Connect to the reading of pages."""
    app.connect("source-read", rewrite)
    app.connect("include-read", rewrite_included)
    return {"parallel_read_safe": True}
