"""Planar poses of the robot from scans: detects and identifies poles, and solves for the pose, scan by scan."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

from lmkit.detection.scan_poles import ScanNoise, find_poles
from lmkit.errors import InputError
from lmkit.localization.pole_association import PoleAssociation, PosePriorPlanar, associate_poles, pole_radii
from lmkit.model.landmark_map import LandmarkMap
from lmkit.model.scan import LaserScan, ScannerMount


@dataclass(frozen=True)
class ScanSettings:
    """Properties of the scanner and its pose on the robot.

    Attributes:
        mount: pose of the scanner on the robot.
        noise: noise of its ranges.
        rough: pose of the robot at the first scan, if roughly known.
    """

    mount: ScannerMount = field(default_factory=ScannerMount)
    noise: ScanNoise = field(default_factory=ScanNoise)
    rough: PosePriorPlanar | None = None


def locate_in_scans(
    scans: Sequence[LaserScan], landmarks: LandmarkMap, settings: ScanSettings | None = None
) -> Iterator[PoleAssociation]:
    """Pose of the base for every scan separately; the rough pose, if any, is used for all scans.

    Raises:
        InputError: the map has no poles.
    """
    settings = settings or ScanSettings()
    radii = require_poles(landmarks)
    for scan in scans:
        poles = [pole.seen_from_base(settings.mount) for pole in find_poles(scan, radii, settings.noise)]
        yield associate_poles(poles, landmarks, settings.rough, scan, settings.mount)


def require_poles(landmarks: LandmarkMap) -> list[float]:
    """Radii of the map's poles.

    Raises:
        InputError: it has none.
    """
    radii = pole_radii(landmarks)
    if not radii:
        raise InputError(
            "no_poles", "the map has no poles", "write each with 'family: pole' and its diameter as size_m"
        )
    return radii
