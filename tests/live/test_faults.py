"""Planned faults of a live run: each is survived and named; no pose is published that is wrong by half a meter."""

from __future__ import annotations

import errno
import re
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lmkit.geometry.planar import planar_pose
from lmkit.geometry.pose import Pose
from lmkit.live.frame_group import FrameGroup
from lmkit.live.live_run import LiveRun
from lmkit.live.loop import LiveLoop, LoopSettings
from lmkit.live.motion import GYRO, MotionInbox
from lmkit.live.outputs.base import OutputLost, OutputRunner
from lmkit.live.reader import Reader
from lmkit.live.recorded_feed import StepFeed
from lmkit.live.simulated_source import FIRST_S, SimulatedRun
from lmkit.live.source_address import parse_source
from lmkit.live.state import LiveState
from lmkit.localization.mirror import mirrored_id
from lmkit.model.landmark_map import LandmarkMap
from lmkit.model.observation import Detection
from lmkit.model.pose_status import PoseStatus

WRONG_M = 0.5
FPS = 15
FROM, UNTIL = 60, 120  # frames of the fault
OLDER = 45

Frames = Iterator[FrameGroup]


def frames(simulated: SimulatedRun, change: Callable[[SimulatedRun, FrameGroup], FrameGroup]) -> Frames:
    """Frames of a run, those of the fault changed; odometry passes the inbox as live."""
    inbox = MotionInbox()
    for k, group in enumerate(simulated.groups()):
        changed = change(simulated, group) if FROM <= k < UNTIL else group
        for row in changed.motion:
            inbox.add(row)
        rows, events = inbox.take()
        yield replace(changed, motion=rows, events=events)


def blind_left(_: SimulatedRun, group: FrameGroup) -> FrameGroup:
    return replace(group, seen=((), group.seen[1]))


def dark(_: SimulatedRun, group: FrameGroup) -> FrameGroup:
    return replace(group, seen=((), ()))


def no_odometry(_: SimulatedRun, group: FrameGroup) -> FrameGroup:
    return replace(group, motion=())


def no_gyro(_: SimulatedRun, group: FrameGroup) -> FrameGroup:
    return replace(group, motion=tuple(row for row in group.motion if row.kind != GYRO))


def nan_odometry(_: SimulatedRun, group: FrameGroup) -> FrameGroup:
    return replace(
        group, motion=tuple(replace(row, values=tuple(np.nan for _ in row.values)) for row in group.motion)
    )


def wild_odometry(_: SimulatedRun, group: FrameGroup) -> FrameGroup:
    return replace(
        group, motion=tuple(replace(row, values=tuple(90 * v + 5 for v in row.values)) for row in group.motion)
    )


def spinning_wheels(_: SimulatedRun, group: FrameGroup) -> FrameGroup:
    return replace(group, motion=tuple(replace(row, values=tuple(2 * v for v in row.values)) for row in group.motion))


def late_odometry(_: SimulatedRun, group: FrameGroup) -> FrameGroup:
    return replace(group, motion=tuple(replace(row, time_s=row.time_s - 3) for row in group.motion))


def carried_off(simulated: SimulatedRun, group: FrameGroup) -> FrameGroup:
    x, y, heading = simulated.course.state(group.time_s)
    T = planar_pose(np.array([x - 1.2, y + 0.6, heading + 1.5]))
    return replace(group, truth=T, seen=simulated.course.corners(T))


def mirrored(_: SimulatedRun, group: FrameGroup) -> FrameGroup:
    def flip(d: Detection) -> Detection:
        corners = np.column_stack([639 - d.corners[:, 0], d.corners[:, 1]])[[1, 0, 3, 2]]
        return replace(d, id=mirrored_id(d.id), corners=corners)

    return replace(group, seen=tuple([flip(d) for d in seen if mirrored_id(d.id)] for seen in group.seen))


def swapped_cameras(_: SimulatedRun, group: FrameGroup) -> FrameGroup:
    return replace(group, seen=group.seen[::-1])


def false_readings(simulated: SimulatedRun, group: FrameGroup) -> FrameGroup:
    ids = [m.id for m in simulated.course.landmarks]
    wrong = dict(zip(ids, ids[1:] + ids[:1], strict=True))
    return replace(group, seen=tuple([replace(d, id=wrong[d.id]) for d in seen] for seen in group.seen))


