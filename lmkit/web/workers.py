"""Work that takes seconds, in separate processes: the page stays responsive, and a crash does not stop the server."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from typing import ParamSpec, TypeVar

from lmkit.errors import InputError
from lmkit.worker_processes import WorkerContext

P = ParamSpec("P")
T = TypeVar("T")
PROCESSES = 2
LONGEST_S = 120.0
WAITING = 16  # simultaneous calls; more are refused


class Workers:
    """A few processes, replaced when one dies or takes too long.

    Args:
        processes: number of processes; 0 runs everything in a thread of this process.
    """

    def __init__(self, processes: int = PROCESSES, longest_s: float = LONGEST_S) -> None:
        self._processes, self._longest_s = processes, longest_s
        self._pool: ProcessPoolExecutor | None = None
        self._waiting = 0

    async def run(self, work: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> T:
        """``work(*args)`` in a process; a function at the top level of a module.

        Raises:
            InputError: too many calls at once, too slow, or the process died.
        """
        if self._waiting >= WAITING:
            raise InputError("busy", "too many requests at once", "wait until the running ones end")
        if self._processes == 0:
            return await asyncio.to_thread(work, *args, **kwargs)
        self._waiting += 1
        pool = self._started()
        try:
            future = asyncio.wrap_future(pool.submit(work, *args, **kwargs))
            return await asyncio.wait_for(future, self._longest_s)
        except TimeoutError:
            self._drop(pool)
            problem = f"not done after {self._longest_s:g} s"
            raise InputError("too_slow", problem, "give a smaller file, or use the command line") from None
        except BrokenProcessPool:
            self._drop(pool)
            raise InputError("broken", "reading this file failed", "give another file") from None
        finally:
            self._waiting -= 1

    def close(self) -> None:
        """End the processes."""
        if self._pool is not None:
            self._drop(self._pool)

    def _started(self) -> ProcessPoolExecutor:
        if self._pool is None:
            self._pool = ProcessPoolExecutor(self._processes, mp_context=WorkerContext(), initializer=_start)
        return self._pool

    def _drop(self, pool: ProcessPoolExecutor) -> None:
        if self._pool is pool:
            self._pool = None
        processes = list((getattr(pool, "_processes", None) or {}).values())
        pool.shutdown(wait=False, cancel_futures=True)
        for process in processes:
            process.kill()


def _start() -> None:
    """Without log messages and with a single thread, as on the command line."""
    import signal

    from lmkit.worker_processes import end_with_parent

    # The terminal's interrupt is for the server, which ends its processes.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    end_with_parent()
    for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(variable, "1")
    os.environ.setdefault("OPENCV_LOG_LEVEL", "SILENT")


def warm_up() -> None:
    """Load what the first preview and the first check need."""
    import lmkit.pipelines.prints
    import lmkit.verification.results  # noqa: F401
