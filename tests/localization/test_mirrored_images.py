"""Mirrored images give other codes; a map shows this, and the images are refused by name."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from simulated import shoot

from lmkit.api.recordings import survey, track
from lmkit.detection.config import DetectOptions
from lmkit.detection.detector import detect_landmarks
from lmkit.errors import InputError
from lmkit.localization.absolute_pose import locate_rig
from lmkit.localization.contradiction import with_cause
from lmkit.localization.mirror import find_mirror, mirrored_id
from lmkit.model.landmark import LM8, LM8P
from lmkit.model.landmark_map import LandmarkMap
from lmkit.model.pose_status import PoseStatus
from lmkit.model.recording import Recording, RigFrame
from lmkit.model.square_marker import SQUARE_FAMILIES
from lmkit.simulation.recording import make_drive

AXES = {"left to right": 0, "upside down": 1}


@pytest.fixture(scope="module")
def drive():
    return make_drive(1, seconds=8)


def mirrored(frames, size, way):
    """Detections as mirrored images give them; the corners by the test of images below."""
    axis = AXES[way]

    def flip(d):
        corners = d.corners[[1, 0, 3, 2]].copy()
        corners[:, axis] = size[axis] - 1 - corners[:, axis]
        return replace(d, id=mirrored_id(d.id), corners=corners, covariance=None)

    return tuple(RigFrame(f.time_s, tuple(tuple(map(flip, seen)) for seen in f.seen)) for f in frames)


@pytest.mark.parametrize("family", [LM8, LM8P], ids=lambda f: f.name)
@pytest.mark.parametrize("way", AXES)
def test_an_image_that_is_mirrored_reads_as_the_mirrored_code(way, family):
    code = next(c for c in range(40, 150) if family.mirrored_code(c) not in (None, c))
    image, corners = shoot(code, 60, 5, family=family)
    (found,) = detect_landmarks(cv2.flip(image, 1 - AXES[way]), DetectOptions((family,)))
    assert found.code == family.mirrored_code(code)
    assert found.confidence > 0.99
    expected = corners[[1, 0, 3, 2]]
    expected[:, AXES[way]] = image.shape[1 - AXES[way]] - 1 - expected[:, AXES[way]]
    assert np.abs(found.corners - expected).max() < 0.5


def test_most_codes_of_lm8_read_as_another_when_mirrored():
    assert sum(LM8.mirrored_code(c) == c for c in range(256)) == 32
    assert all(LM8P.mirrored_code(c) is not None for c in range(LM8P.code_count))


@pytest.mark.parametrize(("name", "nearest", "codes"), [("tag36h11", 4, 0), ("aruco4x4_250", 0, 14)])
def test_cells_of_mirrored_square_markers(name, nearest, codes):
    """Least number of cells by which a mirrored marker differs from any code, and markers that are another code."""
    family = SQUARE_FAMILIES[name]
    white = 2 * family.white.astype(int) - 1
    turns = [np.rot90(white[:, :, ::-1], k, axes=(1, 2)).reshape(len(white), -1) for k in range(4)]
    alike = np.max([turn @ white.reshape(len(white), -1).T for turn in turns], axis=(0, 2))
    differing = (family.bits**2 - alike) // 2
    assert (differing.min(), (differing == 0).sum()) == (nearest, codes)


@pytest.mark.parametrize("way", AXES)
def test_mirrored_recordings_are_refused_by_name(drive, way):
    frames = mirrored(drive.frames, drive.rig.left.image_size, way)
    recording = Recording(frames, odometry=drive.odometry)
    for work in (
        lambda: track(recording, drive.rig, drive.landmarks),
        lambda: survey(recording, drive.rig, known=drive.landmarks),
    ):
        with pytest.raises(InputError, match=rf"mirrored \({way}\)") as raised:
            work()
        assert raised.value.code == "mirrored_images"


@pytest.mark.parametrize("way", AXES)
def test_mirrored_frames_give_no_pose_and_are_named(drive, way):
    rig = drive.rig
    frames = mirrored(drive.frames[::5], drive.rig.left.image_size, way)
    found = [
        with_cause(locate_rig(f.seen, rig, drive.landmarks), f.seen, rig, drive.landmarks)
        for f in frames
        if len({d.id for d in f.detections}) > 2
    ]
    assert len(found) > 4
    assert {e.status for e in found} == {PoseStatus.INCONSISTENT}
    assert all("mirrored" in e.warnings[0] for e in found)


@pytest.mark.parametrize("seed", range(3))
def test_honest_recordings_are_not_mirrored(seed):
    """Images are not called mirrored if the map also contains the mirrored codes and few of the true ones."""
    drive = make_drive(seed, seconds=8)
    mapped = list(drive.landmarks)
    others = {mirrored_id(m.id): m for m in mapped}
    both = [*mapped, *(replace(m, id=id_) for id_, m in others.items() if id_ not in drive.landmarks)]
    few = [*mapped[:2], *both[len(mapped) :]]
    for landmarks in (mapped, both, few):
        assert find_mirror(drive.frames, drive.rig, LandmarkMap(landmarks)) is None
