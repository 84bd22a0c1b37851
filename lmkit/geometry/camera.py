"""A calibrated camera: intrinsics and lens distortion, in OpenCV's terms.

Pixel (0, 0) is the center of the top-left pixel; the camera looks along z, x right, y down.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lmkit.arrays import BoolArray, FloatArray, frozen
from lmkit.errors import InputError
from lmkit.geometry.lens_models import LENS_MODELS, LensModel

REACHED_PX = 0.5  # largest reprojection error of a ray


@dataclass(frozen=True, eq=False)
class CameraModel:
    """Intrinsics of one camera.

    Attributes:
        image_size: (width, height), pixels.
        K: (3,3) camera matrix, pixels.
        distortion: coefficients in OpenCV's order, their number as in ``LENS_MODELS``.
        model: ``pinhole`` (k1 k2 p1 p2 k3), ``rational`` (adds k4 k5 k6 ...) or ``fisheye``
            (equidistant, k1 k2 k3 k4).

    Raises:
        ValueError: an unknown model, a wrong number of coefficients, or a K that is no camera matrix.

    Examples:
        >>> import lmkit
        >>> lmkit.CameraModel((640, 480), [[460, 0, 320], [0, 460, 240], [0, 0, 1]], [-0.21, 0.05, 0, 0, 0])
        CameraModel(pinhole, 640 x 480, f 460.0 460.0 px, center 320.0 240.0 px)
    """

    image_size: tuple[int, int]
    K: FloatArray
    distortion: FloatArray
    model: str = "pinhole"

    def __post_init__(self) -> None:
        if not isinstance(self.model, str) or self.model not in LENS_MODELS:
            raise ValueError(f"unknown camera model {self.model!r}; known: {', '.join(LENS_MODELS)}")
        distortion = frozen(np.ravel(self.distortion), (-1,), "distortion")
        counts = self.lens.counts
        if len(distortion) not in counts:
            raise ValueError(
                f"{len(distortion)} distortion coefficients for a {self.model} camera, "
                f"expected {' or '.join(map(str, counts))}"
            )
        K = frozen(self.K, (3, 3), "K")
        if K[0, 0] <= 0 or K[1, 1] <= 0 or not np.array_equal(K[2], [0, 0, 1]) or K[1, 0] != 0:
            raise ValueError("K is not a camera matrix [[fx, s, cx], [0, fy, cy], [0, 0, 1]] with fx, fy > 0")
        object.__setattr__(self, "image_size", _whole_size(self.image_size))
        object.__setattr__(self, "K", K)
        object.__setattr__(self, "distortion", distortion)

    def __repr__(self) -> str:
        (width, height), K = self.image_size, self.K
        return (
            f"CameraModel({self.model}, {width} x {height}, f {K[0, 0]:.1f} {K[1, 1]:.1f} px, "
            f"center {K[0, 2]:.1f} {K[1, 2]:.1f} px)"
        )

    @property
    def lens(self) -> LensModel:
        """The lens model, with its formulas."""
        return LENS_MODELS[self.model]

    def project(self, points: FloatArray) -> FloatArray:
        """(N,3) points in the camera frame, meters -> (N,2) pixels.

        The same function as ``cv2.projectPoints`` at the identity pose; points behind the camera
        give values without meaning.

        Raises:
            ValueError: the points have another shape.
        """
        xyz = _rows(points, 3, "points")
        if len(xyz) == 0:
            return np.zeros((0, 2))
        return np.asarray(self.lens.project(xyz, self.K, self.distortion), dtype=np.float64).reshape(-1, 2)

    def project_with_jacobian(self, points: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Pixels (N,2), their derivatives with the point (N,2,3), and with the intrinsics (N,2,4+D).

        Points are (N,3) in the camera frame; the intrinsics are fx fy cx cy, then the distortion.

        Raises:
            ValueError: the points have another shape.
        """
        xyz = _rows(points, 3, "points")
        return self.lens.differentiate(xyz, self.K, self.distortion)

    def unproject(self, pixels: FloatArray) -> FloatArray:
        """(N,2) pixels -> (N,2) normalized coordinates x/z, y/z of the rays, without distortion.

        Raises:
            ValueError: the pixels have another shape.
        """
        uv = _rows(pixels, 2, "pixels")
        if len(uv) == 0:
            return np.zeros((0, 2))
        return np.asarray(self.lens.unproject(uv, self.K, self.distortion), dtype=np.float64).reshape(-1, 2)

    def unproject_grid(self, x: FloatArray, y: FloatArray, step_px: float = 4.0) -> FloatArray:
        """(H,W,2) rays as of :meth:`unproject` of all pixels with rising x (W,) and y (H,).

        Only every ``step_px``-th goes through the lens; a cubic between them errs by some 1e-6 px.
        """
        (nodes_x, across), (nodes_y, down) = _cubic_weights(x, step_px), _cubic_weights(y, step_px)
        at = np.stack(np.meshgrid(nodes_x, nodes_y), axis=-1).reshape(-1, 2)
        rays = self.unproject(at).reshape(len(nodes_y), len(nodes_x), 2)
        return np.stack([down @ rays[:, :, k] @ across.T for k in range(2)], axis=2)

    def reaches(self, pixels: FloatArray) -> BoolArray:
        """(N,) True where :meth:`unproject` is valid: a distortion fitted to the center may fold back outside."""
        rays = self.unproject(pixels)
        finite = np.asarray(np.isfinite(rays).all(axis=1))
        back = self.project(np.column_stack([np.where(finite[:, None], rays, 0.0), np.ones(len(rays))]))
        return np.asarray(finite & (np.linalg.norm(back - pixels, axis=1) < REACHED_PX))

    def is_ahead(self, pixels: FloatArray) -> BoolArray:
        """(N,) False where a wide fisheye lens looks 90 deg or more off its axis, or shows the dark around its image.

        Such pixels have no ray in front of the camera.
        """
        if not self.lens.is_equidistant:
            return np.ones(len(pixels), dtype=bool)
        turned = np.linspace(0.0, np.pi / 2, 91)
        along = self.project(np.column_stack([np.sin(turned), np.zeros(91), np.cos(turned)]))[:, 0]
        radii = (along - self.K[0, 2]) / self.K[0, 0]
        edge = min(radii[-1], np.pi / 2) if (np.diff(radii) > 0).all() else np.pi / 2
        return np.asarray(np.linalg.norm((pixels - self.K[:2, 2]) / np.diag(self.K)[:2], axis=1) < edge)

    def require_size(self, name: str, size: tuple[int, int]) -> None:
        """Refuse an image of another size than the calibration.

        Raises:
            InputError: the (width, height) differs; the message names both sizes.
        """
        if size != self.image_size:
            raise InputError(
                "sizes_differ",
                f"{name} is {size[0]} x {size[1]} pixels, the rig's camera "
                f"{self.image_size[0]} x {self.image_size[1]}",
                "give images of the calibrated size",
            )

    def contains(self, pixels: FloatArray, border_px: float = 0.0) -> BoolArray:
        """(N,) True where a pixel lies inside the image, at least ``border_px`` from its edge."""
        w, h = self.image_size
        inside = (pixels > border_px - 0.5) & (pixels < np.array([w, h]) - 0.5 - border_px)
        return np.asarray(inside.all(axis=-1))


