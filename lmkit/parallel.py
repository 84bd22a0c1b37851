"""Several cores for many pictures."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from typing import Any, TypeVar

import cv2

Shared = TypeVar("Shared")
Job = TypeVar("Job")
Answer = TypeVar("Answer")

_shared: Any = None  # of a worker process, what all of its jobs use


def map_in_processes(work: Callable[[Job], Answer], jobs: Iterable[Job]) -> Generator[Answer, None, None]:
    """``work`` of every job, in order, on as many processes as there are cores.

    Processes are spawned, not forked: OpenCV's own threads do not survive a fork.

    Args:
        work: a function at the top level of a module (or a partial of one), without side effects.  It is sent with
            every job; large arguments that all jobs share go to :func:`map_sharing`.
    """
    with _pool(None) as pool:
        yield from pool.map(work, jobs)


def map_sharing(
    work: Callable[[Shared, Job], Answer], shared: Shared, jobs: Iterable[Job]
) -> Generator[Answer, None, None]:
    """``work(shared, job)`` of every job, as :func:`map_in_processes`; ``shared`` is sent to each process once."""
    with _pool(shared) as pool:
        yield from pool.map(partial(_with_shared, work), jobs)


def _pool(shared: Any) -> ProcessPoolExecutor:
    context = multiprocessing.get_context("spawn")
    return ProcessPoolExecutor(mp_context=context, initializer=_start_worker, initargs=(shared,))


def _start_worker(shared: Any) -> None:
    global _shared
    _shared = shared
    cv2.setNumThreads(1)


def _with_shared(work: Callable[[Any, Job], Answer], job: Job) -> Answer:
    return work(_shared, job)
