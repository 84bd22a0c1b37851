"""The program that wrote a map, recognized by its keys."""

from __future__ import annotations

import re

from lmkit.io.document_head import DocumentHead

LMKIT, WPILIB, TAGSLAM, LIMELIGHT = "lmkit", "WPILib", "TagSLAM", "Limelight"
APRILTAG_ROS, MARKER_MAPPER, FIDUCIAL_SLAM = "apriltag_ros", "marker_mapper", "fiducial_slam"
MAP_PROGRAMS = (LMKIT, WPILIB, LIMELIGHT, TAGSLAM, APRILTAG_ROS, FIDUCIAL_SLAM, MARKER_MAPPER)
_KEYS = {
    "bodies": TAGSLAM, "fiducials": LIMELIGHT, "tag_bundles": APRILTAG_ROS, "standalone_tags": APRILTAG_ROS,
    "aruco_bc_markers": MARKER_MAPPER, "tags": WPILIB, "field-tags": WPILIB,
}  # fmt: skip
FIDUCIAL = re.compile(r"^\s*\d+(?:\s+[-+]?[\d.]+(?:[eE][-+]?\d+)?){7}(?:\s+\d+)+\s*$")  # a line of fiducial_slam


def program_of_map(text: str, head: DocumentHead) -> str:
    """One of `MAP_PROGRAMS`, or an empty text for other files."""
    if head.format:
        return LMKIT if head.format.startswith("lmkit-map") else ""
    first_line = next((line for line in text.splitlines() if line.strip()), "")
    if FIDUCIAL.match(first_line):
        return FIDUCIAL_SLAM
    program = next((program for key, program in _KEYS.items() if key in head.keys), "")
    return program if program != WPILIB or text.lstrip().startswith("{") else ""  # WPILib writes JSON alone
