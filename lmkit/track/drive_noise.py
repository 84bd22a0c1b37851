"""How readings scatter while a robot drives."""

from __future__ import annotations

import math

from lmkit.locate.range_bearing import ReadingNoise

# Readings of one landmark within that time err alike (its place, the light, the view change slowly) and count as one.
# On MRCLAM set 6 errors stay alike for ten seconds and more; taken as independent, they make the covariance of a
# smoothed drive ten times too small.
RELATED_S = 40.0
# A camera on a robot that moves while it looks; worse than what a standing one reaches.
DRIVE_NOISE = ReadingNoise(0.14, 0.042, math.radians(0.56), math.radians(0.42))
