"""How the cameras of a rig stand to each other, as unknowns of a bundle adjustment.

A rig file has errors: with a baseline of 12 cm, 0.03 deg of yaw move a landmark at 4 m by 7 cm, in every frame alike.
Landmarks seen by two cameras tell the relation far better than that, so it is estimated with everything else; the rig
file is prior knowledge.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lmkit.arrays import FloatArray, IntArray
from lmkit.geometry.rig import AnyRig, mounted_cameras
from lmkit.geometry.rotations import rotation_exp, rotation_log
from lmkit.optim.block_chain import ChainEquations

# Of a camera to the first one, where the rig file does not say: as calibrations leave it.
SIGMA_M, SIGMA_RAD = 0.0005, np.deg2rad(0.05)
EXACT = 1e-12  # m^2, rad^2
SIZE = 6  # unknowns of one camera: a shift in its own frame, m, and a turn about its own axes, rad


@dataclass(frozen=True, eq=False)
class CameraRelations:
    """Every camera of a rig against the rig file.

    Attributes:
        stated_t: (C,3) of T_camera_left in the rig file.
        information: (C,6,6) of the shift and the turn against it; of the first camera not used.
        turn: (C,3,3) by which the camera has turned about its own axes; the first one has not.
        t: (C,3) of T_camera_left as it is now.
    """

    stated_t: FloatArray
    information: FloatArray
    turn: FloatArray
    t: FloatArray

    @classmethod
    def of_rig(cls, rig: AnyRig) -> CameraRelations:
        """The relations as the rig file has them."""
        cameras = mounted_cameras(rig)
        t = np.array([camera.T_camera_left.t for camera in cameras])
        usual = np.diag([SIGMA_M**2] * 3 + [SIGMA_RAD**2] * 3)
        covariances = np.array([usual if c.covariance is None else c.covariance for c in cameras])
        information = np.linalg.inv(covariances + EXACT * np.eye(SIZE))
        return cls(t, information, np.repeat(np.eye(3)[None], len(cameras), axis=0), t)

    @property
    def unknowns(self) -> int:
        """Number of unknowns: of all cameras but the first."""
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
        """Add what the rig file says to shared unknowns from ``first`` on; its cost."""
        cost = 0.0
        for k in range(1, len(self.t)):
            rows = slice(first + SIZE * (k - 1), first + SIZE * k)
            off = np.concatenate([self.stated_t[k] - self.t[k], rotation_log(self.turn[k].T)])
            equations.corner[rows, rows] += self.information[k]
            equations.shared_gradient[rows] += self.information[k] @ off
            cost += float(off @ self.information[k] @ off)
        return cost
