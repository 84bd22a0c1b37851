"""lmkit: printed landmarks for robots, from print to pose.

>>> import lmkit
>>> estimate = lmkit.locate("left.png", "right.png", rig="rig.yaml", landmarks="map.yaml")
>>> estimate
PoseEstimate(ok, ...)
"""

from __future__ import annotations

from typing import TYPE_CHECKING as _TYPE_CHECKING

from lmkit.version import __version__

if _TYPE_CHECKING:
    from lmkit.api.arguments import ImageWarning as ImageWarning
    from lmkit.api.cameras import calibrate as calibrate
    from lmkit.api.cameras import calibrate_base as calibrate_base
    from lmkit.api.cameras import calibrate_clocks as calibrate_clocks
    from lmkit.api.cameras import locate as locate
    from lmkit.api.detecting import Detector as Detector
    from lmkit.api.detecting import detect as detect
    from lmkit.api.detecting import draw as draw
    from lmkit.api.planning import place_landmarks as place_landmarks
    from lmkit.api.planning import plan_route as plan_route
    from lmkit.api.planning import print_landmarks as print_landmarks
    from lmkit.api.reading import read_image as read_image
    from lmkit.api.reading import read_map as read_map
    from lmkit.api.reading import read_recording as read_recording
    from lmkit.api.reading import read_rig as read_rig
    from lmkit.api.reading import read_trajectory as read_trajectory
    from lmkit.api.reading import write_map as write_map
    from lmkit.api.reading import write_rig as write_rig
    from lmkit.api.reading import write_trajectory as write_trajectory
    from lmkit.api.recordings import evaluate as evaluate
    from lmkit.api.recordings import survey as survey
    from lmkit.api.recordings import survey_recordings as survey_recordings
    from lmkit.api.recordings import track as track
    from lmkit.calibration.mono import CameraCalibration as CameraCalibration
    from lmkit.calibration.stereo import StereoCalibration as StereoCalibration
    from lmkit.demos.example_files import write_example_files as write_example_files
    from lmkit.detection.config import DetectorConfig as DetectorConfig
    from lmkit.errors import InputError as InputError
    from lmkit.errors import LmkitError as LmkitError
    from lmkit.errors import NegativeAnswer as NegativeAnswer
    from lmkit.geometry.camera import CameraModel as CameraModel
    from lmkit.geometry.pose import Pose as Pose
    from lmkit.geometry.pose_array import PoseArray as PoseArray
    from lmkit.geometry.rig import MountedCamera as MountedCamera
    from lmkit.geometry.rig import Rig as Rig
    from lmkit.geometry.stereo_rig import StereoRig as StereoRig
    from lmkit.mapping.base_mounting import BaseMounting as BaseMounting
    from lmkit.mapping.joint_survey import JointSurvey as JointSurvey
    from lmkit.mapping.survey_results import Survey as Survey
    from lmkit.model.board import BoardSpec as BoardSpec
    from lmkit.model.detections import Detections as Detections
    from lmkit.model.estimate import PoseEstimate as PoseEstimate
    from lmkit.model.landmark import LM8 as LM8
    from lmkit.model.landmark import LandmarkFamily as LandmarkFamily
    from lmkit.model.landmark_id import LandmarkId as LandmarkId
    from lmkit.model.landmark_map import LandmarkMap as LandmarkMap
    from lmkit.model.landmark_map import MappedLandmark as MappedLandmark
    from lmkit.model.observation import Detection as Detection
    from lmkit.model.pose_status import PoseStatus as PoseStatus
    from lmkit.model.recording import Recording as Recording
    from lmkit.model.tracked_trajectory import TrackedTrajectory as TrackedTrajectory
    from lmkit.model.trajectory import Trajectory as Trajectory
    from lmkit.planning.coverage import Demand as Demand

# Module of every public name.  Loaded on first use, so that `import lmkit` and `lmkit --help` stay instant.
_HOMES = {
    "read_image": "api.reading",
    "read_rig": "api.reading",
    "read_map": "api.reading",
    "read_recording": "api.reading",
    "read_trajectory": "api.reading",
    "write_rig": "api.reading",
    "write_map": "api.reading",
    "write_trajectory": "api.reading",
    "detect": "api.detecting",
    "Detector": "api.detecting",
    "draw": "api.detecting",
    "calibrate": "api.cameras",
    "calibrate_base": "api.cameras",
    "calibrate_clocks": "api.cameras",
    "locate": "api.cameras",
    "survey": "api.recordings",
    "survey_recordings": "api.recordings",
    "track": "api.recordings",
    "evaluate": "api.recordings",
    "print_landmarks": "api.planning",
    "place_landmarks": "api.planning",
    "plan_route": "api.planning",
    "write_example_files": "demos.example_files",
    "ImageWarning": "api.arguments",
    "LmkitError": "errors",
    "InputError": "errors",
    "NegativeAnswer": "errors",
    "BaseMounting": "mapping.base_mounting",
    "BoardSpec": "model.board",
    "CameraCalibration": "calibration.mono",
    "CameraModel": "geometry.camera",
    "Demand": "planning.coverage",
    "Detection": "model.observation",
    "Detections": "model.detections",
    "DetectorConfig": "detection.config",
    "LM8": "model.landmark",
    "LandmarkFamily": "model.landmark",
    "LandmarkId": "model.landmark_id",
    "LandmarkMap": "model.landmark_map",
    "MappedLandmark": "model.landmark_map",
    "MountedCamera": "geometry.rig",
    "Pose": "geometry.pose",
    "PoseArray": "geometry.pose_array",
    "PoseEstimate": "model.estimate",
    "PoseStatus": "model.pose_status",
    "Recording": "model.recording",
    "Rig": "geometry.rig",
    "StereoCalibration": "calibration.stereo",
    "StereoRig": "geometry.stereo_rig",
    "JointSurvey": "mapping.joint_survey",
    "Survey": "mapping.survey_results",
    "TrackedTrajectory": "model.tracked_trajectory",
    "Trajectory": "model.trajectory",
}

__all__ = ["__version__", *_HOMES]


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module 'lmkit' has no attribute {name!r}")
    import importlib

    return getattr(importlib.import_module(f"lmkit.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return sorted(__all__)
