"""Runs the command line in the test's own process."""

from __future__ import annotations

import contextlib
import io
from dataclasses import dataclass


@dataclass(frozen=True)
class Answer:
    """Output of a command, and its exit code."""

    code: int
    out: str
    err: str


def run_command(*arguments: object) -> Answer:
    """Run ``lmkit ARGUMENTS``; everything that Python writes to stdout and stderr is captured."""
    from lmkit.cli import main

    words = [str(a) for a in arguments]
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = main.guarded(lambda: main.run_arguments(words), debug=False)
    return Answer(code, out.getvalue(), err.getvalue())
