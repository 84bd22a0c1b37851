"""Addresses of image sources, such as ``camera:0?size=1280x720&fps=30``."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import parse_qsl

from lmkit.errors import InputError
from lmkit.io.image_sources import VIDEO_SUFFIXES
from lmkit.live.ros.address import parse_ros

STREAMS = ("rtsp", "rtsps", "http", "https", "udp", "tcp")
LIVE_KINDS = ("camera", "pipe", "stream", "ros2", "sim")
CAMERA_OPTIONS = ("size", "fps", "fourcc", "exposure", "latency")
SIM_OPTIONS = (
    "size", "fps", "seed", "seconds", "landmarks", "speed", "images", "cameras", "latency", "slips", "family", "lens",
)  # fmt: skip
_SECONDS = re.compile(r"(\d+(?:\.\d+)?)\s*(ms|s)")
_HINT = (
    "such as camera:0, split:camera:0, pipe:COMMAND, rtsp://HOST/PATH, ros2:/image_raw, sim:, replay:FILE.mcap, "
    "a video or a folder"
)


@dataclass(frozen=True)
class SourceAddress:
    """An image source.

    Attributes:
        kind: ``camera``, ``pipe``, ``stream``, ``ros2``, ``sim``, ``replay``, ``film`` or ``folder``.
        target: number, device, command, URL or path; of ROS 2 the input of `parse_ros`.
        options: after the question mark.
        split: the image shows the left and the right camera side by side.
        text: the address as given.
    """

    kind: str
    target: str
    options: dict[str, str] = field(default_factory=dict)
    split: bool = False
    text: str = ""

    @property
    def is_live(self) -> bool:
        """Whether images arrive in real time."""
        return self.kind in LIVE_KINDS and not (self.kind == "sim" and self.options.get("speed") == "max")

    @property
    def size(self) -> tuple[int, int] | None:
        """Requested (width, height)."""
        return None if "size" not in self.options else parse_size(self.options["size"], self.text)

    def number(self, name: str, default: float) -> float:
        """Value of an option that is a number.

        Raises:
            InputError: not a number above zero.
        """
        text = self.options.get(name)
        if text is None:
            return default
        try:
            value = float(text)
        except ValueError:
            value = -1.0
        if not 0 <= value < 1e9:
            raise InputError(
                "bad_source", f"{self.text}: {name}={text} is not a number", f"write for example {name}=30"
            )
        return value

    @property
    def latency_s(self) -> float:
        """Time from exposure to arrival, for drivers without stamps."""
        return parse_seconds(self.options["latency"], f"{self.text}: latency") if "latency" in self.options else 0.0


def parse_source(text: str) -> SourceAddress:
    """The address in a text.

    Raises:
        InputError: an unknown kind or option.
    """
    if text.startswith("split:"):
        inner = parse_source(text.removeprefix("split:"))
        return SourceAddress(inner.kind, inner.target, inner.options, True, text)
    scheme, colon, rest = text.partition(":")
    if colon and scheme.lower() in STREAMS and rest.startswith("//"):
        url, _, options = text.partition("#")
        return SourceAddress("stream", url, _options(options, text, CAMERA_OPTIONS), text=text)
    if scheme == "pipe" and colon:
        if not rest.strip():
            raise InputError(
                "bad_source", f"{text}: no command", "give for example 'pipe:rpicam-vid --codec mjpeg -o -'"
            )
        return SourceAddress("pipe", rest, text=text)
    if scheme == "ros2" and colon:
        if not parse_ros(":" + rest).topic:
            raise InputError("bad_source", f"{text}: no topic", "write for example ros2:/left/image_raw/compressed")
        return SourceAddress("ros2", ":" + rest, text=text)
    if scheme in ("camera", "sim") and colon:
        target, _, options = rest.partition("?")
        known = SIM_OPTIONS if scheme == "sim" else CAMERA_OPTIONS
        if scheme == "camera" and not (target.isdecimal() or target.startswith("/dev/")):
            raise InputError(
                "bad_source", f"{text}: no camera number or device", "write camera:0 or camera:/dev/video0"
            )
        return SourceAddress(scheme, target, _options(options, text, known), text=text)
    if scheme == "replay" and colon and Path(rest).suffix.lower() == ".mcap":
        return SourceAddress("replay", rest, text=text)
    path = Path(text.removeprefix("replay:"))
    text = str(path)
    if path.suffix.lower() in VIDEO_SUFFIXES:
        return SourceAddress("film", text, text=text)
    if path.exists() or "*" in text:
        return SourceAddress("folder", text, text=text)
    raise InputError("bad_source", f"{text}: no such file, and no known kind of source", _HINT)


def _options(text: str, source: str, known: tuple[str, ...]) -> dict[str, str]:
    found = dict(parse_qsl(text, keep_blank_values=True))
    for name in found:
        if name not in known:
            raise InputError("bad_source", f"{source}: unknown option {name}", f"known: {', '.join(known)}")
    return found


def parse_size(text: str, what: str) -> tuple[int, int]:
    """(width, height) of ``1280x720``.

    Raises:
        InputError: not such a size.
    """
    match = re.fullmatch(r"(\d{2,5})x(\d{2,5})", text)
    if match is None:
        raise InputError(
            "bad_source", f"{what}: size {text!r} is not WIDTHxHEIGHT", "write for example size=1280x720"
        )
    return int(match[1]), int(match[2])


def parse_seconds(text: str, what: str) -> float:
    """Seconds of ``80ms`` or ``0.1s``.

    Raises:
        InputError: not a number with one of both units.
    """
    match = _SECONDS.fullmatch(text.strip())
    if match is None:
        raise InputError("bad_duration", f"{what} {text!r} is not a time", "write for example 80ms or 1.5s")
    return float(match[1]) / (1000 if match[2] == "ms" else 1)
