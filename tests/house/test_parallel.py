"""Worker processes: the same answers in order, bounded, and none for small work."""

from __future__ import annotations

import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time
from multiprocessing.context import SpawnProcess
from multiprocessing.spawn import get_preparation_data
from pathlib import Path

import pytest

from lmkit import parallel, worker_processes
from lmkit.errors import InputError


@pytest.fixture(autouse=True)
def unbounded(monkeypatch):
    monkeypatch.setattr(parallel, "_limit", None)
    monkeypatch.delenv(parallel.VARIABLE, raising=False)


def answer(number: int) -> tuple[int, int]:
    return number, os.getpid()


@pytest.mark.parametrize("count", [0, 1, 2, 3, 7])
def test_small_work_stays_in_this_process(count):
    assert list(parallel.map_in_processes(answer, range(count))) == [(k, os.getpid()) for k in range(count)]


def test_large_work_goes_to_as_many_processes_as_allowed(monkeypatch):
    monkeypatch.setattr(parallel, "WORTH_WORKERS_S", 0.0)
    parallel.set_jobs(2)
    answers = list(parallel.map_in_processes(answer, range(12)))
    assert [number for number, _ in answers] == list(range(12))
    workers = {process for _, process in answers} - {os.getpid()}
    assert 1 <= len(workers) <= 2


def test_one_job_at_a_time_needs_no_worker(monkeypatch):
    monkeypatch.setattr(parallel, "WORTH_WORKERS_S", 0.0)
    monkeypatch.setenv(parallel.VARIABLE, "1")
    assert {process for _, process in parallel.map_in_processes(answer, range(9))} == {os.getpid()}


def test_the_second_job_tells_what_the_rest_costs(monkeypatch):
    """The first job also loads the modules that all jobs need."""
    clock = iter([0.0, 9.0, 9.0, 9.1])
    monkeypatch.setattr(time, "perf_counter", lambda: next(clock))
    assert {process for _, process in parallel.map_in_processes(answer, range(9))} == {os.getpid()}


def thread_of(number: int) -> tuple[int, int]:
    return number, threading.get_ident()


@pytest.mark.parametrize("limit", [1, 3])
def test_threads_answer_in_order_and_are_bounded(limit):
    parallel.set_jobs(limit)
    answers = list(parallel.map_in_threads(thread_of, range(20)))
    assert [number for number, _ in answers] == list(range(20))
    threads = {thread for _, thread in answers}
    assert len(threads) <= limit
    assert (threading.get_ident() in threads) == (limit == 1)


def test_jobs_that_nobody_waits_for_are_not_begun():
    parallel.set_jobs(2)
    begun = []

    def slow(number: int) -> int:
        begun.append(number)
        time.sleep(0.02)
        return number

    answers = parallel.map_in_threads(slow, range(50))
    next(answers)
    answers.close()
    assert len(begun) < 20


def test_the_bound_is_the_option_s_then_the_environment_s(monkeypatch):
    monkeypatch.setenv(parallel.VARIABLE, "3")
    assert parallel.job_limit() == 3
    parallel.set_jobs(5)
    assert parallel.job_limit() == 5


@pytest.mark.parametrize("text", ["0", "-2", "many"])
def test_a_bad_bound_is_refused(monkeypatch, text):
    monkeypatch.setenv(parallel.VARIABLE, text)
    with pytest.raises(InputError, match=text):
        parallel.job_limit()


def test_workers_do_not_run_the_caller_s_script_again(monkeypatch):
    """A script without ``if __name__ == "__main__"`` would run again in each worker."""
    monkeypatch.setattr(sys.modules["__main__"], "__file__", "script.py", raising=False)
    monkeypatch.setattr(SpawnProcess, "_Popen", lambda process: get_preparation_data("worker"))
    prepared = worker_processes.WorkerContext.Process._Popen(None)
    assert prepared["name"] == "worker"
    assert not {"init_main_from_name", "init_main_from_path"} & set(prepared)
    assert sys.modules["__main__"].__file__ == "script.py"


def end_abruptly(job):
    if multiprocessing.parent_process() is not None:
        os._exit(1)
    return job


@pytest.mark.slow
def test_a_worker_that_ends_abruptly_is_named(monkeypatch):
    monkeypatch.setattr(parallel, "WORTH_WORKERS_S", 0.0)
    parallel.set_jobs(2)
    with pytest.raises(InputError, match="memory ran out"):
        list(parallel.map_in_processes(end_abruptly, range(6)))


STARTER = """
from lmkit import parallel
from test_parallel import say_and_sleep
if __name__ == "__main__":
    parallel.WORTH_WORKERS_S = 0.0
    parallel.set_jobs(2)
    list(parallel.map_in_processes(say_and_sleep, range(6)))
"""


def say_and_sleep(job):
    if multiprocessing.parent_process() is not None:
        os.write(1, f"{os.getpid()}\n".encode())
        time.sleep(60)


@pytest.mark.slow
def test_workers_end_when_their_parent_is_killed(tmp_path):
    (tmp_path / "starter.py").write_text(STARTER)
    here = str(Path(__file__).parent)
    process = subprocess.Popen(
        [sys.executable, tmp_path / "starter.py"], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
        env=os.environ | {"PYTHONPATH": here}, start_new_session=True,
    )  # fmt: skip
    assert process.stdout is not None
    worker = int(process.stdout.readline())
    process.kill()
    process.wait()
    for _ in range(200):
        if not is_alive(worker):
            break
        time.sleep(0.05)
    else:
        os.killpg(process.pid, signal.SIGKILL)
        pytest.fail("a worker lives on")


def is_alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    status = Path(f"/proc/{pid}/status")
    return "State:\tZ" not in status.read_text() if status.exists() else True


@pytest.mark.skipif(not hasattr(signal, "pthread_sigmask"), reason="Windows has no signal masks")
def test_workers_start_with_interrupts_held(monkeypatch):
    """A signal during a worker's imports left a traceback; now workers accept signals only after their start."""

    def blocked() -> bool:
        return signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, ())

    seen = []
    monkeypatch.setattr(SpawnProcess, "_Popen", staticmethod(lambda process: seen.append(blocked())))
    worker_processes.WorkerContext().Process(target=answer)._Popen(None)
    assert seen == [True] and not blocked()
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    worker_processes.end_with_parent()
    assert not blocked()
