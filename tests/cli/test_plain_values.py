"""Values that are converted without typer's validation: as typer does, and with its errors."""

from __future__ import annotations

import os
import stat
from pathlib import Path
from typing import Annotated

import pytest
import typer

from lmkit.cli.checked_options import CheckedOptions
from lmkit.cli.plain_values import PlainGroup


def parsed(arguments: list[str], checked: bool) -> list[object]:
    """Values that the command receives: converted by lmkit, or by typer alone."""
    received: list[object] = []
    app = typer.Typer(cls=PlainGroup) if checked else typer.Typer()
    app.callback()(lambda: None)

    def run(
        sources: list[str],
        text: Annotated[str, typer.Option()] = "a",
        file: Annotated[Path | None, typer.Option()] = None,
        files: Annotated[list[Path] | None, typer.Option()] = None,
        count: Annotated[int, typer.Option(min=1)] = 3,
        share: Annotated[float, typer.Option()] = 2,
        flag: Annotated[bool, typer.Option()] = False,
    ) -> None:
        received.extend([sources, text, file, files, count, share, flag])

    if checked:
        app.command("run", cls=CheckedOptions)(run)
    else:
        app.command("run")(run)
    app(["run", *arguments], standalone_mode=False)
    return received


@pytest.mark.parametrize(
    "arguments",
    [
        ["x"],
        ["x", "y", "--text", "é", "--file", "nowhere", "--flag"],
        ["x", "--files", "a", "--files", "b/c", "--count", "5", "--share", "0.5"],
        ["x", "--file", "."],
    ],
)
def test_the_command_receives_the_same(arguments):
    ours, typers = (parsed(arguments, checked) for checked in (True, False))
    assert ours == typers
    assert [type(value) for value in ours] == [type(value) for value in typers]


@pytest.mark.parametrize("arguments", [["x", "--count", "0"], ["x", "--count", "many"], ["x", "--share", "y"], []])
def test_wrong_values_are_refused_in_the_same_words(arguments):
    problems = []
    for checked in (True, False):
        with pytest.raises(Exception) as caught:
            parsed(arguments, checked)
        problems.append((type(caught.value), str(caught.value)))
    assert problems[0] == problems[1]


@pytest.mark.skipif(os.name == "nt" or os.geteuid() == 0, reason="the superuser may read everything")
def test_an_unreadable_file_is_refused(tmp_path):
    closed = tmp_path / "closed"
    closed.write_text("x")
    closed.chmod(stat.S_IWUSR)
    with pytest.raises(typer.BadParameter):
        parsed(["x", "--file", str(closed)], True)
