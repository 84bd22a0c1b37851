"""A prior that the images contradict is left out, with a warning."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from math import degrees

import numpy as np

from lmkit.geometry.pose import Pose
from lmkit.localization.absolute_pose import LocateOptions
from lmkit.localization.pose_prior import PosePrior
from lmkit.model.estimate import PoseEstimate
from lmkit.model.pose_status import PoseStatus

CONTRADICTED = 4.5  # standard deviations of the prior
OPENING = "the prior contradicts the images and is left out"


def without_contradicted_prior(
    options: LocateOptions, locate: Callable[[LocateOptions], PoseEstimate]
) -> PoseEstimate:
    """The estimate of ``locate``; without the prior, and with a warning, where the images contradict the prior.

    Args:
        locate: the estimate of one frame with given options.
    """
    estimate = locate(options)
    prior = options.prior
    if prior is None or estimate.status == PoseStatus.NO_LANDMARKS:
        return estimate
    if estimate.T_map_camera is not None and not list(_misses(prior, estimate.T_map_camera)):
        return estimate
    free = locate(replace(options, prior=None))
    if free.T_map_camera is None or not (misses := list(_misses(prior, free.T_map_camera))):
        return estimate
    warning = f"{OPENING}: {', '.join(misses)}; check the prior (--heading, --planar)"
    return replace(free, warnings=(*free.warnings, warning))


def _misses(prior: PosePrior, T_map_camera: Pose) -> Iterator[str]:
    """Parts of the prior that a pose contradicts, in words."""

    def is_missed(part: PosePrior) -> bool:
        residuals = part.residuals(T_map_camera.R[None], T_map_camera.t[None])
        return bool(np.abs(residuals).max(initial=0.0) > CONTRADICTED)

    axis = T_map_camera.R[:, 2]
    if prior.heading_rad is not None and is_missed(replace(prior, height_m=None, down=None)):
        yield f"heading {degrees(np.arctan2(axis[1], axis[0])):.1f}, not {degrees(prior.heading_rad):.1f} deg"
    if prior.height_m is not None and is_missed(replace(prior, heading_rad=None, down=None)):
        yield f"camera height {T_map_camera.t[2]:.3f}, not {prior.height_m:.3f} m"
    if prior.down is not None and is_missed(replace(prior, heading_rad=None, height_m=None)):
        down = np.array(prior.down) / np.linalg.norm(prior.down)
        off = np.arccos(np.clip(-(T_map_camera.R @ down)[2], -1.0, 1.0))
        yield f"the floor leans by {degrees(off):.1f} deg"
