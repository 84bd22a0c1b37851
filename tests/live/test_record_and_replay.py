"""A recorded run is replayed to the same poses, bit for bit."""

from __future__ import annotations

import numpy as np
import pytest

from lmkit.errors import InputError
from lmkit.live.open_run import open_run
from lmkit.live.outputs.recorder import free_name
from lmkit.live.run_settings import RunFile, RunSettings
from lmkit.live.state import LiveState

mcap = pytest.importorskip("mcap.reader")


def states_of(**values) -> list[LiveState]:
    run = open_run(RunSettings(RunFile(**values)))
    states: list[LiveState] = []
    run.listeners.append(states.append)
    run.run()
    return states


def assert_equal(first: list[LiveState], second: list[LiveState]) -> None:
    assert [s.status for s in first] == [s.status for s in second]
    assert any(s.T_map_base is not None for s in first)
    for one, other in zip(first, second, strict=True):
        if one.T_map_base is not None:
            assert np.array_equal(one.T_map_base.matrix, other.T_map_base.matrix)
            assert np.array_equal(one.covariance, other.covariance)


@pytest.fixture
def files(tmp_path):
    """Rig and map as files, which a recording keeps as they are."""
    from lmkit.io.landmark_map import map_to_yaml
    from lmkit.io.rig import rig_to_yaml
    from lmkit.live.simulated_source import SimulatedRun
    from lmkit.live.source_address import parse_source

    course = SimulatedRun(parse_source("sim:?seconds=2&seed=1")).course
    (tmp_path / "rig.yaml").write_text(rig_to_yaml(course.rig))
    (tmp_path / "map.yaml").write_text(map_to_yaml(course.landmarks))
    return {"rig": str(tmp_path / "rig.yaml"), "map": str(tmp_path / "map.yaml")}


def test_corners_are_replayed_to_the_same_poses(tmp_path, files):
    record = str(tmp_path / "drive.mcap")
    first = states_of(sources=["sim:?seconds=4&speed=max&images=no&seed=1"], record=record, **files)
    assert_equal(first, states_of(sources=[f"replay:{record}"]))
    with pytest.raises(InputError, match="exists"):
        states_of(sources=["sim:?seconds=2&speed=max&images=no"], record=record)
    assert free_name(tmp_path / "drive.mcap").name == "drive-2.mcap"
    # A file that was cut off is replayed as far as it goes.
    data = (tmp_path / "drive.mcap").read_bytes()
    (tmp_path / "cut.mcap").write_bytes(data[: len(data) // 2])
    cut = states_of(sources=[f"replay:{tmp_path / 'cut.mcap'}"])
    assert 20 < len(cut) < len(first)
    (tmp_path / "other.mcap").write_bytes(b"nothing")
    with pytest.raises(InputError, match=r"other\.mcap"):
        states_of(sources=[f"replay:{tmp_path / 'other.mcap'}"])


@pytest.mark.slow
def test_images_are_replayed_to_the_same_poses_and_viewers_read_the_file(tmp_path, files):
    record = tmp_path / "drive.mcap"
    first = states_of(sources=["sim:?seconds=1&fps=5&speed=max&seed=1"], record=str(record), confirm=1, **files)
    second = states_of(sources=[f"replay:{record}"])
    for one, other in zip(first, second, strict=True):
        assert [len(v.detections) for v in one.views] == [len(v.detections) for v in other.views]
        for a, b in zip(one.views, other.views, strict=True):
            assert np.array_equal(a.image, b.image)
    assert_equal(first, second)
    with record.open("rb") as file:
        summary = mcap.make_reader(file).get_summary()
    assert {c.topic for c in summary.channels.values()} >= {
        "/lmkit/pose",
        "/lmkit/left/image/compressed",
        "/lmkit/step",
    }
