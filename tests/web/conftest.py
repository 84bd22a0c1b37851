"""A project folder, and the page over it."""

from __future__ import annotations

import numpy as np
import pytest
from starlette.testclient import TestClient

import lmkit
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import LandmarkMap, MappedLandmark, wall_pose
from lmkit.web.app import build_app
from lmkit.web.project import open_project
from lmkit.web.workers import Workers


@pytest.fixture(scope="session")
def serve():
    """A function: the page over a folder, asked as a browser on this machine asks."""
    return lambda folder: TestClient(
        build_app(open_project(folder), workers=Workers(0)), base_url="http://127.0.0.1:8600"
    )


@pytest.fixture(scope="session")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("project")


@pytest.fixture(scope="session")
def client(folder, serve):
    with serve(folder) as client:
        yield client


@pytest.fixture(scope="session")
def printed(client):
    """A print of two landmarks."""
    return client.post("/api/prints/pdf", json={"codes": "3,7", "size": "60mm"}).json()


@pytest.fixture
def mapped(tmp_path, serve):
    """A page over a project with a map of three landmarks, and its folder."""
    places = [(1.0, 0.0, 1.2), (3.0, 0.0, 1.2), (4.0, 2.0, 1.3)]
    landmarks = [
        MappedLandmark(LandmarkId("lm8", 5 + k), 0.18, wall_pose(p, np.radians(90 + 45 * k)), 1e-6 * np.eye(6))
        for k, p in enumerate(places)
    ]
    lmkit.write_map(LandmarkMap(landmarks), tmp_path / "map.yaml")
    with serve(tmp_path) as page:
        yield page, tmp_path
