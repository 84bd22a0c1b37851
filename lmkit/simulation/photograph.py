"""The imaging chain: lens, light, sensor and development between a rendered scene and its file.

In the order of a real camera: point spread, defocus and motion; the color and the unevenness of
the light; electrons and their noise; the color mosaic and its interpolation; white balance; the
tone curve; noise reduction; sharpening; JPEG.  Each step is controlled by one field, so that a test can select one
fault at a time.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np

from lmkit.arrays import ByteArray, Float32Array, FloatArray
from lmkit.errors import InputError
from lmkit.geometry.camera import CameraModel
from lmkit.geometry.pose import Pose
from lmkit.kernels.ray_panels import box_mean
from lmkit.model.palette import linear_to_srgb
from lmkit.simulation.mosaic import check_mosaic, demosaic, mosaic_of
from lmkit.simulation.render import OVERSAMPLE, render
from lmkit.simulation.scene import Scene

DAYLIGHT_K = 6500.0
TONES = ("srgb", "gamma", "rec709", "filmic", "linear")
CHROMAS = ("420", "444")
LUMA = np.array([0.299, 0.587, 0.114])


@dataclass(frozen=True)
class Lens:
    """The blur of lens and motion.

    Attributes:
        blur_px: standard deviation of the point spread.
        defocus_px: radius of the disc that a point out of focus becomes.
        motion_px: (x, y) displacement of the image during the exposure.
        corner_blur_px: standard deviation of the additional blur in the image's corners; it grows with the
            square of the distance from the middle.
        lateral_color: relative enlargement of the red image and reduction of the blue image, compared with green.
        color_shift_px: (x, y) shift from the green image to the red one, and from the blue one to the green one.
    """

    blur_px: float = 0.6
    defocus_px: float = 0.0
    motion_px: tuple[float, float] = (0.0, 0.0)
    corner_blur_px: float = 0.0
    lateral_color: float = 0.0
    color_shift_px: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True)
class Shadow:
    """A hard shadow: everything on one side of a straight line.

    Attributes:
        through_px: a point on its edge.
        towards_deg: direction into the shadow, from x (right) toward y (down).
        ratio: light outside over light inside the shadow.
    """

    through_px: tuple[float, float]
    towards_deg: float
    ratio: float


@dataclass(frozen=True)
class Gloss:
    """A soft reflection of a lamp on the print.

    Attributes:
        at_px: its middle.
        radius_px: radius at which it has fallen to 60 %.
        strength: added light at the center, share of full scale.
    """

    at_px: tuple[float, float]
    radius_px: float
    strength: float


@dataclass(frozen=True)
class Light:
    """The light.

    Attributes:
        brightness: light from a surface of reflectance 1, share of full scale.
        temperature_k: color temperature of the light (black body).
        gradient: (x, y) relative change from the middle of the image to its right and lower edge.
        shadow: a hard shadow, or None.
        gloss: reflection of a lamp, or None.
        veil: light that the lens spreads over the whole image, share of full scale.
    """

    brightness: float = 0.88
    temperature_k: float = DAYLIGHT_K
    gradient: tuple[float, float] = (0.0, 0.0)
    shadow: Shadow | None = None
    gloss: Gloss | None = None
    veil: float = 0.0


@dataclass(frozen=True)
class Sensor:
    """The image sensor.

    Attributes:
        full_well: electrons at full scale; fewer make more noise.
        read_noise: electrons.
        bayer: one color per pixel with interpolation, instead of three.
        pattern: order of these colors: ``RGGB``, ``BGGR``, ``GRBG`` or ``GBRG``.
        demosaic: ``bilinear``, ``malvar`` or ``edge_aware``.
    """

    full_well: float = 6000.0
    read_noise: float = 8.0
    bayer: bool = False
    pattern: str = "RGGB"
    demosaic: str = "bilinear"

    def __post_init__(self) -> None:
        check_mosaic(self.pattern, self.demosaic)


@dataclass(frozen=True)
class Development:
    """The development of raw values into an image file.

    Attributes:
        balanced_for_k: color temperature assumed by the white balance; None: the true one.
        tone: ``srgb``, ``gamma`` (2.2), ``rec709``, ``filmic`` (toe and shoulder) or ``linear``.
        saturation: factor of the distances from gray, in code values.
        contrast: exponent of a further S curve about middle gray in code values; 1 is none.
        denoise: 0 to 1, strength of the smoothing of color, and of brightness in nearly uniform areas.
        sharpen: amount of the unsharp mask.
        sharpen_px: standard deviation of its blur.
        jpeg_quality: 1 to 100, or None for a lossless file.
        chroma: ``420`` (color at half resolution) or ``444``.
    """

    balanced_for_k: float | None = None
    tone: str = "srgb"
    saturation: float = 1.0
    contrast: float = 1.0
    denoise: float = 0.0
    sharpen: float = 0.0
    sharpen_px: float = 1.0
    jpeg_quality: int | None = None
    chroma: str = "420"

    def __post_init__(self) -> None:
        for name, value, known in (("tone", self.tone, TONES), ("chroma", self.chroma, CHROMAS)):
            if value not in known:
                raise InputError("bad_imaging", f"{name} {value!r} is not known", f"known: {', '.join(known)}")


@dataclass(frozen=True)
class ImagingChain:
    """Everything between the scene and the file."""

    lens: Lens = field(default_factory=Lens)
    light: Light = field(default_factory=Light)
    sensor: Sensor = field(default_factory=Sensor)
    development: Development = field(default_factory=Development)


def photograph(
    scene: Scene, camera: CameraModel, T_map_camera: Pose, chain: ImagingChain, rng: np.random.Generator
) -> ByteArray:
    """One image of the scene: (H,W,3) BGR, 8 bit."""
    return expose(render(scene, camera, T_map_camera), chain, rng)


def expose(radiance: Float32Array, chain: ImagingChain, rng: np.random.Generator) -> ByteArray:
    """(H*S,W*S,3) linear RGB reflectance under white light, S = OVERSAMPLE -> (H,W,3) BGR, 8 bit."""
    received = light_up(focus(radiance, chain.lens), chain.light)
    return develop(count_electrons(received, chain.sensor, rng), chain.development, chain.light.temperature_k)


def focus(radiance: Float32Array, lens: Lens) -> Float32Array:
    """Oversampled light -> (H,W,3) after point spread, defocus, motion and the pixels' own area."""
    sigma = lens.blur_px * OVERSAMPLE
    if sigma > 0.05:
        radiance = np.asarray(cv2.GaussianBlur(radiance, (0, 0), sigma), dtype=np.float32)
    if lens.defocus_px * OVERSAMPLE > 0.5:
        disc = _disc_kernel(lens.defocus_px * OVERSAMPLE)
        radiance = np.asarray(cv2.filter2D(radiance, -1, disc), dtype=np.float32)
    way = np.array(lens.motion_px) * OVERSAMPLE
    if np.hypot(*way) > 0.5:
        radiance = np.asarray(cv2.filter2D(radiance, -1, _motion_kernel(way)), dtype=np.float32)
    image = box_mean(radiance, OVERSAMPLE)
    if lens.corner_blur_px > 0:
        image = _blurred_in_corners(image, lens.corner_blur_px)
    if lens.lateral_color == 0 and not any(lens.color_shift_px):
        return image
    return _with_displaced_colors(image, lens)


