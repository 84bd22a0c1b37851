"""Recorded and simulated sources: every frame in order, with the motion rows up to its time."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path

from lmkit.errors import InputError
from lmkit.io.image_groups import frame_groups
from lmkit.io.recording_tables import read_gyro, read_odometry
from lmkit.io.trajectory import read_trajectory
from lmkit.live.events import Health
from lmkit.live.frame_group import EndOfFeed, FrameGroup
from lmkit.live.motion import GYRO, POSE, WHEELS, MotionRow
from lmkit.live.reader import Rate
from lmkit.odometry.plausibility import require_plausible_gyro, require_plausible_odometry

POSE_SUFFIXES = (".tum", ".txt")


class StepFeed:
    """Returns the groups of an iterator one at a time; none is dropped.

    Args:
        paced: wait between groups for the difference of their stamps.
    """

    is_live = False

    def __init__(self, name: str, groups: Iterable[FrameGroup], paced: bool = False) -> None:
        self._name, self._groups, self._paced = name, iter(groups), paced
        self._start: tuple[float, float] | None = None
        self._count, self._rate = 0, Rate()
        self._ended = False

    def next(self, timeout_s: float) -> FrameGroup | None:
        """See `Feed`."""
        try:
            group = next(self._groups)
        except StopIteration:
            self._ended = True
            raise EndOfFeed from None
        self._count += 1
        self._rate.add(time.monotonic())
        if self._paced:
            now = time.monotonic()
            if self._start is None:
                self._start = (now, group.time_s)
            time.sleep(max(0.0, self._start[0] + group.time_s - self._start[1] - now))
        return group

    def health(self) -> tuple[Health, ...]:
        """See `Feed`."""
        problem = "ended" if self._ended else ""
        return (Health(self._name, not self._ended, self._rate.value(time.monotonic()), self._count, 0, problem),)

    def close(self) -> None:
        """See `Feed`."""
        close: Callable[[], None] | None = getattr(self._groups, "close", None)
        if close is not None:
            close()


def file_groups(sources: Sequence[str], hz: float | None, rows: Sequence[MotionRow]) -> Iterator[FrameGroup]:
    """Frames of films, folders or globs, with the motion rows up to each.

    Args:
        hz: frames per second; None: names end in seconds, or the films have times.

    Raises:
        InputError: an image cannot be read, or times are missing or do not increase.
    """
    given, last = 0, float("-inf")
    for k, frames in enumerate(frame_groups(sources)):
        time_s = k / hz if hz else frames[0].time_s
        if time_s is None:
            raise InputError(
                "no_times", f"{frames[0].name} has no time in its name", "give the images a second, such as --hz 5"
            )
        if time_s <= last:
            raise InputError("time_not_increasing", f"{frames[0].name}: time does not increase", "name them in order")
        last, first = time_s, given
        while given < len(rows) and rows[given].time_s <= time_s:
            given += 1
        images = tuple(frame.pixels for frame in frames)
        own = [frame.time_s for frame in frames if frame.time_s is not None]
        stamps = tuple(own) if hz is None and len(own) == len(frames) else (time_s,) * len(frames)
        yield FrameGroup(time_s, images, stamps, tuple(rows[first:given]))


def motion_rows(odometry: Path | None, gyro: Path | None) -> list[MotionRow]:
    """Rows of odometry (CSV of wheels, or TUM poses) and gyro files, in the order of time.

    Raises:
        InputError: a file cannot be read, or has implausible values: another unit, sign, axis or clock.
    """
    rows: list[MotionRow] = []
    table = None
    if odometry is not None and odometry.suffix.lower() in POSE_SUFFIXES:
        poses = read_trajectory(odometry)
        require_plausible_odometry(poses)
        for k, time_s in enumerate(poses.times_s.tolist()):
            rows.append(MotionRow(POSE, time_s, (), poses.pose(k, "odometry", "base")))
    elif odometry is not None:
        table = read_odometry(odometry, None)
        require_plausible_odometry(table)
        rows += [
            MotionRow(WHEELS, *row)
            for row in zip(
                table.times_s.tolist(),
                zip(table.forward_m.tolist(), table.turn_rad.tolist(), strict=True),
                strict=True,
            )
        ]
    if gyro is not None:
        rates = read_gyro(gyro)
        if table is not None:
            require_plausible_gyro(rates, table)
        rows += [
            MotionRow(GYRO, t, (rate,))
            for t, rate in zip(rates.times_s.tolist(), rates.rate_radps.tolist(), strict=True)
        ]
    return sorted(rows, key=lambda row: row.time_s)
