"""Videos of several cameras: which frames belong together."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from lmkit.errors import InputWarning
from lmkit.io import video_groups
from lmkit.io.image_groups import frame_groups
from lmkit.io.image_sources import Frame, video_frames

SIZE = (64, 48)


@pytest.fixture
def film(tmp_path):
    """Writes a video whose frames show their own time by their brightness (5 levels in 0.1 s), and names the file."""

    def write(name: str, rate: float, count: int, size: tuple[int, int] = SIZE) -> str:
        writer = cv2.VideoWriter(str(tmp_path / name), cv2.VideoWriter.fourcc(*"MJPG"), rate, size)
        for k in range(count):
            writer.write(np.full((size[1], size[0], 3), round(50 * k / rate) % 250, dtype=np.uint8))
        writer.release()
        return str(tmp_path / name)

    return write


def shown_s(frame) -> float:
    return float(np.median(frame.pixels)) / 50


def test_videos_of_unequal_rates_are_joined_by_their_times(film):
    with pytest.warns(InputWarning, match=r"different rates .*fast.avi 20, slow.avi 8\).*at most 62 ms apart"):
        groups = list(frame_groups([film("fast.avi", 20, 60), film("slow.avi", 8, 24, (96, 64))]))
    assert len(groups) == 24
    off = [shown_s(fast) - shown_s(slow) for fast, slow in groups]
    assert np.abs(off).max() <= 0.025 + 0.02  # half a step of the faster one, and the brightness's rounding
    assert [frame.time_s for _, frame in groups] == pytest.approx(np.arange(24) / 8)
    assert len({fast.name for fast, _ in groups}) == 24


def test_videos_of_one_rate_and_length_go_in_step(film):
    groups = list(frame_groups([film("a.avi", 10, 200), film("b.avi", 10.05, 200)]))
    assert [[frame.name.rpartition("#")[2] for frame in group] for group in groups] == [
        [str(k)] * 2 for k in range(200)
    ]


def test_frames_beside_a_gap_have_no_partner(monkeypatch):
    times = {"a.avi": [0.0, 0.1, 0.4, 0.8, 0.9], "b.avi": [0.0, 0.1, 0.5, 0.8, 0.9, 1.0]}
    black = np.zeros((4, 4, 3), dtype=np.uint8)
    monkeypatch.setattr(
        video_groups, "video_frames", lambda name: iter([Frame(name, black, None, time_s) for time_s in times[name]])
    )
    monkeypatch.setattr(video_groups, "_timing", lambda name: video_groups._Timing(10.0, len(times[name])))
    joined = [(a.time_s, b.time_s) for a, b in frame_groups(["a.avi", "b.avi"])]
    assert joined == [(time_s, time_s) for time_s in (0.0, 0.1, 0.8, 0.9)]


def test_three_videos_lose_the_end_of_the_longest_and_the_frames_that_one_lacks(film):
    sources = [film("a.avi", 10, 30), film("b.avi", 10, 25), film("c.avi", 5, 15)]
    with pytest.warns(InputWarning, match="different rates"):
        groups = list(frame_groups(sources))
    numbers = [tuple(int(frame.name.rpartition("#")[2]) for frame in group) for group in groups]
    assert numbers == [(2 * k, 2 * k, k) for k in range(13)]


@pytest.mark.parametrize(
    ("kind", "hint"), [("empty", "the file is empty"), ("cut", "its index"), ("text", "give MP4, AVI")]
)
def test_what_is_wrong_with_a_video_is_said(tmp_path, kind, hint):
    """A file of MP4 that was cut off lacks the index, which is written last."""
    path = tmp_path / "a.mp4"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), 10, SIZE)
    for k in range(10):
        writer.write(np.full((SIZE[1], SIZE[0], 3), 20 * k, dtype=np.uint8))
    writer.release()
    whole = path.read_bytes()
    path.write_bytes({"empty": b"", "cut": whole[: whole.index(b"moov") - 4], "text": b"no video"}[kind])
    (frame,) = video_frames(str(path))
    assert frame.error is not None
    assert hint in frame.error.hint
