"""Events of sources, outputs and the robot; and the condition of sources and outputs."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Event:
    """An event of a source, an output or the robot, with a code for programs and a message for users.

    Attributes:
        code: short stable name, such as ``camera_lost``.
        message: one line.
        time_s: of the loop's clock.
    """

    code: str
    message: str
    time_s: float = 0.0

    def to_dict(self) -> dict[str, object]:
        """The event as JSON values."""
        return {"code": self.code, "message": self.message, "time_s": self.time_s}


@dataclass(frozen=True)
class Health:
    """Condition of a source or an output.

    Attributes:
        name: as given, such as ``camera:0`` or ``mavlink:udpout:127.0.0.1:14550``.
        good: whether it works now.
        rate_hz: images or messages per second.
        count: images or messages so far.
        lost: number of dropped ones.
        problem: reason why it does not work; empty if it works.
    """

    name: str
    good: bool
    rate_hz: float = 0.0
    count: int = 0
    lost: int = 0
    problem: str = ""

    def to_dict(self) -> dict[str, object]:
        """The condition as JSON values."""
        return dict(vars(self))
