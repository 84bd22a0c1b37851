"""Images of little contrast, in fog or behind dirty glass: stretched before squares are searched in them.

The tests for squares use the ratio of white to its surroundings, which a veil of light brings
close to one.  Where the whole image shows little contrast, its code values are spread out first.  Registration and
reading use the original image: their inks are free.
"""

from __future__ import annotations

import numpy as np

from lmkit.detection.linear_image import LinearImage
from lmkit.kernels.pixel_sampling import Source

VEILED = 0.4  # range of the code values, of the largest, under which an image is stretched
ROOM = 0.5  # of the range on both sides: noise and fine detail exceed the averages that it comes from
AVERAGED = 3  # halvings before


def without_veil(image: LinearImage) -> LinearImage:
    """The image to search for squares: the same one, or where it shows little contrast, stretched."""
    levels = image.pyramid.levels
    averaged = levels[min(AVERAGED, len(levels) - 1)]
    low, high = int(averaged.min()), int(averaged.max())
    span = high - low
    if span == 0 or span >= VEILED * high:
        return image
    gain = 255 / (span * (1 + 2 * ROOM))
    values = np.clip((np.arange(256.0) - (low - ROOM * span)) * gain, 0, 255).round().astype(np.uint8)
    return LinearImage(Source.of(values[image.source.image], image.source.linear), gain * image.noise)
