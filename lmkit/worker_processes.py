"""Spawned processes that do not run the caller's script, and that end with the process that started them.

Apart from `parallel.py`, so that commands without workers do not load Python's multiprocessing.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import multiprocessing.connection
import os
import signal
import sys
import threading
from collections.abc import Iterator
from multiprocessing.context import SpawnContext, SpawnProcess
from multiprocessing.process import BaseProcess
from typing import Any


class _Worker(SpawnProcess):
    """A spawned process that does not run the caller's script again.

    Other spawned processes import ``__main__`` first, so that a script without ``if __name__ == "__main__"`` would
    start anew in each of them.  All work is a function of lmkit, and needs no ``__main__``.
    """

    @staticmethod
    def _Popen(process: BaseProcess) -> Any:
        main = vars(sys.modules["__main__"])
        hidden = {name: main[name] for name in ("__spec__", "__file__") if main.get(name) is not None}
        main.update(dict.fromkeys(hidden))
        try:
            with _interrupts_held():
                return SpawnProcess._Popen(process)
        finally:
            main.update(hidden)


class WorkerContext(SpawnContext):
    """How worker processes are started: spawned, and without the caller's script."""

    Process = _Worker


@contextlib.contextmanager
def _interrupts_held() -> Iterator[None]:
    """Hold SIGINT back; a process started meanwhile gets it after `end_with_parent`, not amid its imports."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _release_interrupts() -> None:
    """Let a worker that has begun be interrupted; one that was meanwhile ends, as the one that started it does."""
    if hasattr(signal, "pthread_sigmask"):
        try:
            signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
        except KeyboardInterrupt:
            os._exit(1)


def end_with_parent() -> None:
    """Let this worker end when its parent process ends, since a killed parent cannot stop its workers."""
    _release_interrupts()
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_wait_and_end, args=(parent.sentinel,), daemon=True).start()


def _wait_and_end(sentinel: int) -> None:
    multiprocessing.connection.wait([sentinel])
    os._exit(1)
