"""A recording of laser scans through a map of poles.

Poles are identified scan by scan, with the filter's prediction as the rough pose; without a prediction, by their
distances alone.  The identified poles are then used as readings of range and bearing.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lmkit.detection.scan_poles import find_poles
from lmkit.errors import NegativeAnswer
from lmkit.localization.pole_association import PosePriorPlanar, associate_poles
from lmkit.localization.range_bearing_noise import SCAN_NOISE
from lmkit.model.landmark_map import LandmarkMap
from lmkit.model.observation import RangeBearing
from lmkit.model.recording import Gyro, Odometry
from lmkit.model.scan import LaserScan, ScannedPole
from lmkit.model.tracked_trajectory import TrackedTrajectory
from lmkit.odometry.wheel_odometry import MotionModel
from lmkit.pipelines.locate_scans import ScanSettings, require_poles
from lmkit.tracking.batch import track_readings
from lmkit.tracking.online import READING_NUMBERS, run_live, tracked_planar
from lmkit.tracking.range_bearing_filter import PlanarFilter, TrackedPose

LEAST_SIGMA = np.array([0.03, 0.03, 0.01])  # of a prediction: motion between scans, and errors of the filter
LOST_M = 1.0
UNEXPLAINED = 5  # consecutive scans without a pole at its predicted place, before the prediction is given up


def track_scans(
    scans: Sequence[LaserScan],
    odometry: Odometry,
    gyro: Gyro | None,
    landmarks: LandmarkMap,
    settings: ScanSettings | None = None,
    live: bool = False,
) -> TrackedTrajectory:
    """The robot's trajectory.

    Args:
        settings: scanner, and rough pose at the first scan.
        live: each pose uses only data up to its time.

    Raises:
        InputError: the map has no poles, or odometry of another time.
        NegativeAnswer: no scan determines the pose of the robot.
    """
    identified = _Identified(scans, landmarks, settings or ScanSettings(), MotionModel(odometry, gyro))
    times = [scan.end_s for scan in scans]
    answers = run_live(times, identified.observe, identified.filter.wheels, odometry, gyro)
    if not answers:
        raise NegativeAnswer(
            "not_located", f"none of {len(scans)} scans determines the pose of the robot",
            "give its rough pose at the first scan (--near), or check the poles' diameters in the map",
        )  # fmt: skip
    if live:
        return tracked_planar(answers, identified.filter.parameters, READING_NUMBERS)
    return track_readings(identified.readings, odometry, gyro, landmarks, SCAN_NOISE)


class _Identified:
    """Identification along the recording; the readings of every scan remain."""

    def __init__(
        self, scans: Sequence[LaserScan], landmarks: LandmarkMap, settings: ScanSettings, motion: MotionModel
    ) -> None:
        self._motion = motion
        self.filter = PlanarFilter(landmarks, SCAN_NOISE)
        self.readings: list[tuple[float, list[RangeBearing]]] = []
        self._scans, self._map, self._settings = scans, landmarks, settings
        self._radii = require_poles(landmarks)
        self._rough = settings.rough
        self._unexplained = 0

    def observe(self, k: int) -> TrackedPose:
        """Pose at the end of scan ``k``."""
        scan, s = self._scans[k], self._settings
        rough = self._prediction(scan.end_s)
        poles = self._carried(scan, [pole.seen_from_base(s.mount) for pole in find_poles(scan, self._radii, s.noise)])
        found = associate_poles(poles, self._map, rough, scan, s.mount)
        self._unexplained = 0 if found.readings else self._unexplained + (found.scanned > 1)
        self.readings.append((scan.end_s, list(found.readings)))
        return self.filter.observe(scan.end_s, found.readings)

    def _carried(self, scan: LaserScan, poles: list[ScannedPole]) -> list[ScannedPole]:
        """Poles as seen at the end of the scan, corrected for the robot's motion while the scanner rotates."""
        if scan.beam_s == 0:
            return poles
        carried = []
        for pole in poles:
            times = np.array([pole.time_s, scan.end_s])
            carried.append(pole.carried(self._motion.increments(times, self.filter.parameters).motions[0]))
        return carried

    def _prediction(self, time_s: float) -> PosePriorPlanar | None:
        predicted = self.filter.predicted(time_s)
        if predicted is None:
            return self._rough
        state, covariance = predicted
        if self._unexplained >= UNEXPLAINED or np.sqrt(np.linalg.eigvalsh(covariance[:2, :2])[-1]) > LOST_M:
            return None
        return PosePriorPlanar(state, 4 * covariance + np.diag(LEAST_SIGMA**2))