def blurred_corners(_: SimulatedRun, group: FrameGroup) -> FrameGroup:
    rng = np.random.default_rng(int(1000 * group.time_s))
    noisy = lambda d: replace(d, corners=d.corners + rng.normal(0, 3.0, (4, 2)))  # noqa: E731
    return replace(group, seen=tuple([noisy(d) for d in seen] for seen in group.seen))


def frozen_view(simulated: SimulatedRun, group: FrameGroup) -> FrameGroup:
    """The view of the fault's first frame again and again, encoded anew: with other noise."""
    return replace(group, seen=simulated.course.corners(simulated.course.T_map_base(FIRST_S + FROM / FPS)))


def older_view(simulated: SimulatedRun, group: FrameGroup) -> FrameGroup:
    """An earlier view, from another place."""
    return replace(group, seen=simulated.course.corners(simulated.course.T_map_base(FIRST_S + OLDER / FPS)))


FAULTS = {
    frozen_view: "camera_stale",
    older_view: "camera_stale",
    blind_left: "",  # too short to be named: test_blind_cameras
    dark: "status_lost",
    no_odometry: "odometry_lost",
    no_gyro: "gyro_lost",
    nan_odometry: "wheels_not_finite",
    wild_odometry: "wheels_jump",
    spinning_wheels: "",
    late_odometry: "wheels_out_of_order",
    carried_off: "status_",
    mirrored: "status_",  # by name where two landmarks are in view: below
    swapped_cameras: "status_",
    false_readings: "status_",
    blurred_corners: "",
}


def run_of(seed: int, change, landmarks=None, seconds=16) -> list[LiveState]:
    simulated = SimulatedRun(parse_source(f"sim:?seconds={seconds}&speed=max&images=no&seed={seed}&fps={FPS}"))
    course = simulated.course
    loop = LiveLoop(
        course.rig, landmarks(course.landmarks) if landmarks else course.landmarks, LoopSettings("wheels")
    )
    run = LiveRun(loop, StepFeed("sim", frames(simulated, change)))
    states: list[LiveState] = []
    run.listeners.append(states.append)
    run.run()
    return states


def off_m(states: list[LiveState]) -> float:
    """Largest error of a published pose, m."""
    return max((float(np.linalg.norm((s.T_map_base.t - s.truth.t)[:2])) for s in states if s.T_map_base), default=0.0)


@pytest.mark.slow
@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.__name__)
def test_no_pose_is_published_that_is_wrong_by_half_a_meter(fault):
    for seed in (1, 2):
        states = run_of(seed, fault)
        assert off_m(states) < WRONG_M
        assert any(s.status == PoseStatus.OK for s in states)
        codes = {event.code for s in states[FROM - 1 : UNTIL + 1] for event in s.events}
        assert any(code.startswith(FAULTS[fault]) for code in codes) or not FAULTS[fault]
        # Some time after the fault the robot is located again.
        assert any(s.status == PoseStatus.OK for s in states[UNTIL + 30 :])


