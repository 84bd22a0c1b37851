"""Directive ``{commands}``: the reference of the command line, from the typer app itself."""

from __future__ import annotations

import inspect
import re
from typing import Any

import typer
from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from lmkit.cli.main import app


class Commands(SphinxDirective):
    """One section for every command, with its options as a table."""

    def run(self) -> list[nodes.Node]:
        """Sections, parsed from Markdown."""
        return self.parse_text_to_nodes(commands_to_markdown(), allow_section_headings=True)


def commands_to_markdown() -> str:
    """Markdown of all commands, groups flattened."""
    root = typer.main.get_command(app)
    return "\n\n".join(_command(name, command) for name, command in _leaves(root, "lmkit"))


def _leaves(command: Any, name: str) -> list[tuple[str, Any]]:
    if not getattr(command, "commands", None):
        return [(name, command)]
    return [leaf for key, child in command.commands.items() for leaf in _leaves(child, f"{name} {key}")]


def _command(name: str, command: Any) -> str:
    context = typer.Context(command)
    options = [p for p in command.params if p.param_type_name == "option" and not p.hidden and p.name != "help"]
    arguments = [p for p in command.params if p.param_type_name == "argument"]
    options_last = [*(piece for piece in command.collect_usage_pieces(context) if piece != "[OPTIONS]"), "[OPTIONS]"]
    usage = " ".join([name, *options_last])
    parts = [f"({name.replace(' ', '-')})=", f"## {name}", _prose(command.help or ""), f"```text\n{usage}\n```"]
    records = {
        "Argument": [(p.metavar, p.help or "") for p in arguments],
        "Option": [p.get_help_record(context) for p in options],
    }
    return "\n\n".join([*parts, *(_table(title, rows) for title, rows in records.items() if rows)])


def _table(title: str, rows: list[tuple[str, str]]) -> str:
    head = f"| {title} | Meaning |\n|---|---|"
    return "\n".join([head, *(f"| {_code(left)} | {_prose(right)} |" for left, right in rows)])


def _prose(text: str) -> str:
    """Help text as one Markdown paragraph or more; signs that Markdown would take for markup are escaped."""
    paragraphs = inspect.cleandoc(text).split("\n\n")
    joined = ["<br>".join([" ".join(p.split())]) for p in paragraphs]
    return "\n\n".join(re.sub(r"([|*_<>\[\]])", r"\\\1", p) for p in joined)


def _code(text: str) -> str:
    return "`" + text.replace("|", "\\|") + "`"


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the directive."""
    app.add_directive("commands", Commands)
    return {"parallel_read_safe": True}
