"""Text of the camera poses on a robot."""

from __future__ import annotations

import numpy as np

from lmkit.mapping.base_mounting import BaseMounting, CameraOnBase
from lmkit.odometry.wheel_odometry import PARAMETERS


def mounting_lines(found: BaseMounting) -> list[str]:
    """Two lines for each camera, its undetermined components, and a summary."""
    lines = []
    for camera in found.cameras:
        lines += _camera_lines(camera)
    tilt = np.rad2deg(float(np.hypot(*found.floor[:2])))
    odometry = ", ".join(
        f"{name} {value:.3f}" for name, value in zip(PARAMETERS, found.parameters.tolist(), strict=True)
    )
    lines.append(f"floor tilted by {tilt:.2f} deg in the map; {found.rms_px:.2f} px, {found.outliers} outliers")
    return [*lines, f"odometry: {odometry}"]


def _camera_lines(camera: CameraOnBase) -> list[str]:
    x, y, z = camera.T_base_camera.t
    forward = camera.T_base_camera.R[:, 2]
    yaw, down = np.rad2deg([np.arctan2(forward[1], forward[0]), -np.arcsin(np.clip(forward[2], -1, 1))])
    sigma = np.sqrt(np.diag(camera.covariance))
    mm, deg = 1000 * sigma[:3], np.rad2deg(sigma[3:])
    lines = [
        f"{camera.name}: x {x:z.4f} y {y:z.4f} z {z:z.4f} m, "
        f"looks {yaw:z.2f} deg to the left and {down:z.2f} deg down",
        f"  +- {mm[0]:.1f} {mm[1]:.1f} {mm[2]:.1f} mm, {deg[0]:.2f} {deg[1]:.2f} {deg[2]:.2f} deg about x y z; "
        f"{camera.frames} frames",
    ]
    clock = camera.clock
    if clock is not None and clock.differs:
        late = f"exposes {1000 * clock.offset_s:z.2f} ± {1000 * clock.sigma_s:.2f} ms after its stamps"
        lines.append(f"  {late}, in contrast to the rig file")
    elif clock is not None:
        lines.append(f"  clock as in the rig file, to ± {1000 * clock.sigma_s:.2f} ms")
    return [*lines, *(f"  not shown by this recording: {text}" for text in camera.unobserved)]
