"""State that the handlers share."""

from __future__ import annotations

from dataclasses import dataclass, field

from starlette.requests import HTTPConnection

from lmkit.web.jobs import Jobs
from lmkit.web.live import LiveHub
from lmkit.web.project import Project
from lmkit.web.workers import Workers


@dataclass
class State:
    """The project, its processes and its jobs.

    Attributes:
        address: address of the page for a phone, with the token; None if only this machine has access.
    """

    project: Project
    workers: Workers
    jobs: Jobs
    live: LiveHub = field(default_factory=LiveHub)
    address: str | None = None


def state_of(request: HTTPConnection) -> State:
    """The state of the server that a request came to."""
    state = request.app.state.lmkit
    assert isinstance(state, State)
    return state
