"""Directive ``{public-names}``: the reference of ``import lmkit``, from its list of public names."""

from __future__ import annotations

import inspect
from typing import Any

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

import lmkit


class PublicNames(SphinxDirective):
    """An entry for every public function (option ``functions``), class (``classes``) or exception (``errors``)."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Entries, parsed from Markdown with embedded reStructuredText."""
        names = [name for name in lmkit.__all__ if kind_of(name) == self.arguments[0]]
        blocks = [f"```{{eval-rst}}\n{_entry(name)}\n```" for name in names]
        return self.parse_text_to_nodes("\n\n".join(blocks))


def kind_of(name: str) -> str:
    """Group of a public name: ``functions``, ``classes``, ``errors`` or ``values``."""
    thing = getattr(lmkit, name)
    if not inspect.isclass(thing):
        return "functions" if callable(thing) else "values"
    return "errors" if issubclass(thing, BaseException) else "classes"


def _entry(name: str) -> str:
    if kind_of(name) == "functions":
        return f".. autofunction:: lmkit.{name}"
    return f".. autoclass:: lmkit.{name}\n   :members:\n   :exclude-members: __init__"


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the directive."""
    app.add_directive("public-names", PublicNames)
    return {"parallel_read_safe": True}
