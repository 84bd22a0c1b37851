"""Stages: one job per recording; its result or failure is one row of the store."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from lmkit.errors import LmkitError
from lmkit.fleet.engines import run_jobs, share_of
from lmkit.fleet.recordings import FleetRecording, stored_recordings
from lmkit.fleet.store import Store

READERS = 16  # threads that read rows
DIED = "the worker process died each time: out of memory, or killed; try --jobs 1, or a larger machine"


@dataclass(frozen=True)
class Outcome:
    """Result of one job.

    Attributes:
        recording: the recording's name.
        failure: reason of a failure, in one sentence; empty if the job succeeded.
        seconds: of the job.
        facts: numbers and texts for the report.
    """

    recording: str
    failure: str = ""
    seconds: float = 0.0
    facts: Mapping[str, Any] = field(default_factory=dict)

    @property
    def ok(self) -> bool:
        """Whether the job succeeded."""
        return not self.failure


@dataclass(frozen=True)
class StageJob:
    """One job, in the form for a worker."""

    store: Store
    recording: FleetRecording
    stage: str
    key: str
    options: Mapping[str, Any]


StageWork = Callable[[StageJob], dict[str, Any]]


@dataclass(frozen=True)
class Guarded:
    """Work whose exceptions become failures; the worker writes the outcome to the store."""

    work: StageWork

    def __call__(self, job: StageJob) -> Outcome:
        """The outcome, after it is written to the store."""
        start = time.perf_counter()
        facts: dict[str, Any] = {}
        failure = ""
        try:
            facts = self.work(job)
        except LmkitError as error:
            failure = f"{error.message}; {error.hint}"
        except MemoryError:
            failure = "not enough memory; give the job a larger machine, or split the recording"
        except Exception as error:
            failure = f"internal error (please report): {type(error).__name__}: {error}"
        outcome = Outcome(job.recording.name, failure, time.perf_counter() - start, facts)
        write_outcome(job, outcome)
        return outcome


def write_outcome(job: StageJob, outcome: Outcome) -> None:
    """Write the row of a job's outcome; it is written last, so that a row implies complete results."""
    about = {"facts": dict(outcome.facts), "source": job.recording.source}
    values = {"recording": outcome.recording, "failure": outcome.failure, "seconds": outcome.seconds}
    row = {name: [value] for name, value in values.items()}
    job.store.write_table(_row(job.stage, job.key), row, about)


def read_outcome(store: Store, stage: str, key: str) -> Outcome | None:
    """Outcome of a job; None if it was not run."""
    return _read_row(store, stage, key) if store.exists(_row(stage, key)) else None


def _read_row(store: Store, stage: str, key: str) -> Outcome:
    columns, about = store.read_table(_row(stage, key))
    return Outcome(columns["recording"][0], columns["failure"][0], float(columns["seconds"][0]), about["facts"])


def read_outcomes(store: Store, stage: str, keys: Sequence[str]) -> dict[str, Outcome]:
    """Outcomes of the jobs that were run, by key.

    One listing finds them, and rows are read in parallel: a bucket needs a tenth of a second for each.
    """
    stored = set(store.names(stage))
    run = [key for key in keys if _row(stage, key).removeprefix(f"{stage}/") in stored]
    with ThreadPoolExecutor(READERS) as pool:
        return dict(zip(run, pool.map(partial(_read_row, store, stage), run), strict=True))


def _row(stage: str, key: str) -> str:
    return f"{stage}/{key}.row.parquet"


@dataclass(frozen=True)
class StageRun:
    """A run of a stage; iterating over its outcomes runs the jobs.

    Attributes:
        jobs: remaining jobs.
        work: function that runs a job.
        engine: engine that runs the jobs.
        failed_before: number of jobs that failed in an earlier run, and are not repeated.
    """

    jobs: tuple[StageJob, ...]
    work: StageWork
    engine: str
    failed_before: int

    def __iter__(self) -> Iterator[Outcome]:
        """Outcomes, in the order of completion."""
        for job, outcome in run_jobs(Guarded(self.work), self.jobs, self.engine):
            if outcome is None:
                outcome = Outcome(job.recording.name, DIED)
                write_outcome(job, outcome)
            yield outcome


def run_stage(
    store: Store,
    stage: str,
    work: StageWork,
    options: Mapping[str, Any],
    engine: str = "local",
    shard: str | None = None,
    retry: bool = False,
    recordings: Sequence[FleetRecording] | None = None,
) -> StageRun:
    """A run of the remaining jobs.

    Args:
        options: all inputs of the results besides the recording.
        recordings: recordings to process; None: all.
        retry: run failed jobs again.

    Raises:
        InputError: nothing was scanned, or no such shard; during the run, the engine is not available.
    """
    chosen = share_of(stored_recordings(store) if recordings is None else recordings, shard)
    keys = [recording.key(stage, options) for recording in chosen]
    before = read_outcomes(store, stage, keys)
    failed = {key for key, outcome in before.items() if not outcome.ok}
    done = before.keys() - (failed if retry else ())
    jobs = [
        StageJob(store, recording, stage, key, recording.own_options(options))
        for recording, key in zip(chosen, keys, strict=True)
        if key not in done
    ]
    return StageRun(tuple(jobs), work, engine, 0 if retry else len(failed))


def done_jobs(store: Store, stage: str, options: Mapping[str, Any]) -> list[tuple[FleetRecording, str, Outcome]]:
    """Recordings, keys and outcomes of a stage that was run with these options."""
    recordings = stored_recordings(store)
    keys = [recording.key(stage, options) for recording in recordings]
    outcomes = read_outcomes(store, stage, keys)
    return [
        (recording, key, outcomes[key]) for recording, key in zip(recordings, keys, strict=True) if key in outcomes
    ]
