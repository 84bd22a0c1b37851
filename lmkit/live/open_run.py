"""A live run from its settings: sources, odometry, outputs, recording."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from lmkit.errors import InputError
from lmkit.geometry.rig import AnyRig, mounted_cameras
from lmkit.io.any_rig import read_any_rig
from lmkit.io.external_maps import read_any_map
from lmkit.io.image_groups import require_image_of_each
from lmkit.io.marker_maps import MarkerDefaults
from lmkit.live.captures import Capture
from lmkit.live.clock import LoopClock
from lmkit.live.frame_group import Feed
from lmkit.live.live_feed import LiveFeed
from lmkit.live.live_run import LiveRun
from lmkit.live.loop import LiveLoop
from lmkit.live.motion import MotionInbox
from lmkit.live.open_capture import open_capture
from lmkit.live.open_inputs import is_live_input, open_inputs
from lmkit.live.open_outputs import open_outputs, warn_of_camera_poses
from lmkit.live.recorded_feed import POSE_SUFFIXES, StepFeed, file_groups, motion_rows
from lmkit.live.recording_file import RunRecording
from lmkit.live.ros.address import parse_ros
from lmkit.live.ros.open_transport import choose_transport
from lmkit.live.run_settings import LOOP_KEYS, RunSettings
from lmkit.live.simulated_source import SimulatedCapture, SimulatedRun
from lmkit.model.families import family_named
from lmkit.model.landmark_map import LandmarkMap
from lmkit.units import parse_length_mm


def open_run(settings: RunSettings, dry: bool = False) -> LiveRun:
    """A run that is ready to start; threads of live sources and outputs have begun.

    Args:
        dry: open no outputs.

    Raises:
        InputError: settings that do not fit together, a file that cannot be read, or an extra that is missing.
    """
    clock = LoopClock()
    address = settings.sources[0]
    if address.kind == "sim":
        return _simulated_run(settings, clock, dry)
    if address.kind == "replay":
        return _replayed_run(settings, clock, dry)
    rig, landmarks = _rig(settings), _landmarks(settings)
    live = address.is_live
    inbox = MotionInbox()
    motion = _motion_kind(settings)
    loop = LiveLoop(rig, landmarks, settings.loop(motion), clock.now)
    feed: Feed
    if live:
        for a in settings.sources:
            if a.kind == "ros2":
                choose_transport(parse_ros(a.target))
        sources = [(a.text, partial(open_capture, a, clock), 2 if a.split else 1) for a in settings.sources]
        _require_cameras(rig, sum(count for *_, count in sources))
        inputs = open_inputs(settings.values, inbox, clock, motion)
        feed = LiveFeed(sources, inbox, clock.now, inputs)
    else:
        if is_live_input(settings.values.odometry) or is_live_input(settings.values.gyro):
            raise InputError(
                "live_odometry",
                "recorded images need odometry from a file",
                "give for example --odometry odometry.csv",
            )
        texts = [a.text for a in settings.sources]
        require_image_of_each([camera.name for camera in mounted_cameras(rig)], texts)
        rows = motion_rows(settings.path(settings.values.odometry), settings.path(settings.values.gyro))
        feed = StepFeed(" ".join(texts), file_groups(texts, settings.values.hz, rows))
    outputs = [] if dry else open_outputs(settings, rig, landmarks, clock, motion)
    return LiveRun(loop, feed, outputs, clock, settings.values.rate)


def check_files(settings: RunSettings) -> None:
    """Refuse an unsuitable rig or map before a run, with the run's warnings; no camera is opened.

    Raises:
        InputError: a file cannot be read, or the rig has another number of cameras.
    """
    if settings.sources[0].kind in ("sim", "replay"):
        return
    rig, _ = _rig(settings), _landmarks(settings)
    _require_cameras(rig, sum(2 if address.split else 1 for address in settings.sources))
    warn_of_camera_poses(settings.values.to, rig)


def _replayed_run(settings: RunSettings, clock: LoopClock, dry: bool) -> LiveRun:
    """The run of a recording: its settings, rig and map, unless a rig or a map is given."""
    address = settings.sources[0]
    recording = RunRecording(Path(address.target))
    kept = {k: v for k, v in recording.settings.items() if k in LOOP_KEYS}
    values = settings.values.model_copy(update=kept)
    with TemporaryDirectory() as folder:
        for name, data in recording.attached.items():
            (Path(folder) / Path(name).name).write_bytes(data)
        found = {path.stem: path for path in Path(folder).iterdir()}
        rig = read_any_rig(found["rig"]) if values.rig is None and "rig" in found else _rig(settings)
        landmarks = read_any_map(found["map"]) if values.map is None and "map" in found else _landmarks(settings)
    motion = str(recording.settings["motion"])
    loop = LiveLoop(rig, landmarks, RunSettings(values).loop(motion), clock.now)
    outputs = [] if dry else open_outputs(settings, rig, landmarks, clock, motion)
    return LiveRun(loop, StepFeed(address.text, recording.groups()), outputs, clock, settings.values.rate)


def _simulated_run(settings: RunSettings, clock: LoopClock, dry: bool) -> LiveRun:
    address = settings.sources[0]
    if settings.values.odometry or settings.values.gyro:
        raise InputError("not_together", "sim: has its own odometry and gyro", "leave --odometry and --gyro out")
    simulated = SimulatedRun(address)
    course = simulated.course
    rig = simulated.rig if settings.values.rig is None else _rig(settings)
    landmarks = course.landmarks if settings.values.map is None else _landmarks(settings)
    loop = LiveLoop(rig, landmarks, settings.loop("wheels"), clock.now)
    outputs = [] if dry else open_outputs(settings, rig, landmarks, clock, "wheels")
    if not address.is_live:
        return LiveRun(loop, StepFeed(address.text, simulated.groups()), outputs, clock, settings.values.rate)
    inbox, first = MotionInbox(), list[float]()
    # Textures, or all images, are rendered before the clock of the course starts.
    if simulated.before:
        simulated.render()
    course.images(course.T_map_base(0.0))
    opener: Callable[[], Capture] = partial(SimulatedCapture, simulated, inbox, clock, first)
    feed = LiveFeed([(address.text, opener, simulated.cameras)], inbox, clock.now)
    truth: Any = lambda t: course.T_map_base(t - simulated.shift_s)  # noqa: E731
    return LiveRun(loop, feed, outputs, clock, settings.values.rate, truth)


def _rig(settings: RunSettings) -> AnyRig:
    path = settings.path(settings.values.rig)
    if path is None:
        raise InputError("no_rig", "images need a rig", "give --rig rig.yaml, or rig: in the run file")
    return read_any_rig(path)


def _landmarks(settings: RunSettings) -> LandmarkMap:
    path = settings.path(settings.values.map)
    if path is None:
        raise InputError("no_map", "a run needs a map", "give --map map.yaml, or map: in the run file")
    family, size = settings.values.family, settings.values.size
    size_m = None if size is None else parse_length_mm(size, "--size") / 1000
    return read_any_map(path, MarkerDefaults(None if family is None else family_named(family).name, size_m))


def _motion_kind(settings: RunSettings) -> str:
    odometry = settings.values.odometry
    if odometry is None:
        if settings.values.gyro is not None:
            raise InputError("no_odometry", "a gyro needs wheel odometry", "add --odometry")
        return "none"
    poses = settings.values.odometry_kind == "poses" or Path(odometry).suffix.lower() in POSE_SUFFIXES
    return "pose" if poses else "wheels"


def _require_cameras(rig: AnyRig, count: int) -> None:
    names = [camera.name for camera in mounted_cameras(rig)]
    if count != len(names):
        raise InputError(
            "wrong_image_count",
            f"sources of {count} cameras for a rig of {len(names)} ({', '.join(names)})",
            "give one source per camera, in this order",
        )
