"""Open a camera, stream, command or ROS topic as a source of images."""

from __future__ import annotations

from lmkit.live.captures import Capture, PipeCapture, SplitCapture, VideoCapture
from lmkit.live.clock import LoopClock
from lmkit.live.ros_capture import RosCapture
from lmkit.live.source_address import SourceAddress


def open_capture(address: SourceAddress, clock: LoopClock) -> Capture:
    """Open a live source.

    Raises:
        SourceLost: it cannot be opened.
    """
    capture: Capture
    if address.kind == "ros2":
        capture = RosCapture(address, clock)
    elif address.kind == "pipe":
        capture = PipeCapture(address, clock)
    else:
        capture = VideoCapture(address, clock)
    return SplitCapture(capture) if address.split else capture
