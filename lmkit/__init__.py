"""lmkit: printed landmarks for robots, from print to pose.

Nouns live here, verbs in their folders: ``lmkit.generate``, ``lmkit.detect``,
``lmkit.calibrate``, ``lmkit.locate``, ``lmkit.simulate``.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

from lmkit.version import __version__

if TYPE_CHECKING:
    from lmkit.errors import InputError as InputError
    from lmkit.errors import LmkitError as LmkitError
    from lmkit.errors import NegativeAnswer as NegativeAnswer
    from lmkit.geometry.camera import CameraModel as CameraModel
    from lmkit.geometry.pose import Pose as Pose
    from lmkit.geometry.stereo_rig import StereoRig as StereoRig
    from lmkit.model.board import BoardSpec as BoardSpec
    from lmkit.model.estimate import PoseEstimate as PoseEstimate
    from lmkit.model.landmark import LM8 as LM8
    from lmkit.model.landmark import LandmarkFamily as LandmarkFamily
    from lmkit.model.landmark_map import LandmarkMap as LandmarkMap
    from lmkit.model.landmark_map import MappedLandmark as MappedLandmark
    from lmkit.model.observation import LandmarkObservation as LandmarkObservation

# Loaded on first use, so that `import lmkit` and `lmkit --help` stay instant.
_HOMES = {
    "InputError": "lmkit.errors",
    "LmkitError": "lmkit.errors",
    "NegativeAnswer": "lmkit.errors",
    "BoardSpec": "lmkit.model.board",
    "CameraModel": "lmkit.geometry.camera",
    "PoseEstimate": "lmkit.model.estimate",
    "LM8": "lmkit.model.landmark",
    "LandmarkFamily": "lmkit.model.landmark",
    "LandmarkMap": "lmkit.model.landmark_map",
    "MappedLandmark": "lmkit.model.landmark_map",
    "LandmarkObservation": "lmkit.model.observation",
    "Pose": "lmkit.geometry.pose",
    "StereoRig": "lmkit.geometry.stereo_rig",
}

__all__ = ["__version__", *_HOMES]


def __getattr__(name: str) -> object:
    if name in _HOMES:
        return getattr(importlib.import_module(_HOMES[name]), name)
    raise AttributeError(f"module 'lmkit' has no attribute {name!r}")
