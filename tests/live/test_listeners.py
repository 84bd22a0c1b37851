"""Listeners of the live loop: the newest step wins, and JSON holds no image."""

from __future__ import annotations

import json
import threading

import numpy as np

from lmkit.geometry.pose import Pose
from lmkit.live.listeners import Mailbox
from lmkit.live.state import CameraView, LiveState
from lmkit.model.pose_status import PoseStatus


def state(number: int) -> LiveState:
    view = CameraView("left", np.zeros((4, 4, 3), np.uint8), 1.0)
    return LiveState(number, 1.0, PoseStatus.OK, Pose.identity("map", "base"), np.eye(6), (view,))


def test_the_newest_step_wins():
    mailbox = Mailbox()
    for number in range(3):
        mailbox(state(number))
    taken = mailbox.take(0.1)
    assert taken is not None
    assert taken.number == 2
    assert mailbox.dropped == 2
    assert mailbox.take(0.01) is None


def test_a_waiting_reader_wakes_up():
    mailbox = Mailbox()
    threading.Timer(0.05, mailbox, [state(7)]).start()
    taken = mailbox.take(5.0)
    assert taken is not None
    assert taken.number == 7


def test_a_step_is_json_without_images():
    values = json.loads(json.dumps(state(1).to_dict(), allow_nan=False))
    assert values["status"] == "ok"
    assert len(values["covariance"]) == 6
    assert "image" not in json.dumps(values)
