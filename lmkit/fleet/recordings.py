"""Recordings of a fleet: found by a pattern, kept in one table of the store."""

from __future__ import annotations

import glob
import hashlib
import json
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from lmkit.errors import InputError
from lmkit.fleet.store import Store, open_uri
from lmkit.model.landmark_map import day_of
from lmkit.pipelines.recording_folder import DETECTIONS, READINGS, VIDEOS
from lmkit.version import __version__

TABLE = "recordings.parquet"
LAYOUT = 3  # version of the stages' output; another version is another result
BAGS = (".mcap", ".bag", ".db3")
BAG_FOLDER_HAS = "metadata.yaml"  # of a ROS 2 bag
IMAGES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp")
PLACEHOLDER = re.compile(r"\{(\w+)\}")
LIMITS = ("max_bytes",)  # options that stop a job, but do not change results
TOPIC_ROLES = ("left", "right", "left_info", "right_info", "odometry", "imu")
KNOWN = ("site", "robot", "recording", "date")
DATE = re.compile(r"(?<!\d)(\d{4})-?(\d{2})-?(\d{2})(?!\d)")  # 2026-11-27 or 20261127


@dataclass(frozen=True)
class FleetRecording:
    """One recording found by `lmkit fleet scan`.

    Attributes:
        source: path or URI of a bag or of a folder with the recording's files.
        site: hall or building with its own map; empty if there is only one.
        robot: name of the robot.
        rig: path of the rig file; empty: ``rig.yaml`` in the recording's folder, or camera_info in the bag.
        bytes, modified_s: size and time of the latest change of the source; if either differs, it is another
            recording.
        wheel_track_m: distance between the wheels, meters; 0: not known.
        topics: of a bag, in the form of `parse_topics`; empty: found by type and name.
    """

    source: str
    site: str
    robot: str
    rig: str
    bytes: int
    modified_s: float
    wheel_track_m: float = 0.0
    topics: str = ""

    @property
    def name(self) -> str:
        """Name in messages and reports."""
        return "/".join(part for part in (self.site, self.robot, Path(self.source).name) if part)

    def own_options(self, options: Mapping[str, Any]) -> dict[str, Any]:
        """The options of this recording: of all ``maps`` only its site's."""
        maps = options.get("maps")
        if maps is None:
            return dict(options)
        return {**options, "maps": {site: text for site, text in maps.items() if site == self.site}}

    def key(self, stage: str, options: Mapping[str, Any]) -> str:
        """Name of a stage's results; results with the same version and options are not computed again."""
        rig = Path(self.rig)
        content = rig.read_bytes() if self.rig and rig.is_file() else b""
        own = {name: value for name, value in self.own_options(options).items() if name not in LIMITS}
        identity = [__version__, LAYOUT, stage, asdict(self), hashlib.sha256(content).hexdigest(), own]
        return hashlib.sha256(json.dumps(identity, sort_keys=True).encode()).hexdigest()[:20]


def parse_topics(text: str) -> dict[str, str | None]:
    """Topics by role from ``left=/cam0/image right=/cam1/image``.

    Raises:
        InputError: not such a text.
    """
    topics: dict[str, str | None] = {}
    for word in text.split():
        role, separator, topic = word.partition("=")
        if role not in TOPIC_ROLES or not (separator and topic):
            raise InputError(
                "bad_topic",
                f"--topic {word} names no topic",
                f"give ROLE=TOPIC, ROLE one of {', '.join(TOPIC_ROLES)}",
            )
        topics[role] = topic
    return topics


def find_recordings(
    pattern: str, rig: str = "", wheel_track_m: float = 0.0, topics: str = ""
) -> list[FleetRecording]:
    """Recordings whose paths match a pattern.

    Args:
        pattern: path or URI with ``*``, ``**`` and the names ``{site}``, ``{robot}``, ``{recording}``, ``{date}``,
            each of which matches one part of the path: ``logs/{site}/{robot}/*.mcap``.
        rig: path of the rig files, with the same names: ``rigs/{robot}.yaml``; with ``{date}``, the
            last of several files that is not later than the recording: ``rigs/{robot}/{date}.yaml``.
        wheel_track_m, topics: for all of them; see `FleetRecording`.

    Raises:
        InputError: an unknown name, a name in the rig path that is not in the pattern, invalid topics, or no match.
    """
    from pyarrow import fs

    parse_topics(topics)
    names = PLACEHOLDER.findall(pattern)
    unknown = [n for n in names if n not in KNOWN] + [
        n for n in PLACEHOLDER.findall(rig) if n not in (*names, "date")
    ]
    if unknown:
        raise InputError(
            "bad_pattern",
            f"{{{unknown[0]}}} is not a placeholder of the pattern",
            f"use {', '.join(KNOWN)} in the pattern",
        )
    scheme, separator, path = pattern.rpartition("://")
    fixed = re.split(r"[*{\[?]", path, maxsplit=1)[0].rpartition("/")[0]
    files, root = open_uri(f"{scheme}{separator}{fixed}" if fixed else ".")
    expression = re.compile(_expression(path[len(fixed) :].lstrip("/")))
    found = []
    try:
        listed = files.get_file_info(fs.FileSelector(root, recursive=True, allow_not_found=True))
    except UnicodeDecodeError as error:
        name = error.object.decode("utf-8", "backslashreplace")
        raise InputError("bad_name", f"{name}: a name that is no text (UTF-8)", "rename the file or folder") from None
    for info in listed:
        place = info.path[len(root) :].lstrip("/")
        matched = expression.fullmatch(place)
        if matched is None or any(part.startswith(".") for part in place.split("/")):
            continue
        parts = {name: matched.groupdict().get(name, "") for name in KNOWN}
        size, modified = _extent(files, info)
        if size is None:
            continue
        source = f"{scheme}{separator}{info.path}" if separator else info.path
        mine = _rig_file(rig, matched.groupdict(), modified)
        found.append(
            FleetRecording(source, parts["site"], parts["robot"], mine, size, modified, wheel_track_m, topics)
        )
    if not found:
        raise InputError(
            "no_recordings",
            f"no recording matches {pattern}",
            f"quote the pattern; a recording is a bag ({', '.join(BAGS)}), or a folder with images, detections.csv "
            "or readings.csv",
        )
    return sorted(found, key=lambda r: r.source)


