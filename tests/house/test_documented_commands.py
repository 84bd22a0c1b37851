"""Every command line in the documentation is one that the program accepts."""

from __future__ import annotations

import shlex
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import typer
from doc_pages import NOTEBOOKS, PAGES, ROOT, commands_of

from lmkit.cli.main import app

LINES = [
    pytest.param(line, whole, id=f"{path.relative_to(ROOT)}: {line[:60]}")
    for path in [*PAGES, *NOTEBOOKS]
    for line, whole in commands_of(path)
    if path.name != "0015-name.md"
]


@cache
def whole_command_line() -> Any:
    return typer.main.get_command(app)


def find_command(words: list[str]) -> tuple[Any, list[str]]:
    """The command that the first words name, and the words after it."""
    command = whole_command_line()
    while getattr(command, "commands", None) and words and not words[0].startswith("-"):
        assert words[0] in command.commands, f"there is no command {words[0]}"
        command, words = command.commands[words[0]], words[1:]
    return command, words


@pytest.mark.parametrize(("line", "whole"), LINES)
def test_command_line_parses(line: str, whole: bool) -> None:
    words = shlex.split(line)
    if words[0] in ("COMMAND", "..."):
        return
    command, rest = find_command(words)
    if whole:
        command.make_context("lmkit", list(rest))
        return
    known = {name for p in command.params for name in (*p.opts, *p.secondary_opts)} | {"-h", "--help"}
    assert {word for word in rest if word.startswith("--")} <= known


def test_the_check_refuses_what_does_not_exist() -> None:
    command, rest = find_command(shlex.split("detect image.png --no-such-option"))
    with pytest.raises(Exception, match="no-such-option"):
        command.make_context("lmkit", rest)
    with pytest.raises(AssertionError):
        find_command(["detec", "image.png"])


def test_every_command_has_a_page_of_the_site() -> None:
    assert "{commands}" in Path(ROOT / "docs/commands.md").read_text(encoding="utf-8")
