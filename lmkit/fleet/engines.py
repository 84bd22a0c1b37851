"""Engines: the executors that run a fleet's jobs, on this machine, on a Dask cluster, or a share of them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from typing import Any, TypeVar

from lmkit.errors import EXTRA, InputError
from lmkit.parallel import job_limit
from lmkit.worker_processes import WorkerContext, end_with_parent

Job = TypeVar("Job")
Answer = TypeVar("Answer")

DASK = "dask:"
TRIES = 2  # runs of a job whose worker dies


def share_of(jobs: Sequence[Job], shard: str | None) -> list[Job]:
    """The jobs of one shard ``K/N``, counted from 1; all without one.

    Raises:
        InputError: not such a text.
    """
    if shard is None:
        return list(jobs)
    part, _, total = shard.partition("/")
    if not (part.isdecimal() and total.isdecimal() and 1 <= int(part) <= int(total)):
        raise InputError("bad_shard", f"'{shard}' is not a shard", "give K/N with K from 1 to N, such as 3/64")
    return list(jobs[int(part) - 1 :: int(total)])


def run_jobs(
    work: Callable[[Job], Answer], jobs: Sequence[Job], engine: str = "local"
) -> Iterator[tuple[Job, Answer | None]]:
    """Each job with its result, in the order of completion; None if its worker died every time.

    Args:
        work: a function at the top level of a module, which must not raise.
        engine: ``local``, or ``dask:ADDRESS`` of a scheduler.

    Raises:
        InputError: an unknown engine, or no scheduler at that address.
    """
    if engine == "local" and min(job_limit(), len(jobs)) <= 1:
        yield from ((job, work(job)) for job in jobs)
        return
    left = list(jobs)
    for _ in range(TRIES):
        died: list[Job] = []
        with executor_for(engine, len(left)) as pool:
            yield from _completed(pool, work, left, died)
        left = died
        if not left:
            return
    # One process per job, so that a job that kills its worker does not affect others.
    for job in left:
        died_alone: list[Job] = []
        with executor_for(engine, 1) as pool:
            yield from _completed(pool, work, [job], died_alone)
        if died_alone:
            yield job, None


def _completed(
    pool: Executor, work: Callable[[Job], Answer], jobs: Sequence[Job], died: list[Job]
) -> Iterator[tuple[Job, Answer]]:
    pending: dict[Future[Answer], Job] = {}
    try:
        for job in jobs:
            pending[pool.submit(work, job)] = job
    except BrokenProcessPool:
        died += [job for job in jobs if job not in pending.values()]
    while pending:
        for future in wait(pending, return_when=FIRST_COMPLETED).done:
            job = pending.pop(future)
            error = future.exception()
            if error is None:
                yield job, future.result()
            elif isinstance(error, BrokenProcessPool) or type(error).__name__ == "KilledWorker":
                died.append(job)
            else:
                raise error


@contextmanager
def executor_for(engine: str, jobs: int) -> Iterator[Executor]:
    """An executor.

    Raises:
        InputError: an unknown engine, distributed is not installed, or no scheduler answers.
    """
    if engine == "local":
        processes = max(1, min(job_limit(), jobs))
        with ProcessPoolExecutor(processes, mp_context=WorkerContext(), initializer=end_with_parent) as pool:
            yield pool
        return
    if not engine.startswith(DASK):
        raise InputError("bad_engine", f"engine '{engine}' is unknown", "give local, or dask:tcp://HOST:8786")
    client = _client(engine.removeprefix(DASK))
    try:
        yield client.get_executor(pure=False)
    finally:
        client.close()


def _client(address: str) -> Any:
    try:
        from distributed import Client
    except ImportError:
        raise InputError("no_dask", "the engine dask needs distributed", EXTRA.format("fleet")) from None
    try:
        return Client(address, timeout=10)  # type: ignore[no-untyped-call]
    except (OSError, ValueError, TimeoutError) as error:
        reason = str(error).splitlines()[0]
        raise InputError(
            "no_scheduler", f"no Dask scheduler at {address} ({reason})", "start dask scheduler"
        ) from None
