"""Plausibility checks of a rig; every reader of rigs calls them (:func:`lmkit.io.any_rig.read_any_rig`)."""

from __future__ import annotations

import numpy as np

from lmkit.errors import InputError
from lmkit.geometry.camera import CameraModel
from lmkit.geometry.rig import AnyRig, Rig, mounted_cameras

LARGEST_SIDE_PX = 65535  # of an image
LARGEST_FOCAL_PX, LARGEST_COEFFICIENT = 1e6, 1e6  # of a lens; rational ones reach hundreds
LONGEST_BASELINE_M = 10.0
SHORTEST_BASELINE_M = 1e-3
OPTICAL_RAD = 0.35
LARGEST_BASE_M = 10.0
UPRIGHT, ASIDE = 0.8, 0.5  # downward parts of an image's y axis
OFF_CENTER = 0.3  # of the image's width or height, between principal point and center
NEAR_CENTER = 0.05  # likewise, of an image whose width and height are swapped
USUAL_BASELINE_M, PARALLEL_DEG = 2.0, 30.0  # of a stereo pair
LARGE_TANGENTIAL = 0.02  # p1 and p2 of lenses are below 0.01; k3 and k4 of fisheye lenses often are not


def require_plausible(rig: AnyRig, where: str) -> None:
    """Refuse lengths that no rig has, and image sizes and lenses that no camera has.

    Args:
        where: the file, named in errors.

    Raises:
        InputError: ``implausible_`` and what it is of: ``image_size``, ``lens``, ``baseline`` or ``base``.
    """
    for mounted in mounted_cameras(rig):
        width, height = mounted.model.image_size
        if max(width, height) > LARGEST_SIDE_PX:
            raise InputError(
                "implausible_image_size",
                f"{where}: images of camera {mounted.name} are {width} x {height} pixels",
                "write the image size in pixels",
            )
        focal_px = float(np.abs(mounted.model.K).max())
        coefficient = float(np.abs(mounted.model.distortion).max(initial=0.0))
        if focal_px > LARGEST_FOCAL_PX or coefficient > LARGEST_COEFFICIENT:
            raise InputError(
                "implausible_lens",
                f"{where}: the lens of camera {mounted.name} has an entry of K of {focal_px:g} px and a distortion "
                f"coefficient of {coefficient:g}",
                "write K in pixels, and the distortion in OpenCV's order",
            )
    base = rig.T_base_left
    if base is not None and not (distance_m := float(np.linalg.norm(base.t))) < LARGEST_BASE_M:
        raise InputError(
            "implausible_base",
            f"{where}: the camera is {distance_m:g} m from the robot's base (T_base_left): are these millimeters?",
            "write lengths in meters",
        )
    if isinstance(rig, Rig):
        for camera in rig.cameras:
            distance_m = float(np.linalg.norm(camera.T_camera_left.t))
            if distance_m > LONGEST_BASELINE_M:
                raise InputError(
                    "implausible_baseline",
                    f"{where}: camera {camera.name} is {distance_m:g} m from the first one: are these millimeters?",
                    "write lengths in meters",
                )
        return
    baseline_m = rig.baseline_m
    if baseline_m > LONGEST_BASELINE_M:
        raise InputError(
            "implausible_baseline",
            f"{where}: a baseline of {baseline_m:g} m: are these millimeters ({baseline_m:g} mm)?",
            "write lengths in meters; calibrations with boards in millimeters give millimeters",
        )
    if baseline_m < SHORTEST_BASELINE_M:
        raise InputError(
            "implausible_baseline",
            f"{where}: a baseline of {baseline_m:g} m: the cameras are at the same place",
            "give the file of a stereo pair, with lengths in meters",
        )


def rig_warnings(rig: AnyRig, where: str) -> tuple[str, ...]:
    """Warnings about values that are possible, but unusual."""
    base = (*_lens_warnings(rig, where), *base_warnings(rig, where))
    if isinstance(rig, Rig):
        return base
    x, y, z = (-rig.T_right_left.R.T @ rig.T_right_left.t).tolist()
    if x < 0 and abs(x) > max(abs(y), abs(z)):
        return (
            *base,
            f"{where}: the right camera is {-x:.3g} m to the left of the left one: "
            "are the cameras swapped, or is the sign of T or P[0][3] wrong?",
        )
    angle_deg = float(np.rad2deg(np.linalg.norm(rig.T_right_left.rvec)))
    if angle_deg > 90:
        return (
            *base,
            f"{where}: the cameras look {angle_deg:.0f} deg apart: is R the inverse, or of other axes?",
        )
    if rig.baseline_m > USUAL_BASELINE_M and angle_deg < PARALLEL_DEG:
        return (*base, f"{where}: a baseline of {rig.baseline_m:.4g} m: are these centimeters or inches? Give meters")
    return base


def _lens_warnings(rig: AnyRig, where: str) -> tuple[str, ...]:
    """Sentences about principal points far from the center: of K for another image size."""
    texts = []
    for camera in mounted_cameras(rig):
        (width, height), K = camera.model.image_size, camera.model.K
        off = abs(K[0, 2] / width - 0.5), abs(K[1, 2] / height - 0.5)
        swapped = abs(K[0, 2] / height - 0.5), abs(K[1, 2] / width - 0.5)
        if min(off) > max(swapped) and max(swapped) < NEAR_CENTER:
            texts.append(
                f"{where}: the principal point of camera {camera.name} is the center of images of {height} x "
                f"{width}, not of {width} x {height}: are width and height swapped?"
            )
        elif max(off) > OFF_CENTER or min(off) > OFF_CENTER / 2:
            texts.append(
                f"{where}: the principal point of camera {camera.name} is ({K[0, 2]:.0f}, {K[1, 2]:.0f}) in "
                f"images of {width} x {height}: is its K of another image size?"
            )
        if _resembles_fisheye(camera.model):
            texts.append(
                f"{where}: tangential coefficients of camera {camera.name} up to "
                f"{np.abs(camera.model.distortion[2:]).max():.2g} are more than lenses have: are the four those of a "
                "fisheye lens (k1 k2 k3 k4)? Then state model: fisheye, or distortion_model: equidistant"
            )
    return tuple(texts)


def _resembles_fisheye(camera: CameraModel) -> bool:
    D = camera.distortion
    return camera.model == "pinhole" and len(D) == 4 and float(np.abs(D[2:]).max()) > LARGE_TANGENTIAL


def base_warnings(rig: AnyRig, where: str) -> tuple[str, ...]:
    """A sentence where T_base_left is given with the axes of an optical frame (z forward, y down), or inverted."""
    if rig.T_base_left is None:
        return ()
    R = rig.T_base_left.R
    if np.linalg.norm(rig.T_base_left.rvec) <= OPTICAL_RAD:
        return (
            f"{where}: T_base_left does not rotate, so the camera looks straight up: are the base's axes those of an "
            "optical frame (z forward, y down)? The base has x forward, y left, z up",
        )
    # The image's y axis points down, in an upright camera, or up, in one that is upside down.
    if abs(R[2, 1]) < ASIDE and R[1, 2] < -UPRIGHT:
        return (
            f"{where}: by T_base_left the camera lies on its side, and its inverse is upright: is it the pose of the "
            "base in the camera? It takes points of the left camera to the base",
        )
    return ()
