"""Relative poses of a rig's cameras, as unknowns of a bundle adjustment.

A rig file has errors: with a baseline of 12 cm, 0.03 deg of yaw move a landmark at 4 m by 7 cm, in every frame alike.
Landmarks seen by two cameras determine the relative pose far better, so it is estimated with all other unknowns; the
rig file is the prior.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lmkit.arrays import FloatArray, IntArray
from lmkit.geometry.rig import AnyRig, mounted_cameras
from lmkit.geometry.rotations import rotation_exp, rotation_log
from lmkit.optim.block_chain import ChainEquations

# Of a camera relative to the first one, if the rig file has no covariance: typical of calibrations.
SIGMA_M, SIGMA_RAD = 0.0005, np.deg2rad(0.05)
EXACT = 1e-12  # m^2, rad^2
SIZE = 6  # unknowns of one camera: a shift in its own frame, m, and a turn about its own axes, rad


@dataclass(frozen=True, eq=False)
class CameraRelations:
    """Corrections of every camera's pose relative to the rig file.

    Attributes:
        stated_t: (C,3) of T_camera_left in the rig file.
        information: (C,6,6) of shift and rotation relative to it; not used for the first camera.
        turn: (C,3,3) rotation of the camera about its own axes; identity for the first one.
        t: (C,3) current translation of T_camera_left.
    """

    stated_t: FloatArray
    information: FloatArray
    turn: FloatArray
    t: FloatArray

    @classmethod
    def of_rig(cls, rig: AnyRig) -> CameraRelations:
        """The relative poses of the rig file."""
        cameras = mounted_cameras(rig)
        t = np.array([camera.T_camera_left.t for camera in cameras])
        usual = np.diag([SIGMA_M**2] * 3 + [SIGMA_RAD**2] * 3)
        covariances = np.array([usual if c.covariance is None else c.covariance for c in cameras])
        information = np.linalg.inv(covariances + EXACT * np.eye(SIZE))
        return cls(t, information, np.repeat(np.eye(3)[None], len(cameras), axis=0), t)

    @property
    def unknowns(self) -> int:
        """Number of unknowns: six for every camera but the first."""
        return SIZE * (len(self.t) - 1)

    def moved(self, step: FloatArray) -> CameraRelations:
        """Cameras moved by a step of the unknowns."""
        steps = np.concatenate([np.zeros((1, SIZE)), step.reshape(-1, SIZE)])
        return CameraRelations(
            self.stated_t, self.information, rotation_exp(steps[:, 3:]) @ self.turn, self.t + steps[:, :3]
        )

    def of_mounted(self, camera: IntArray, R: FloatArray, t: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(K,3,3), (K,3) from the rig into mounted cameras, from R and t by the rig file.

        Args:
            camera: (K,) which camera each is.
        """
        turn = self.turn[camera]
        moved = self.t[camera] + (turn @ (t - self.stated_t[camera])[..., None])[..., 0]
        return turn @ R, np.where(camera[:, None] > 0, moved, t)

    def add_prior(self, equations: ChainEquations, first: int) -> float:
        """Add the prior of the rig file to the shared unknowns from ``first`` on; its cost."""
        cost = 0.0
        for k in range(1, len(self.t)):
            rows = slice(first + SIZE * (k - 1), first + SIZE * k)
            off = np.concatenate([self.stated_t[k] - self.t[k], rotation_log(self.turn[k].T)])
            equations.corner[rows, rows] += self.information[k]
            equations.shared_gradient[rows] += self.information[k] @ off
            cost += float(off @ self.information[k] @ off)
        return cost