def test_mirrored_images_are_the_reason_of_the_status():
    states = run_of(1, mirrored, seconds=UNTIL // FPS)
    stated = [s for s in states[FROM:UNTIL] if "mirrored (left to right)" in s.reason]
    assert {s.status for s in stated} == {PoseStatus.INCONSISTENT}
    assert not any(s.T_map_base for s in stated)
    named = [event.message for s in states for event in s.events if event.code == "images_mirrored"]
    assert 1 <= len(named) <= 2
    assert all(text.startswith("camera ") for text in named)


@pytest.mark.slow
@pytest.mark.parametrize("share", [1, 3, 6])
def test_a_map_of_another_place_publishes_nothing_wrong(share):
    def moved(landmarks: LandmarkMap) -> LandmarkMap:
        rng = np.random.default_rng(3)
        changed = []
        for k, m in enumerate(landmarks):
            T = m.T_map_landmark
            t = T.t + (rng.uniform(-1.5, 1.5, 3) if k < share else 0.0)
            changed.append(replace(m, T_map_landmark=Pose(T.to_frame, T.from_frame, T.R, t)))
        return LandmarkMap(changed)

    for seed in (1, 2):
        assert off_m(run_of(seed, lambda _, group: group, moved)) < WRONG_M


def test_every_fault_of_the_documentation_has_its_test():
    page = Path(__file__).parents[2] / "docs" / "live.md"
    if not page.exists():
        pytest.skip("the documentation is not installed")
    table = page.read_text(encoding="utf-8").split("\n## Faults\n")[1].split("\n## ")[0]
    named = re.findall(r"\| `(\w+)` \|$", table, re.MULTILINE)
    sources = "".join(path.read_text(encoding="utf-8") for path in Path(__file__).parent.glob("test_*.py"))
    assert len(named) >= 20
    assert [name for name in named if f"def {name}(" not in sources] == []


class FullDisk:
    """An output whose disk is full, then has room again."""

    tries = 0

    def __init__(self) -> None:
        FullDisk.tries += 1

    def send(self, state: LiveState) -> bool:
        if FullDisk.tries < 3:
            raise OutputLost(OSError(errno.ENOSPC, "No space left on device").strerror)
        return True

    def close(self) -> None: ...


def test_a_full_disk_is_named_and_holds_nothing_up(monkeypatch):
    monkeypatch.setattr("lmkit.live.outputs.base.FIRST_WAIT_S", 0.02)
    FullDisk.tries = 0
    runner = OutputRunner("record drive.mcap", FullDisk, time.time, keeps_all=True)
    codes, texts = [], []
    end = time.monotonic() + 10
    number = 0
    while time.monotonic() < end and "output_back" not in codes:
        start = time.monotonic()
        runner.put(LiveState(number, 0.0, PoseStatus.LOST, None, None, ()))
        assert time.monotonic() - start < 5
        number += 1
        events = runner.events()
        codes += [event.code for event in events]
        texts += [event.message for event in events]
        time.sleep(0.005)
    runner.close()
    assert "output_lost" in codes
    assert "No space left" in texts[0]


def test_a_recording_that_cannot_be_written_is_named(tmp_path):
    pytest.importorskip("mcap")
    from lmkit.live.outputs.recorder import Recorder
    from lmkit.live.ros.address import parse_ros
    from lmkit.live.ros.messages import StepMessages

    messages = StepMessages(parse_ros(""), LandmarkMap([]))
    with pytest.raises(OutputLost, match="No such file"):
        Recorder(tmp_path / "none" / "drive.mcap", {}, {}, messages, ["left"])


def test_a_camera_whose_image_stands_still_is_named_and_not_used(monkeypatch):
    monkeypatch.setattr("lmkit.live.reader.FROZEN_S", 0.2)
    noise = np.random.default_rng(1)
    still = noise.integers(0, 255, (48, 64, 3), dtype=np.uint8)
    shown: list[np.ndarray] = [still]

    class Camera:
        def read(self):
            time.sleep(0.01)
            return time.time(), (shown[0].copy(),)

        def close(self) -> None: ...

    news = threading.Condition()
    reader = Reader("camera:0", Camera, time.time, news)
    codes: list[str] = []
    end = time.monotonic() + 20
    while time.monotonic() < end and "camera_frozen" not in codes:
        with news:
            reader.take()
            codes += [event.code for event in reader.events()]
        time.sleep(0.01)
    with news:
        reader.take()
    time.sleep(0.1)
    with news:
        assert reader.peek() is None
    assert not reader.health().good
    shown[0] = 255 - still
    while time.monotonic() < end and "camera_back" not in codes:
        with news:
            codes += [event.code for event in reader.events()]
        time.sleep(0.01)
    reader.close()
    assert codes == ["camera_frozen", "camera_back"]


def test_a_detection_is_what_the_faults_change():
    """The changes above reach the loop; otherwise these tests would test nothing."""
    simulated = SimulatedRun(parse_source("sim:?seconds=2&speed=max&images=no&seed=1&fps=5"))
    group = next(g for g in simulated.groups() if any(g.seen))
    assert isinstance(next(d for seen in group.seen for d in seen), Detection)
    for fault in (dark, mirrored, blurred_corners, carried_off, false_readings):
        before = [[*d.corners.tolist(), str(d.id)] for seen in group.seen for d in seen]
        after = [[*d.corners.tolist(), str(d.id)] for seen in fault(simulated, group).seen for d in seen]
        assert before != after