def light_up(image: Float32Array, light: Light) -> FloatArray:
    """(H,W,3) linear RGB under this light."""
    height, width = image.shape[:2]
    x = (np.arange(width) - (width - 1) / 2) / (width / 2)
    y = (np.arange(height) - (height - 1) / 2) / (height / 2)
    strength = np.maximum(1 + light.gradient[0] * x[None, :] + light.gradient[1] * y[:, None], 0.0)
    if light.shadow is not None:
        strength = strength * _shade(light.shadow, width, height)
    color = black_body_rgb(light.temperature_k)
    lit = image * strength[:, :, None] * (light.brightness * color) + light.veil
    if light.gloss is not None:
        offset = np.array(light.gloss.at_px)
        across = (np.arange(width) - offset[0])[None, :] ** 2 + (np.arange(height) - offset[1])[:, None] ** 2
        shine = light.gloss.strength * np.exp(-across / (2 * light.gloss.radius_px**2))
        lit = lit + shine[:, :, None] * color
    return np.asarray(lit)


def count_electrons(received: FloatArray, sensor: Sensor, rng: np.random.Generator) -> FloatArray:
    """(H,W,3) linear RGB as measured, clipped to 0..1."""
    if sensor.bayer:
        return demosaic(_measure(mosaic_of(received, sensor.pattern), sensor, rng), sensor.pattern, sensor.demosaic)
    return _measure(received, sensor, rng)


