"""Several cores for many pictures."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import ProcessPoolExecutor
from typing import TypeVar

import cv2

Job = TypeVar("Job")
Answer = TypeVar("Answer")


def map_in_processes(work: Callable[[Job], Answer], jobs: Iterable[Job]) -> Generator[Answer, None, None]:
    """``work`` of every job, in order, on as many processes as there are cores.

    Processes are spawned, not forked: OpenCV's own threads do not survive a fork.

    Args:
        work: a function at the top level of a module (or a partial of one), without side effects.
    """
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(mp_context=context, initializer=cv2.setNumThreads, initargs=(1,)) as pool:
        yield from pool.map(work, jobs)
