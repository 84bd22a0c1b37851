"""How much larger or smaller a camera shows landmarks than they are: two numbers that a recording finds for itself.

Exposure, sharpening, tone curves and prints of the wrong size move the edges of all faces alike, by 0.03 to 0.1 px to
the inside or the outside.  That does not average out over images: a face of 25 px that seems 0.1 px smaller seems
0.4 % farther away, in all images of all landmarks.  Corners stand outside their places by one way along the width of
the face and by another along its height, in all images alike.  The baseline, the odometry and the faces' different
distances tell of both.
"""

from __future__ import annotations

import numpy as np

from lmkit.arrays import FloatArray, IntArray
from lmkit.kernels.landmark_bundle import Bundle, derivatives
from lmkit.optim.block_chain import ChainEquations

SIZE = 2  # unknowns: px along the width and along the height
SIGMA_PX = 0.06  # simulated cameras of five kinds: 0.01 to 0.09 px


def outward(bundle: Bundle) -> FloatArray:
    """(S,8,2) how the rays of corners change if they stand 1 px farther out along the face's width and height."""
    a, b, c, d = (bundle.by_ray[..., i, j] for i in (0, 1) for j in (0, 1))
    x, y = bundle.rays[..., 0], bundle.rays[..., 1]
    pixels = np.stack([a * x + b * y, c * x + d * y], axis=-1)
    determinant = a * d - b * c
    shifts = np.empty((len(x), 4, 2, SIZE))
    # Corners start at the top left and run with the clock.
    for k, signs in enumerate(((-1, 1, 1, -1), (-1, -1, 1, 1))):
        way = np.tensordot(np.array(signs, dtype=float), pixels, axes=(0, 1))
        u, v = (way / np.sqrt((way**2).sum(axis=1, keepdims=True))).T[:, :, None] * np.array(signs, dtype=float)
        shifts[..., 0, k] = (d * u - b * v) / determinant
        shifts[..., 1, k] = (a * v - c * u) / determinant
    # A face without width or height has no outside.
    return np.nan_to_num(shifts.reshape(-1, 8, SIZE), posinf=0.0, neginf=0.0)


def without_swelling(bundle: Bundle, swelling: FloatArray) -> FloatArray:
    """(S,4,2) the observed rays, put back by a swelling (2,) in px."""
    return np.asarray(bundle.rays - (outward(bundle) @ swelling).reshape(-1, 4, 2))


def hold_swelling(e: ChainEquations, first: int) -> None:
    """Let equations leave the swelling as it stands, which are the shared unknowns from ``first`` on."""
    rows = np.arange(first, first + SIZE)
    e.corner[rows, rows] += SIGMA_PX**-2


def add_swelling(
    e: ChainEquations,
    bundle: Bundle,
    weights: FloatArray,
    camera: IntArray,
    swelling: FloatArray,
    columns: tuple[int, int],
) -> None:
    """Add what observations say of the swelling, to equations that hold it.

    Args:
        bundle: without the swelling, as it stands.
        weights: (S,) of the observations.
        camera: (S,) which camera of the rig saw each.
        swelling: (2,) px.
        columns: of the shared unknowns, the first of the cameras' relations and of the swelling; landmarks follow it.
    """
    cameras, first = columns
    errors, by_pose, by_landmark = derivatives(bundle)
    # Those that do not count may be beyond all measure.
    G = np.where((weights > 0)[:, None, None], bundle.whitener @ outward(bundle), 0.0)
    weighed = G.transpose(0, 2, 1) * weights[:, None, None]
    by_ray = weighed @ bundle.whitener
    rows, landmarks = slice(first, first + SIZE), slice(first + SIZE, None)
    pulls = (by_ray @ by_pose).transpose(0, 2, 1)
    np.add.at(e.border[:, :, rows], bundle.at, pulls)
    others = np.zeros((len(e.corner), SIZE))
    if len(others) > landmarks.start:
        on_landmarks = others[landmarks].reshape(-1, 6, SIZE)
        np.add.at(on_landmarks, bundle.of, (by_ray @ by_landmark).transpose(0, 2, 1))
    # A camera that has moved in the rig sees what it would see had the rig moved the other way.
    turned = (bundle.R_camera[bundle.mount] @ bundle.R[bundle.at].transpose(0, 2, 1))[:, None]
    on_cameras = -(turned @ pulls.reshape(-1, 2, 3, SIZE)).reshape(-1, 6, SIZE)
    for number in range((first - cameras) // 6):
        others[cameras + 6 * number :][:6] = on_cameras[camera == number + 1].sum(axis=0)
    e.corner[:, rows] += others
    e.corner[rows] += others.T
    e.corner[rows, rows] += (weighed @ G).sum(axis=0)
    e.shared_gradient[rows] += (by_ray @ errors[..., None]).sum(axis=0)[:, 0] - swelling / SIGMA_PX**2