def develop(measured: FloatArray, development: Development, light_k: float = DAYLIGHT_K) -> ByteArray:
    """(H,W,3) linear RGB -> (H,W,3) BGR code values, 8 bit."""
    assumed_k = light_k if development.balanced_for_k is None else development.balanced_for_k
    balanced = np.clip(measured / black_body_rgb(assumed_k), 0, 1)
    tone = _with_contrast(apply_tone(balanced, development.tone), development.contrast)
    if development.saturation != 1:
        gray = tone @ LUMA
        tone = np.clip(gray[:, :, None] + development.saturation * (tone - gray[:, :, None]), 0, 1)
    if development.denoise > 0:
        tone = _denoised(tone, development.denoise)
    if development.sharpen > 0:
        tone += development.sharpen * (tone - cv2.GaussianBlur(tone, (0, 0), development.sharpen_px))
    image = np.ascontiguousarray(np.round(np.clip(tone, 0, 1) * 255).astype(np.uint8)[:, :, ::-1])
    if development.jpeg_quality is None:
        return image
    sampling = (
        cv2.IMWRITE_JPEG_SAMPLING_FACTOR_420 if development.chroma == "420" else cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444
    )
    how = [cv2.IMWRITE_JPEG_QUALITY, development.jpeg_quality, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, sampling]
    _, encoded = cv2.imencode(".jpg", image, how)
    return np.asarray(cv2.imdecode(encoded, cv2.IMREAD_COLOR), dtype=np.uint8)


def apply_tone(linear: FloatArray, tone: str) -> FloatArray:
    """Linear light 0..1 to code values 0..1."""
    if tone == "linear":
        return linear.copy()
    if tone == "gamma":
        return np.asarray(linear ** (1 / 2.2))
    if tone == "srgb":
        return linear_to_srgb(linear)
    if tone == "rec709":
        return np.where(linear < 0.018, 4.5 * linear, 1.099 * np.maximum(linear, 0.018) ** 0.45 - 0.099)
    # A toe that darkens shadows and a shoulder that preserves highlights: a sigmoid in log exposure,
    # scaled so that 0 stays 0 and 1 stays 1.
    contrast, middle = 1.35, 0.18
    curve = linear**contrast / (linear**contrast + middle**contrast)
    return np.asarray((curve * (1 + middle**contrast)) ** (1 / 1.15))


def black_body_rgb(temperature_k: float) -> FloatArray:
    """(3,) linear sRGB of a black body of 1667 to 25000 K, relative to one of 6500 K, with green 1.

    Planckian locus after Kim et al. 2002.

    Raises:
        InputError: outside that range.
    """
    if not 1667 <= temperature_k <= 25000:
        raise InputError(
            "bad_temperature", f"{temperature_k} K is outside 1667 to 25000 K", "choose a value in this range"
        )
    color: FloatArray = _planckian_rgb(temperature_k) / _planckian_rgb(DAYLIGHT_K)
    return color / float(color[1])


def _planckian_rgb(T: float) -> FloatArray:
    if T <= 4000:
        x = -0.2661239e9 / T**3 - 0.2343589e6 / T**2 + 0.8776956e3 / T + 0.179910
    else:
        x = -3.0258469e9 / T**3 + 2.1070379e6 / T**2 + 0.2226347e3 / T + 0.240390
    if T <= 2222:
        y = -1.1063814 * x**3 - 1.34811020 * x**2 + 2.18555832 * x - 0.20219683
    elif T <= 4000:
        y = -0.9549476 * x**3 - 1.37418593 * x**2 + 2.09137015 * x - 0.16748867
    else:
        y = 3.0817580 * x**3 - 5.87338670 * x**2 + 3.75112997 * x - 0.37001483
    xyz = np.array([x / y, 1.0, (1 - x - y) / y])
    to_srgb = [
        [3.2404542, -1.5371385, -0.4985314],
        [-0.9692660, 1.8760108, 0.0415560],
        [0.0556434, -0.2040259, 1.0572252],
    ]
    return np.asarray(np.maximum(np.asarray(to_srgb) @ xyz, 0.02))


def _measure(received: FloatArray, sensor: Sensor, rng: np.random.Generator) -> FloatArray:
    electrons = rng.poisson(np.clip(received, 0, None) * sensor.full_well).astype(np.float64)
    electrons += rng.normal(0, sensor.read_noise, received.shape)
    return np.clip(electrons / sensor.full_well, 0, 1)


