"""A live run as a job of the page: steps go to standard output, one per line, with images while there are watchers.

Runs as ``python -m lmkit.web.watched_run SETTINGS``: keys of a run file as JSON, or ``file`` and keys to replace.
Standard input gets ``1`` when there are watchers and ``0`` when there are none; its end stops the run.
"""

from __future__ import annotations

import sys
import threading
import time
from io import FileIO, RawIOBase
from pathlib import Path
from typing import Any, BinaryIO

from lmkit.errors import NegativeAnswer
from lmkit.live.annotated_image import annotated_jpeg
from lmkit.live.open_run import open_run
from lmkit.live.outputs.base import OutputRunner
from lmkit.live.run_settings import RunSettings, read_run_file, settings_of
from lmkit.live.service import run_until_stopped
from lmkit.live.state import LiveState
from lmkit.web.floors import walls_beside
from lmkit.web.live import pack_line, shown_state
from lmkit.web.maps import describe_landmarks
from lmkit.web.tasks import run_task

LEAST_APART_S = 0.1  # between two images


class PageOutput:
    """Output of a live run to the page.

    Args:
        stream: output stream of the lines.
    """

    def __init__(self, stream: BinaryIO) -> None:
        self._stream = stream
        self.watched = False
        self._sent_s = float("-inf")

    def send(self, state: LiveState) -> bool:
        """See `lmkit.live.outputs.base.Output`."""
        jpeg, now = b"", time.monotonic()
        if self.watched and now - self._sent_s >= LEAST_APART_S:
            jpeg, self._sent_s = annotated_jpeg(state), now
        self._stream.write(pack_line(shown_state(state), jpeg))
        self._stream.flush()
        return True

    def close(self) -> None:
        """See `lmkit.live.outputs.base.Output`."""


def run(task: dict[str, Any], wishes: RawIOBase, stream: BinaryIO) -> None:
    """Run until the sources end, a signal comes, or ``wishes`` ends.

    Raises:
        InputError: settings that do not fit together, or a file that cannot be read.
        NegativeAnswer: no pose was published.
    """
    settings = settings_from(task)
    live = open_run(settings)
    file = settings.path(settings.values.map)
    walls = [] if file is None else walls_beside(file)
    stream.write(pack_line({"landmarks": describe_landmarks(live.loop.landmarks), "walls": walls}))
    page = PageOutput(stream)
    live.outputs.append(OutputRunner("page", lambda: page, live.clock.now, keeps_all=not live.feed.is_live))

    def listen() -> None:
        for line in wishes:
            page.watched = line.strip() == b"1"
        live.stop()

    threading.Thread(target=listen, daemon=True).start()
    summary = run_until_stopped(live, settings)
    if summary.steps and not summary.statuses.get("ok"):
        raise NegativeAnswer("not_located", "no pose was published", "check that landmarks of the map are in view")


def settings_from(task: dict[str, Any]) -> RunSettings:
    """Settings of a task; ``file`` names a run file, and other keys replace its values."""
    given = dict(task)
    name = given.pop("file", None)
    if name is None:
        return settings_of(given, Path())
    filed = read_run_file(Path(name))
    return RunSettings(settings_of({**filed.values.model_dump(), **given}, filed.folder).values, filed.folder)


def watch(task: dict[str, Any]) -> None:
    """Run with requests from standard input, and steps to standard output."""
    # Unbuffered: at exit, Python cannot abandon a thread that waits in a buffered reader.
    with FileIO(sys.stdin.fileno(), closefd=False) as wishes:
        run(task, wishes, sys.stdout.buffer)


if __name__ == "__main__":
    sys.exit(run_task(watch))
