"""A project folder, and the page over it."""

from __future__ import annotations

import pytest
from starlette.testclient import TestClient

from lmkit.web.app import build_app
from lmkit.web.project import open_project
from lmkit.web.workers import Workers


@pytest.fixture(scope="session")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("project")


@pytest.fixture(scope="session")
def client(folder):
    """The page, asked as a browser on this machine asks."""
    with TestClient(build_app(open_project(folder), workers=Workers(0)), base_url="http://127.0.0.1:8600") as client:
        yield client
