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

    def of_observations(self, camera: IntArray, R: FloatArray, t: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(S,3,3), (S,3) from the rig into the cameras ``camera`` (S,), from R and t by the rig file."""
        R, t = R.copy(), t.copy()
        for k in range(1, len(self.t)):
            rows, turn = np.flatnonzero(camera == k), self.turn[k]
            # One product of flat matrices: many small ones take ten times as long.
            R[rows] = (R[rows].transpose(0, 2, 1).reshape(-1, 3) @ turn.T).reshape(-1, 3, 3).transpose(0, 2, 1)
            t[rows] = self.t[k] + (t[rows] - self.stated_t[k]) @ turn.T
        return R, t

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


def add_relation(
    equations: ChainEquations, seen: ChainEquations, R_camera_map: FloatArray, columns: slice, landmarks: int
) -> None:
    """Add what one camera's observations say of its relation.

    A camera that has moved in the rig sees what it would see had the rig moved the other way; so the sums for the
    rig's poses say all that there is to say about the camera.

    Args:
        equations: of all, to which is added.
        seen: with the sums of this camera's observations alone: diagonal, gradient and border.
        R_camera_map: (N,3,3) from the map into the camera, at every rig pose.
        columns: of the shared unknowns: those of the camera.
        landmarks: the first shared unknown of the landmarks.
    """
    M = np.zeros((len(R_camera_map), SIZE, SIZE))
    M[:, :3, :3] = M[:, 3:, 3:] = -R_camera_map.transpose(0, 2, 1)
    Mt = M.transpose(0, 2, 1)
    by_pose = seen.diagonal @ M
    equations.border[:, :, columns] += by_pose
    equations.corner[columns, columns] += (Mt @ by_pose).sum(axis=0)
    equations.shared_gradient[columns] += (Mt @ seen.gradient[..., None]).sum(axis=0)[:, 0]
    across = (M.reshape(-1, SIZE).T @ seen.border.reshape(-1, seen.border.shape[2]))[:, landmarks:]
    equations.corner[columns, landmarks:] += across
    equations.corner[landmarks:, columns] += across.T
