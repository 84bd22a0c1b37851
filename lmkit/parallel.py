"""Worker processes for many independent jobs, and the memory limit of this process."""

from __future__ import annotations

import itertools
import os
import time
from collections.abc import Callable, Generator, Iterable
from functools import partial
from typing import Any, TypeVar

from lmkit.errors import InputError

Shared = TypeVar("Shared")
Job = TypeVar("Job")
Answer = TypeVar("Answer")

VARIABLE = "LMKIT_JOBS"
LEAST_BYTES = 1 << 30
# Shorter work is done in this process: starting workers costs about as much.
WORTH_WORKERS_S = 2.0

_limit: int | None = None
_shared: Any = None  # of a worker process: data used by all its jobs


def set_jobs(limit: int | None) -> None:
    """Bound the number of worker processes; None for the environment's LMKIT_JOBS, or one per CPU core."""
    global _limit
    _limit = limit


def job_limit() -> int:
    """The largest number of worker processes.

    Raises:
        InputError: LMKIT_JOBS is not a positive number.
    """
    if _limit is not None:
        return _limit
    text = os.environ.get(VARIABLE, "").strip()
    if not text:
        return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if not text.isdecimal() or int(text) < 1:
        raise InputError("bad_jobs", f"{VARIABLE}={text} is not a number of processes", "set 1 or more")
    return int(text)


def require_address_space(what: str) -> None:
    """Refuse work for which the process's limit of address space (``ulimit -v``) is too small.

    With less than 0.9 GB OpenCV finds no board, or ends the process in its linear algebra, without a message.

    Raises:
        InputError: ``little_memory``.
    """
    try:
        import resource
    except ImportError:  # Windows has no such limit
        return
    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    if 0 <= limit < LEAST_BYTES:
        raise InputError(
            "little_memory",
            f"{what} needs {LEAST_BYTES >> 20} MiB of address space, and this process may have {limit >> 20} MiB",
            "raise the limit (ulimit -v unlimited)",
        )


def map_in_processes(work: Callable[[Job], Answer], jobs: Iterable[Job]) -> Generator[Answer, None, None]:
    """``work`` of every job, in order, in at most `job_limit` processes.

    The first two jobs run here; the time of the second one shows whether the rest is worth starting processes.
    Processes are spawned, not forked: OpenCV's threads do not survive a fork (docs/decisions/0006-processes.md).

    Args:
        work: a function at the top level of a module (or a partial of one), without side effects.  It is sent with
            every job; large arguments that all jobs share go to :func:`map_sharing`.
    """
    yield from _map(work, work, None, list(jobs))


def map_sharing(
    work: Callable[[Shared, Job], Answer], shared: Shared, jobs: Iterable[Job]
) -> Generator[Answer, None, None]:
    """``work(shared, job)`` of every job, as :func:`map_in_processes`; ``shared`` is sent to each process once."""
    yield from _map(partial(work, shared), partial(_with_shared, work), shared, list(jobs))


def map_in_threads(work: Callable[[Job], Answer], jobs: Iterable[Job]) -> Generator[Answer, None, None]:
    """``work`` of every job, in order, in at most `job_limit` threads of this process.

    For work that OpenCV, numpy and kernels do on large arrays, without the interpreter's lock: threads need neither
    imports nor copies of what jobs share.
    """
    limit = job_limit()
    if limit == 1:
        yield from map(work, jobs)
        return
    from concurrent.futures import ThreadPoolExecutor

    with ThreadPoolExecutor(limit) as pool:
        yield from pool.map(work, jobs)


def _map(
    here: Callable[[Job], Answer], in_worker: Callable[[Job], Answer], shared: Any, jobs: list[Job]
) -> Generator[Answer, None, None]:
    """
    Args:
        here, in_worker: the same work, for this process and for workers that were given ``shared``.
    """
    limit = min(job_limit(), len(jobs) - 2)
    cost_s = 0.0
    for job in itertools.islice(jobs, 2):
        start = time.perf_counter()
        answer = here(job)
        cost_s = time.perf_counter() - start
        yield answer
    rest = jobs[2:]
    if limit <= 1 or cost_s * len(rest) < WORTH_WORKERS_S:
        yield from map(here, rest)
        return
    from concurrent.futures import ProcessPoolExecutor
    from concurrent.futures.process import BrokenProcessPool

    from lmkit.worker_processes import WorkerContext

    with ProcessPoolExecutor(
        limit, mp_context=WorkerContext(), initializer=_start_worker, initargs=(shared,)
    ) as pool:
        try:
            yield from pool.map(in_worker, rest)
        except BrokenProcessPool:
            raise InputError(
                "worker_ended",
                "a worker process ended before its work was done, most likely because memory ran out",
                f"use fewer processes: --jobs 1, or {VARIABLE}=1 in the environment",
            ) from None


def _start_worker(shared: Any) -> None:
    import cv2

    from lmkit.worker_processes import end_with_parent

    global _shared
    _shared = shared
    cv2.setNumThreads(1)
    end_with_parent()


def _with_shared(work: Callable[[Any, Job], Answer], job: Job) -> Answer:
    return work(_shared, job)
