"""Many frames at once have the poses that `locate_rig` gives each of them."""

from dataclasses import replace

import numpy as np
import pytest

from lmkit.geometry.pose import Pose
from lmkit.geometry.rig import MountedCamera, Rig, mounted_cameras
from lmkit.localization.absolute_pose import LocateOptions, locate_rig, possible_poses
from lmkit.localization.many_frames import locate_frames
from lmkit.mapping.recorded_observations import RecordedObservations
from lmkit.model.pose_status import PoseStatus
from lmkit.simulation.recording import T_BASE_LEFT, make_drive
from lmkit.simulation.scene import make_rig

OPTIONS = LocateOptions(far_m=0.25, far_rad=np.deg2rad(8.0))


def located(frames, rig, landmarks):
    """Poses of all frames at once."""
    recorded = RecordedObservations(frames, rig)
    corners_map = {m.id: m.corners_map for m in landmarks}
    rows = recorded.rows_in(range(len(frames)), corners_map)
    starts = np.searchsorted(recorded.arrays.at[rows], np.arange(len(frames) + 1))
    of, camera = recorded.arrays.of[rows], recorded.arrays.camera[rows]
    return locate_frames(recorded.corners(rows, corners_map), starts, of, camera, recorded.side_px[rows], OPTIONS)


def misread(frames, rng, share):
    """Frames with wrong codes."""
    ids = [o.id for frame in frames for o in frame.detections]

    def wrong(o):
        return replace(o, id=ids[rng.integers(len(ids))]) if rng.random() < share else o

    return [replace(frame, seen=tuple(tuple(map(wrong, some)) for some in frame.seen)) for frame in frames]


@pytest.mark.parametrize("share", [0.0, 0.2])
def test_poses_of_many_frames_are_those_of_each_frame(share):
    drive = make_drive(5, seconds=40, hz=2, count=10)
    frames = misread(drive.frames, np.random.default_rng(1), share)
    found = located(frames, drive.rig, drive.landmarks)
    statuses = set()
    for k, frame in enumerate(frames):
        alone = locate_rig(frame.seen, drive.rig, drive.landmarks, OPTIONS)
        statuses.add(alone.status)
        assert found.is_sure[k] == (alone.status == PoseStatus.OK)
        if found.is_sure[k]:
            assert np.allclose(found.pose(k).t, alone.T_map_camera.t, atol=1e-9)
            assert np.allclose(found.pose(k).R, alone.T_map_camera.R, atol=1e-9)
        if found.explains_all[k]:
            each = possible_poses(frame.seen, drive.rig, drive.landmarks)
            assert len(found.possible(k)) == len(each)
            assert np.allclose(found.possible(k).t, np.array([pose.t for pose in each]).reshape(-1, 3), atol=1e-9)
    assert len(statuses) >= 2 + (share > 0)


def test_frames_with_one_wrong_camera_of_three_are_to_be_located_again():
    """The third camera's codes are wrong: all at once give no pose, and one by one the other two cameras do."""
    pair = make_rig()
    third = MountedCamera("third", pair.left, Pose("camera", "left", np.eye(3), np.array([0.1, 0.0, 0.0])))
    rig = Rig((*mounted_cameras(pair), third), T_BASE_LEFT)
    drive = make_drive(5, seconds=30, hz=2, count=14, rig=rig)
    ids = [m.id for m in drive.landmarks]
    next_id = dict(zip(ids, [*ids[1:], ids[0]], strict=True))
    frames = [
        replace(frame, seen=(*frame.seen[:2], tuple(replace(o, id=next_id[o.id]) for o in frame.seen[2])))
        for frame in drive.frames
    ]
    found = located(frames, rig, drive.landmarks)
    alone = np.array([locate_rig(f.seen, rig, drive.landmarks, OPTIONS).status == PoseStatus.OK for f in frames])
    assert (alone & ~found.is_sure).any()
    assert found.needs_retry[alone & ~found.is_sure].all()
    assert not (found.is_sure & ~alone).any()


def test_an_image_with_a_code_twice_does_not_tell_which_is_mapped():
    drive = make_drive(5, seconds=20, hz=2, count=14)
    first = next(frame for frame in drive.frames if len(frame.seen[0]) > 1)
    twice = replace(first.seen[0][1], id=first.seen[0][0].id)
    frames = [replace(first, seen=((first.seen[0][0], twice, *first.seen[0][2:]), first.seen[1]))]
    recorded = RecordedObservations(frames, drive.rig)
    rows = recorded.rows_of(0, twice.id)
    assert [recorded.arrays.camera[k] for k in rows] == [1] * sum(o.id == twice.id for o in first.seen[1])
    assert recorded.shown[0, recorded.numbers([twice.id])].all()