def _rig_file(template: str, parts: Mapping[str, str], modified_s: float) -> str:
    """The rig file of a recording; of several files with dates, the last one that is not later than the recording.

    The recording's day is ``{date}`` of its path if this is a date, else the day of its latest change.
    """
    day = _date_in(parts.get("date", "")) or day_of(modified_s)
    # A worker has another working folder.
    template = str(Path(template).absolute()) if template else ""
    filled = _filled(template, {**parts, "date": day})
    if "{date}" not in template:
        return filled
    dated = _filled(template, {**{name: glob.escape(part) for name, part in parts.items()}, "date": "*"})
    files = [(date, file) for file in glob.glob(dated) if (date := _date_in(Path(file).name) or _date_in(file))]
    return max(((date, file) for date, file in files if date <= day), default=("", filled))[1]


def _date_in(text: str) -> str:
    """The first date in a text, as 2026-11-27; empty: there is none."""
    found = DATE.search(text)
    return "-".join(found.groups()) if found else ""


def _filled(template: str, parts: Mapping[str, str]) -> str:
    """The template with its names replaced by parts of a path."""
    return PLACEHOLDER.sub(lambda name: parts[name[1]], template)


def _expression(pattern: str) -> str:
    """Regular expression of a pattern below its fixed part."""
    seen: set[str] = set()
    out = []
    for part in re.split(r"(\*\*/|\*\*|\*|\?|\{\w+\})", pattern):
        if part == "**/":
            out.append(r"(?:[^/]+/)*")
        elif part == "**":
            out.append(r".*")
        elif part in ("*", "?"):
            out.append("[^/]" + ("*" if part == "*" else ""))
        elif PLACEHOLDER.fullmatch(part):
            name = part[1:-1]
            out.append(f"(?P={name})" if name in seen else rf"(?P<{name}>[^/]+)")
            seen.add(name)
        else:
            out.append(re.escape(part))
    return "".join(out)


def _extent(files: Any, info: Any) -> tuple[int | None, float]:
    """Bytes and time of the latest change of a recording; None instead of bytes if it is not a recording."""
    from pyarrow import fs

    if info.type == fs.FileType.File:
        return (info.size, _seconds(info)) if Path(info.path).suffix.lower() in BAGS else (None, 0.0)
    inside = files.get_file_info(fs.FileSelector(info.path, recursive=True))
    names = {i.path[len(info.path) :].lstrip("/") for i in inside if i.type == fs.FileType.File}
    images = any(Path(n).suffix.lower() in (*IMAGES, *VIDEOS) for n in names if n.count("/") <= 1)
    if not (names & {DETECTIONS, READINGS, BAG_FOLDER_HAS} or images):
        return None, 0.0
    held = [i for i in inside if i.type == fs.FileType.File]
    return sum(i.size for i in held), max(_seconds(i) for i in held)


def _seconds(info: Any) -> float:
    return float(info.mtime.timestamp()) if info.mtime is not None else 0.0


def add_recordings(store: Store, found: list[FleetRecording]) -> tuple[int, int]:
    """Add recordings to the store's table; those with the same source are replaced.

    Returns:
        Number of new or changed recordings, and number of all.
    """
    known = {r.source: r for r in stored_recordings(store)} if store.exists(TABLE) else {}
    changed = sum(known.get(r.source) != r for r in found)
    known |= {r.source: r for r in found}
    rows = sorted(known.values(), key=lambda r: r.source)
    store.write_table(TABLE, {f.name: [getattr(r, f.name) for r in rows] for f in fields(FleetRecording)})
    return changed, len(rows)


def stored_recordings(store: Store) -> list[FleetRecording]:
    """The store's table of recordings.

    Raises:
        InputError: nothing was scanned into the store.
    """
    if not store.exists(TABLE):
        raise InputError("no_scan", f"{store.uri} contains no recordings", "run lmkit fleet scan first")
    columns, _ = store.read_table(TABLE)
    lists = [values.tolist() if isinstance(values, np.ndarray) else values for values in columns.values()]
    return [FleetRecording(**dict(zip(columns, row, strict=True))) for row in zip(*lists, strict=True)]
