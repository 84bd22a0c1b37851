"""Jobs: commands of lmkit that run in separate processes, with progress, log and cancel."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import json
import os
import signal
import sys
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from lmkit.errors import InputError

PROGRESS = "\x1eprogress "  # begins a line of progress on stderr (lmkit/cli/output.py)
LOG_LINES = 400
LINE_BYTES = 16 * 1024 * 1024
KEPT = 50
WAITING = 10
WISH_EVERY_S = 0.2
GRACE_S = 3.0  # between asking a process to end and killing it


@dataclass(eq=False)
class Job:
    """One command, waiting, running or ended.

    Attributes:
        verb: kind of the job, such as ``survey``.
        title: description for the user.
        command: the command line, as text.
        steps: arguments of ``python`` for each command, in order.
        outputs: files it writes, relative to the project.
        save_json: file for its standard output, or None.
        on_line: called with every line of standard output, instead of the log.
        wish: line for standard input, written whenever it changes; or None.
        can_finish: whether a line on standard input ends it early, with a result.
        finishing: whether it was asked to end early.
        state: ``waiting``, ``running``, ``done``, ``failed`` or ``canceled``.
    """

    id: str
    verb: str
    title: str
    command: str
    steps: tuple[tuple[str, ...], ...]
    outputs: tuple[str, ...] = ()
    save_json: Path | None = None
    on_line: Callable[[bytes], None] | None = None
    wish: Callable[[], bytes] | None = None
    can_finish: bool = False
    finishing: bool = False
    state: str = "waiting"
    started: float | None = None
    ended: float | None = None
    progress: dict[str, Any] | None = None
    log: deque[str] = field(default_factory=lambda: deque(maxlen=LOG_LINES))
    error: str | None = None
    canceled: bool = False
    before: Job | None = None  # this job waits for the end of that job
    task: asyncio.Task[None] | None = None

    def as_dict(self, with_log: bool = False) -> dict[str, Any]:
        """The job as the page shows it."""
        seconds = None if self.started is None else (self.ended or time.time()) - self.started
        shown = {
            "id": self.id, "verb": self.verb, "title": self.title, "command": self.command, "state": self.state,
            "progress": self.progress, "error": self.error, "outputs": list(self.outputs),
            "can_finish": self.can_finish and self.state == "running" and not self.finishing,
            "seconds": None if seconds is None else round(seconds, 1),
            "waits_for": self.before.title if self.before is not None and self.before.ended is None else None,
        }  # fmt: skip
        if with_log:
            return shown | {"log": list(self.log)}
        # A list of jobs has no images.
        return shown | {"progress": self.progress and {k: v for k, v in self.progress.items() if k != "image"}}


class Jobs:
    """Runs one job at a time, in order.

    Args:
        folder: working folder of the jobs.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._jobs: dict[str, Job] = {}
        self._numbers = itertools.count(1)
        self._turn = asyncio.Lock()

    def start(
        self,
        verb: str,
        title: str,
        steps: Sequence[Sequence[str]],
        command: str,
        outputs: Sequence[str] = (),
        save_json: Path | None = None,
        on_line: Callable[[bytes], None] | None = None,
        wish: Callable[[], bytes] | None = None,
        can_finish: bool = False,
    ) -> Job:
        """Start a job, or queue it.

        Raises:
            InputError: too many jobs wait.
        """
        if sum(job.state == "waiting" for job in self._jobs.values()) >= WAITING:
            raise InputError("busy", f"{WAITING} jobs are waiting", "wait, or cancel some of them")
        job = Job(
            f"{next(self._numbers)}",
            verb,
            title,
            command,
            tuple(map(tuple, steps)),
            tuple(outputs),
            save_json,
            on_line,
            wish,
            can_finish,
        )
        job.before = next((j for j in reversed(self._jobs.values()) if j.ended is None), None)
        if can_finish:
            job.wish = lambda: b"finish\n" if job.finishing else b""
        self._jobs[job.id] = job
        for old in [j for j in self._jobs.values() if j.ended is not None][: max(0, len(self._jobs) - KEPT)]:
            del self._jobs[old.id]
        job.task = asyncio.create_task(self._run(job))
        return job

    def all(self) -> list[Job]:
        """Jobs, the newest first."""
        return list(self._jobs.values())[::-1]

    def find(self, id_: str) -> Job:
        """A job by its number.

        Raises:
            InputError: there is none.
        """
        if id_ not in self._jobs:
            raise InputError("no_job", f"there is no job {id_[:20]}", "reload the page")
        return self._jobs[id_]

    def cancel(self, job: Job) -> None:
        """Cancel a job; files are written completely or not at all."""
        if job.ended is None and job.task is not None and not job.canceled:
            job.canceled = True
            job.task.cancel()

    def finish(self, job: Job) -> None:
        """End a running job early, with its result so far.

        Raises:
            InputError: the job cannot end early, or is not running.
        """
        if not job.can_finish or job.state != "running":
            raise InputError("not_finishing", f"job {job.id} cannot end early", "cancel it, or wait for its end")
        job.finishing = True

    async def close(self) -> None:
        """End all jobs."""
        tasks = [job.task for job in self._jobs.values() if job.task is not None and job.ended is None]
        for job in self._jobs.values():
            self.cancel(job)
        await asyncio.gather(*tasks, return_exceptions=True)

    async def _run(self, job: Job) -> None:
        try:
            async with self._turn:
                job.state, job.started, job.before = "running", time.time(), None
                code = 0
                for step in job.steps:
                    if code == 0:
                        code = await self._process(job, step)
            job.state = "done" if code == 0 else "failed"
            # Stderr also has warnings; its last line is an error only if the command failed.
            job.error = None if code == 0 else job.error or f"ended with exit code {code}"
        except asyncio.CancelledError:
            job.state = "canceled"
        except Exception as error:
            job.state, job.error = "failed", str(error)
        finally:
            job.ended = time.time()

    async def _process(self, job: Job, words: Sequence[str]) -> int:
        environment = {**os.environ, "LMKIT_PROGRESS": "lines", "PYTHONUNBUFFERED": "1", "NO_COLOR": "1"}
        process = await asyncio.create_subprocess_exec(
            sys.executable,
            *words,
            cwd=self._folder,
            env=environment,
            stdin=asyncio.subprocess.DEVNULL if job.wish is None else asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.PIPE,
            limit=LINE_BYTES,
            start_new_session=os.name == "posix",
        )
        assert process.stdout is not None and process.stderr is not None
        telling = asyncio.create_task(_tell(job.wish, process.stdin))
        try:
            await asyncio.gather(self._results(job, process.stdout), self._messages(job, process.stderr))
            return await process.wait()
        except BaseException:
            await _end(process)
            raise
        finally:
            telling.cancel()
            if process.stdin is not None:
                process.stdin.close()

    async def _results(self, job: Job, stream: asyncio.StreamReader) -> None:
        kept: list[bytes] = []
        async for line in stream:
            if job.on_line is not None:
                job.on_line(line)
            elif job.save_json is None:
                job.log.append(line.decode(errors="replace").rstrip()[:2000])
            elif sum(map(len, kept)) < LINE_BYTES:
                kept.append(line)
        if job.save_json is not None and kept:
            job.save_json.parent.mkdir(parents=True, exist_ok=True)
            job.save_json.write_bytes(b"".join(kept))

    async def _messages(self, job: Job, stream: asyncio.StreamReader) -> None:
        async for line in stream:
            text = line.decode(errors="replace").rstrip()
            if text.startswith(PROGRESS):
                with contextlib.suppress(ValueError):
                    job.progress = json.loads(text.removeprefix(PROGRESS))
                continue
            job.log.append(text[:2000])
            job.error = text.removeprefix("lmkit: ")[:2000]


async def _tell(wish: Callable[[], bytes] | None, stream: asyncio.StreamWriter | None) -> None:
    """Write the wish whenever it changes, until the process ends."""
    said = b""
    with contextlib.suppress(ConnectionError):
        while wish is not None and stream is not None:
            if wish() != said:
                said = wish()
                stream.write(said)
                await stream.drain()
            await asyncio.sleep(WISH_EVERY_S)


async def _end(process: asyncio.subprocess.Process) -> None:
    """Ask a process and its workers to end, then kill them."""
    for sign in (signal.SIGTERM, getattr(signal, "SIGKILL", signal.SIGTERM)):
        with contextlib.suppress(ProcessLookupError):
            if os.name == "posix":
                os.killpg(process.pid, sign)
            else:
                process.terminate()
        with contextlib.suppress(asyncio.TimeoutError):
            await asyncio.wait_for(asyncio.shield(process.wait()), GRACE_S)
