"""Pixels of ROS 2 images: sensor_msgs/Image by its encoding, sensor_msgs/CompressedImage by its file's format."""

from __future__ import annotations

import cv2
import numpy as np

from lmkit.arrays import ByteArray
from lmkit.errors import InputError

IMAGE, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
_TO_BGR = {
    "rgb8": cv2.COLOR_RGB2BGR,
    "rgba8": cv2.COLOR_RGBA2BGR,
    "bgra8": cv2.COLOR_BGRA2BGR,
    # OpenCV names the pattern by its second row.
    "bayer_rggb8": cv2.COLOR_BayerBG2BGR,
    "bayer_bggr8": cv2.COLOR_BayerRG2BGR,
    "bayer_gbrg8": cv2.COLOR_BayerGR2BGR,
    "bayer_grbg8": cv2.COLOR_BayerGB2BGR,
    # Of USB cameras; two bytes a pixel.
    "yuv422_yuy2": cv2.COLOR_YUV2BGR_YUY2,
    "yuv422": cv2.COLOR_YUV2BGR_UYVY,
}
_CHANNELS = {"rgba8": 4, "bgra8": 4, "rgb8": 3, "bgr8": 3, "8UC3": 3, "yuv422_yuy2": 2, "yuv422": 2}
_GRAY = ("mono8", "8UC1")


def pixels_of(encoding: str, size: tuple[int, int], step: int, data: bytes | ByteArray, topic: str) -> ByteArray:
    """(H,W,3) BGR or (H,W,1) gray of a sensor_msgs/Image.

    Args:
        size: (width, height).
        step: bytes of a row.

    Raises:
        InputError: an encoding that is not read, or data of another size.
    """
    width, height = size
    channels = _CHANNELS.get(encoding, 1)
    if channels == 1 and encoding not in _GRAY and encoding not in _TO_BGR:
        raise InputError(
            "bad_encoding",
            f"{topic}: images of encoding {encoding}",
            "known: bgr8, rgb8, bgra8, rgba8, mono8, bayer (8 bit), yuv422_yuy2, yuv422",
        )
    flat = np.frombuffer(data, np.uint8)
    if len(flat) != height * step or step < width * channels or not width * height:
        raise InputError(
            "bad_image",
            f"{topic}: {len(flat)} bytes for an image of {width}x{height} {encoding}, {step} a row",
            "check the node that publishes it",
        )
    pixels = flat.reshape(height, step)[:, : width * channels].reshape(height, width, channels)
    if encoding in _TO_BGR:
        pixels = np.asarray(cv2.cvtColor(np.ascontiguousarray(pixels.squeeze(2) if channels == 1 else pixels),
                                         _TO_BGR[encoding]), np.uint8)  # fmt: skip
    return pixels


def decoded(data: bytes | ByteArray, topic: str) -> ByteArray:
    """(H,W,3) BGR of a sensor_msgs/CompressedImage.

    Raises:
        InputError: no image that OpenCV reads.
    """
    flat = np.frombuffer(data, np.uint8)
    image = cv2.imdecode(flat, cv2.IMREAD_COLOR) if len(flat) else None
    if image is None:
        raise InputError("bad_image", f"{topic}: neither JPEG nor PNG", "publish images of one of both formats")
    return np.asarray(image, dtype=np.uint8)
