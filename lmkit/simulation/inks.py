"""Reflectances of paper and inks in prints of the file's colors.

The values are typical CIELAB measurements (D50 white scaled to the paper's) of the solid overprints,
rounded: offset after the aims of ISO 12647-2, the office printers and the faded print assumed paler.
They represent a range of prints for tests, not a particular printer.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lmkit.arrays import Float32Array, FloatArray
from lmkit.model.palette import BLACK, BLUE, RED, WHITE, srgb_to_linear

Lab = tuple[float, float, float]


@dataclass(frozen=True)
class PrintedInks:
    """CIELAB colors of a print's four solid colors."""

    paper: Lab
    red: Lab
    blue: Lab
    black: Lab

    @property
    def reflectance(self) -> FloatArray:
        """(4,3) linear sRGB of paper, red, blue, black."""
        from skimage.color import lab2rgb

        return srgb_to_linear(lab2rgb(np.array([self.paper, self.red, self.blue, self.black], dtype=np.float64)))


OFFSET = PrintedInks((95, 0, -2), (47, 66, 46), (34, 8, -46), (16, 0, 0))
INKJET = PrintedInks((93, 1, -4), (51, 58, 34), (40, 3, -40), (24, 0, 0))
LASER = PrintedInks((94, 0, -3), (49, 62, 42), (36, 10, -44), (20, 0, 0))
FADED = PrintedInks((90, 0, 6), (60, 42, 30), (52, -4, -28), (35, 0, 2))
ALL_INKS = {"offset": OFFSET, "inkjet": INKJET, "laser": LASER, "faded": FADED}


def as_printed(texture: Float32Array, inks: PrintedInks) -> Float32Array:
    """A texture in the file's colors, (h,w,3) linear RGB, in the colors of a print.

    White, red, blue and black become the print's reflectances; mixed colors at edges follow by
    the affine map of these four colors.
    """
    file = srgb_to_linear(np.array([WHITE, RED, BLUE, BLACK]) / 255)
    affine = np.linalg.solve(np.column_stack([file, np.ones(4)]), inks.reflectance)
    printed = np.clip(texture @ affine[:3] + affine[3], 0, 1)
    return np.asarray(printed, dtype=np.float32)
