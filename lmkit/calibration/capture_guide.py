"""Guidance while images are taken: which pair to keep, and which view to show next.

A pair is kept automatically when both cameras see the board sharp, still and in a
new view.  Capture ends when the views are sufficient for a calibration.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.calibration.initialization import CameraStarts, board_poses
from lmkit.calibration.view_coverage import ViewCoverage, coverage_of, filled_cells
from lmkit.errors import InputError
from lmkit.geometry.camera import CameraModel
from lmkit.model.observation import PairView

SHARP_RATIO = 2.5  # an image's corner noise over the median's of those kept
SHARP_ENOUGH_PX = 0.15
STILL_SHARE = 0.002  # of the image's width, between one frame and the next
# A view is new when it differs by one of these from every view kept.
NEW_PLACE = 0.15  # of the image's width
NEW_DISTANCE = 1.25  # ratio
NEW_TILT_DEG = 12.0
OWN_CAMERA_FROM = 6  # views, below which the focal length is uncertain


@dataclass(frozen=True)
class Judgment:
    """Decision about one pair of frames.

    Attributes:
        kept: whether it was taken.
        reason: ``kept``, ``no board``, ``blurred``, ``moving`` or ``not new``.
        words: the same as text for a person, with advice.
    """

    kept: bool
    reason: str
    words: str


_MOVING = Judgment(False, "moving", "hold still")


@dataclass(frozen=True)
class _Kept:
    view: PairView
    R: FloatArray
    t: FloatArray


class CaptureGuide:
    """Decides pair after pair; :attr:`views` are the pairs kept for calibration.

    Args:
        object_points: (N,3) of the board.
        image_size: (width, height) of the left camera.
        moving: frames follow each other, so that a board in motion can be recognized; False for single images.
        right_size: (width, height) of the right camera; None: that of the left one.
    """

    def __init__(
        self,
        object_points: FloatArray,
        image_size: tuple[int, int],
        moving: bool = True,
        right_size: tuple[int, int] | None = None,
    ) -> None:
        self._object_points = object_points
        self._sizes = image_size, right_size or image_size
        width, height = image_size
        # Until there are enough views: a usual lens, whose focal length is about the width.
        K = np.array([[width, 0, (width - 1) / 2], [0, width, (height - 1) / 2], [0, 0, 1.0]])
        self._camera = CameraModel(image_size, K, np.zeros(5))
        self._moving = moving
        self._before: PairView | None = None
        self._kept: list[_Kept] = []

    @property
    def views(self) -> tuple[PairView, ...]:
        """The pairs kept, in order."""
        return tuple(kept.view for kept in self._kept)

    @property
    def coverage(self) -> ViewCoverage:
        """Coverage of the views kept so far, with advice."""
        rotations = np.array([kept.R for kept in self._kept]).reshape(-1, 3, 3)
        translations = np.array([kept.t for kept in self._kept]).reshape(-1, 3)
        return coverage_of(self.views, rotations, translations, *self._sizes)

    def ghost(self, coverage: ViewCoverage) -> tuple[int, FloatArray] | None:
        """Camera (0 left, 1 right) and outline (4,2), pixels, of the next wanted board place; None: no place."""
        wanted = coverage.wanted
        return None if wanted is None else (wanted.side, wanted.outline(self._object_points, self._camera))

    def judge(self, view: PairView | None, before: Callable[[], PairView | None] | None = None) -> Judgment:
        """Decide about one pair of frames; None if a camera does not see the board.

        Args:
            before: finds the board in the previous frame; called if the view is sharp and new.  Default: the
                view of the last call.
        """
        last, self._before = self._before, view
        if view is None:
            return Judgment(False, "no board", "show the whole board to both cameras")
        if before is None and not self._is_still(last, view):
            return _MOVING
        if not self._sharp(view):
            return Judgment(False, "blurred", "blurred: hold still, more light, or focus")
        poses = board_poses(self._camera, self._object_points[view.ids_left], view.left)
        if not poses:
            return Judgment(False, "no board", "show the whole board to both cameras")
        R, t, _ = poses[0]
        if not self._is_new(view, R, t):
            return Judgment(False, "not new", "move the board on")
        if before is not None and not self._is_still(before(), view):
            return _MOVING
        self._kept.append(_Kept(view, R, t))
        if len(self._kept) >= OWN_CAMERA_FROM:
            self._learn_camera()
        return Judgment(True, "kept", f"kept {view.name}")

    def _is_still(self, before: PairView | None, view: PairView) -> bool:
        return not self._moving or (before is not None and self._motion(before, view) <= STILL_SHARE)

    def _motion(self, before: PairView, view: PairView) -> float:
        """Speed of the median corner in the faster camera, over the image's width."""
        steps = []
        for ids_a, a, ids_b, b, width in (
            (before.ids_left, before.left, view.ids_left, view.left, self._sizes[0][0]),
            (before.ids_right, before.right, view.ids_right, view.right, self._sizes[1][0]),
        ):
            if not len(ids_a) and not len(ids_b):
                continue  # a rig of one camera
            _, in_a, in_b = np.intersect1d(ids_a, ids_b, return_indices=True)
            step = np.linalg.norm(a[in_a] - b[in_b], axis=1)
            steps.append(float(np.median(step)) / width if len(step) else np.inf)
        return max(steps)

    def _sharp(self, view: PairView) -> bool:
        limits = [_noise(kept.view) for kept in self._kept]
        limit = max(SHARP_ENOUGH_PX, SHARP_RATIO * float(np.median(limits)) if limits else SHARP_ENOUGH_PX)
        return _noise(view) <= limit

    def _is_new(self, view: PairView, R: FloatArray, t: FloatArray) -> bool:
        width = self._camera.image_size[0]
        for kept in self._kept:
            moved = np.linalg.norm(kept.view.left.mean(axis=0) - view.left.mean(axis=0)) / width
            nearer = np.linalg.norm(t) / np.linalg.norm(kept.t)
            # Tilt alone: rotating a board in its own plane gives no new information on the lens.
            turned = np.rad2deg(np.arccos(np.clip(abs(R[:, 2] @ kept.R[:, 2]), 0, 1)))
            near = 1 / NEW_DISTANCE < nearer < NEW_DISTANCE
            if moved < NEW_PLACE and near and turned < NEW_TILT_DEG and not self._fills_a_cell(view):
                return False
        return True

    def _fills_a_cell(self, view: PairView) -> bool:
        seen = [
            filled_cells(np.concatenate([getattr(kept.view, side) for kept in self._kept]), size)
            for side, size in zip(("left", "right"), self._sizes, strict=True)
        ]
        new = [filled_cells(points, size) for points, size in zip((view.left, view.right), self._sizes, strict=True)]
        return any(bool((here & ~before).any()) for here, before in zip(new, seen, strict=True))

    def _learn_camera(self) -> None:
        """The left camera from the views so far, and the boards' poses with it."""
        seen = [(kept.view.ids_left, kept.view.left) for kept in self._kept]
        try:
            self._camera = CameraStarts(self._object_points, seen, self._camera.image_size).camera("pinhole")
        except InputError:
            return
        learnt = []
        for kept in self._kept:
            poses = board_poses(self._camera, self._object_points[kept.view.ids_left], kept.view.left)
            learnt.append(_Kept(kept.view, poses[0][0], poses[0][1]) if poses else kept)
        self._kept = learnt


def _noise(view: PairView) -> float:
    """Corner noise of the worse camera, px; 0 if it was not estimated."""
    return max(view.noise_left or 0.0, view.noise_right or 0.0)
