"""Decision whether a pose is published: a second landmark must confirm it, and landmarks must be recent."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from lmkit.live.estimators import Estimate, largest_sigma_m
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.pose_status import PoseStatus

SURPRISE = 5.0  # largest normalized innovation squared over its degrees of freedom; the mean is 1


@dataclass(frozen=True)
class PublicationRule:
    """Requirements of a published pose.

    Attributes:
        confirm: different landmarks that a new start must agree with.
        coast_s: longest time by odometry alone.
        most_sigma_m: largest standard deviation of the position.
    """

    confirm: int = 2
    coast_s: float = 1.0
    most_sigma_m: float = 0.15


@dataclass(frozen=True)
class Decision:
    """Status to publish, with its reason; a pose is published only with ``ok``."""

    status: PoseStatus
    reason: str


class Publication:
    """Decides step by step; see `PublicationRule`."""

    def __init__(self, rule: PublicationRule) -> None:
        self._rule = rule
        self._confirmed: set[LandmarkId] | None = None  # landmarks since the last start; None after confirmation
        self._last_s = float("-inf")  # last time at which a landmark agreed with the pose
        self.resets = 0

    def decide(
        self, time_s: float, estimate: Estimate, missing: Sequence[LandmarkId], doubt: str = "", waits: str = ""
    ) -> Decision:
        """Status of a step.

        Args:
            missing: landmarks that should be clearly visible with this pose, but were not read.
            doubt: reason why the images are old; empty if they are not.
            waits: reason why it is not known yet whether the images are old; empty if known.
        """
        if estimate.restarted:
            self._confirmed = set()
            self.resets += 1
        elif estimate.nis > SURPRISE * max(estimate.nis_dof, 1):
            # The pose was shifted far: toward a moved landmark, or away from it.
            self._confirmed = set()
        if estimate.inliers:
            self._last_s = time_s
            if self._confirmed is not None:
                self._confirmed |= set(estimate.inliers)
        if estimate.T_map_base is None or estimate.covariance is None:
            return Decision(estimate.status, _WHY.get(estimate.status, "not located yet"))
        if estimate.status != PoseStatus.OK:
            return Decision(estimate.status, _WHY[estimate.status])
        if doubt:
            return Decision(PoseStatus.INCONSISTENT, doubt)
        if estimate.outliers and len(estimate.outliers) >= len(estimate.inliers):
            return Decision(PoseStatus.INCONSISTENT, _WHY[PoseStatus.INCONSISTENT])
        if not estimate.inliers and missing:
            names = ", ".join(map(str, missing[:3]))
            return Decision(PoseStatus.LOST, f"{names} should be in view and {_are(missing)} not read")
        since = time_s - self._last_s
        if since > self._rule.coast_s:
            return Decision(PoseStatus.LOST, f"no landmark for {since:.1f} s")
        if waits:
            return Decision(PoseStatus.AMBIGUOUS, waits)
        if self._confirmed is not None:
            if len(self._confirmed) < self._rule.confirm:
                names = ", ".join(map(str, sorted(self._confirmed))) or "nothing"
                return Decision(
                    PoseStatus.AMBIGUOUS, f"located by {names} alone: waiting for {self._rule.confirm} landmarks"
                )
            self._confirmed = None
        sigma = largest_sigma_m(estimate.covariance)
        if sigma > self._rule.most_sigma_m:
            return Decision(PoseStatus.IMPRECISE, f"known to {sigma:.2f} m only")
        if estimate.inliers:
            return Decision(PoseStatus.OK, "")
        return Decision(PoseStatus.OK, f"by odometry for {since:.1f} s")


def _are(names: Sequence[LandmarkId]) -> str:
    return "is" if len(names) == 1 else "are"


_WHY = {
    PoseStatus.LOST: "not located yet",
    PoseStatus.NO_LANDMARKS: "no landmark of the map is in view",
    PoseStatus.AMBIGUOUS: "another pose explains the images as well",
    PoseStatus.IMPRECISE: "the landmarks in view leave the pose open",
    PoseStatus.INCONSISTENT: "the landmarks in view contradict the map or the pose",
    PoseStatus.SWAPPED: "left and right camera are swapped",
}