def _rows(values: FloatArray, width: int, what: str) -> FloatArray:
    """(N,1,width) float64, as the lens models take them.

    Raises:
        ValueError: not numbers in rows of that width.
    """
    try:
        return np.ascontiguousarray(values, dtype=np.float64).reshape(-1, 1, width)
    except (TypeError, ValueError):
        raise ValueError(f"{what} must have shape (N,{width}), not {np.shape(values)}") from None


def _whole_size(size: tuple[int, int]) -> tuple[int, int]:
    """Width and height in whole pixels.

    Raises:
        ValueError: not two whole numbers above 0.
    """
    try:
        width, height = (int(side) for side in size)
    except (TypeError, ValueError, OverflowError):
        width, height = 0, 0
    if min(width, height) < 1 or (width, height) != tuple(size):
        raise ValueError(f"image_size {size!r} is not (width, height) in whole pixels, such as (640, 480)")
    return width, height


def _cubic_weights(at: FloatArray, step: float) -> tuple[FloatArray, FloatArray]:
    """Evenly spaced nodes (N,) around rising places (P,), and (P,N) weights of the cubic through the nearest four."""
    start = at[0] - step
    share = (at - at[0]) / step
    first = np.floor(share).astype(np.int64)
    t = share - first
    lagrange = np.column_stack(
        [
            -t * (t - 1) * (t - 2) / 6,
            (t + 1) * (t - 1) * (t - 2) / 2,
            -(t + 1) * t * (t - 2) / 2,
            (t + 1) * t * (t - 1) / 6,
        ]
    )
    weights = np.zeros((len(at), int(first[-1]) + 4))
    weights[np.arange(len(at))[:, None], first[:, None] + np.arange(4)] = lagrange
    return start + step * np.arange(weights.shape[1]), weights