def _shade(shadow: Shadow, width: int, height: int) -> FloatArray:
    """(H,W) 1 in the light, 1 / ratio in the shadow, with an edge one pixel wide."""
    a = np.deg2rad(shadow.towards_deg)
    x, y = np.arange(width) - shadow.through_px[0], np.arange(height) - shadow.through_px[1]
    into = np.clip(np.cos(a) * x[None, :] + np.sin(a) * y[:, None] + 0.5, 0, 1)
    return np.asarray(1 - into * (1 - 1 / shadow.ratio))


def _blurred_in_corners(image: Float32Array, sigma: float) -> Float32Array:
    """An image mixed with its blurred copy, with a share that grows with the radius r: the variance grows as r^2."""
    height, width = image.shape[:2]
    x, y = np.arange(width) - (width - 1) / 2, np.arange(height) - (height - 1) / 2
    r2 = (x[None, :] ** 2 + y[:, None] ** 2) / ((width**2 + height**2) / 4)
    share = r2.astype(np.float32)[:, :, None]
    return np.asarray(image + share * (cv2.GaussianBlur(image, (0, 0), sigma) - image), dtype=np.float32)


def _with_displaced_colors(image: Float32Array, lens: Lens) -> Float32Array:
    """(H,W,3) RGB with red enlarged about the center and shifted, and blue reduced and shifted the other way."""
    height, width = image.shape[:2]
    middle, shift = np.array([(width - 1) / 2, (height - 1) / 2]), np.array(lens.color_shift_px)
    channels = []
    for channel, sign in zip(cv2.split(image), (1, 0, -1), strict=True):
        scale = 1 + sign * lens.lateral_color
        warp = np.column_stack([scale * np.eye(2), (1 - scale) * middle + sign * shift])
        channels.append(
            cv2.warpAffine(channel, warp, (width, height), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
        )
    return np.asarray(np.maximum(cv2.merge(channels), 0), dtype=np.float32)


def _with_contrast(tone: FloatArray, exponent: float) -> FloatArray:
    """Code values 0..1 through an S curve that keeps 0, 1/2 and 1."""
    if exponent == 1.0:
        return tone
    high, low = tone**exponent, (1 - tone) ** exponent
    return np.asarray(high / (high + low))


def _denoised(tone: FloatArray, strength: float) -> FloatArray:
    """(H,W,3) code values, color smoothed and brightness smoothed by a bilateral filter."""
    coded = cv2.cvtColor(np.ascontiguousarray(tone, dtype=np.float32), cv2.COLOR_RGB2YCrCb)
    color = cv2.GaussianBlur(coded[:, :, 1:], (0, 0), 0.4 + 1.6 * strength)
    brightness = cv2.bilateralFilter(np.ascontiguousarray(coded[:, :, 0]), 5, 0.02 + 0.06 * strength, 1.5)
    return np.asarray(cv2.cvtColor(np.dstack([brightness, color]), cv2.COLOR_YCrCb2RGB), dtype=np.float64)


def _disc_kernel(radius: float) -> Float32Array:
    """A disc, anti-aliased."""
    reach = int(np.ceil(radius))
    y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    kernel = np.clip(radius + 0.5 - np.hypot(x, y), 0, 1).astype(np.float32)
    return np.asarray(kernel / kernel.sum())


def _motion_kernel(way: FloatArray) -> Float32Array:
    """A line of the given displacement, anti-aliased."""
    reach = int(np.ceil(np.abs(way).max() / 2)) + 1
    kernel = np.zeros((2 * reach + 1, 2 * reach + 1), dtype=np.float32)
    for s in (np.arange(8 * reach) + 0.5) / (8 * reach) - 0.5:
        x, y = reach + s * way[0], reach + s * way[1]
        x0, y0 = int(x), int(y)
        fx, fy = x - x0, y - y0
        for dx, dy, weight in (
            (0, 0, (1 - fx) * (1 - fy)),
            (1, 0, fx * (1 - fy)),
            (0, 1, (1 - fx) * fy),
            (1, 1, fx * fy),
        ):
            if y0 + dy < len(kernel) and x0 + dx < len(kernel):
                kernel[y0 + dy, x0 + dx] += weight
    return np.asarray(kernel / kernel.sum())
