"""Definition of `quads`: outlines of dark regions, and the quadrilaterals that fit them."""

from __future__ import annotations

from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lmkit.kernels.quad_rules import QuadRules

FloatArray = NDArray[np.floating[Any]]
ByteArray = NDArray[np.uint8]
Field = NDArray[np.int16]

CELL = 4
BANDS = 24  # rows from which an image's changes are known
STRETCHES = 16  # a polygon of more sides is no square with a hidden part
LONGEST = 6
IN_TURN = 10  # longest stretches of a strip, of which four in turn are a square's sides
STRIP_LENGTH = 7.0  # least length of a strip's outline, of the side from which squares are completed
STRIP_BROAD = 0.013  # most area within a strip over its outline's squared length
STRIP_TURNS, STRIP_WINDS = 1.3, 2.05  # its length, of that of the box around every eighth pixel
EVEN = 0.38  # least distance of a corner from the diagonal beside it, of both together
FULL = 0.72  # least share of its hull that lies between the corners of a square
ROUND = 0.003  # least area over the squared number of pixel sides: 1/16 for a square


def where_to_look_numpy(
    image: ByteArray, offset: float, least: tuple[float, float, float, float], dilate: bool
) -> ByteArray:
    """Definition of `where_to_look`."""
    blue, green, red = (image[:, :, k].astype(np.float32) for k in range(3))
    o = np.float32(offset)
    luma = np.float32(0.25) * (blue + 2 * green + red) + o
    # The range of a logarithm is the ratio of the largest and the smallest value.
    ratio = (red + o) / (blue + o)
    most = [_over_neighbors(_over_cells(v)) for v in (ratio, -ratio, luma, -luma)]
    in_color, in_light, more_color, more_light = (
        most[k] > -most[k + 1] * np.float32(np.exp(limit)) for k, limit in zip((0, 2, 0, 2), least, strict=True)
    )
    much = in_color & in_light
    where = much.astype(np.float64) + (much & more_color & more_light)
    return (_over_neighbors(where) if dilate else where).astype(np.uint8)


def _over_cells(values: FloatArray) -> FloatArray:
    height, width = (-(-length // CELL) for length in values.shape)
    padded = np.full((height * CELL, width * CELL), -np.inf, dtype=np.float32)
    padded[: values.shape[0], : values.shape[1]] = values
    return np.asarray(padded.reshape(height, CELL, width, CELL).max(axis=(1, 3)))


def _over_neighbors(cells: FloatArray) -> FloatArray:
    padded = np.pad(cells, 1, constant_values=-np.inf)
    height, width = cells.shape
    shifted = [padded[y : y + height, x : x + width] for y in range(3) for x in range(3)]
    return np.asarray(np.max(shifted, axis=0))


def cells_of(cells: ByteArray, halvings: int, down: int, across: int) -> ByteArray:
    """(down,across) cells of an image that is halved so many times more; those of which one of the larger ones is."""
    for _ in range(-halvings):
        cells = np.repeat(np.repeat(cells, 2, axis=0), 2, axis=1)
    for _ in range(halvings):
        cells = np.pad(cells, [(0, length % 2) for length in cells.shape], mode="edge")
        cells = cells[::2] | cells[1::2]
        cells = cells[:, ::2] | cells[:, 1::2]
    # Halving leaves out the last row and column of odd sizes.
    rows, columns = (np.minimum(np.arange(n), have - 1) for n, have in zip((down, across), cells.shape, strict=True))
    return np.asarray(cells[rows[:, None], columns])


def dark_quads_numpy(
    plane: ByteArray, where: ByteArray | None, window: int, rules: QuadRules, halvings: int = 0, level: int = 0
) -> FloatArray:
    """Definition of `dark_quads`."""
    field = local_field(plane, window, rules.darker)
    looked = np.ones(plane.shape, dtype=bool)
    if where is not None:
        where = cells_of(where, halvings, *(-(-length // CELL) for length in plane.shape))
        looked = np.repeat(np.repeat(where > 0, CELL, axis=0), CELL, axis=1)[: plane.shape[0], : plane.shape[1]]
    dark = field < 0
    # Pixels with a left side on an outline, in the order in which outlines are begun.
    falls = field[1:-1, :-2].astype(np.int64) - field[1:-1, 1:-1] >= int(64 * _step_to_begin(plane, rules))
    begins = np.argwhere(dark[1:-1, 1:-1] & ~dark[1:-1, :-2] & falls & looked)
    visited: set[tuple[int, int]] = set()
    found: list[FloatArray] = []
    for y, x in begins.tolist():
        if (y + 1, x + 1) in visited:
            continue
        sides = _follow(dark, visited, y + 1, x + 1)
        if len(sides) > rules.longest or len(sides) < 3.2 * rules.least_side:
            continue
        outline, squared = _crossings(field, np.array(sides)), len(sides) ** 2
        area = _pixels_within(np.array(sides))
        # Bright regions run the other way around; what winds encloses little for its length.
        if area + 0.5 * len(sides) > ROUND * squared:
            if _area(outline) > ROUND * squared:
                found += _outline_quads(outline, rules)
        elif len(sides) >= STRIP_LENGTH * rules.completed_side and -area <= STRIP_BROAD * squared:
            box = 2 * int(np.ptp(np.array(sides)[::8, :2], axis=0).sum())
            if STRIP_TURNS * box < len(sides) < STRIP_WINDS * box:
                found += _completed_inside(outline.astype(np.float64), rules)
    # Pixel k of a halved image covers the span [k, k + 1) * 2 of the one before.
    return (np.array(found) + 0.5) * 2**level - 0.5 if found else np.zeros((0, 4, 2))


def _step_to_begin(plane: ByteArray, rules: QuadRules) -> float:
    height = len(plane)
    bands = min(BANDS, height)
    changes = np.abs(np.diff(plane[(2 * np.arange(bands) + 1) * height // (2 * bands)].astype(np.int64), axis=1))
    counts = np.bincount(changes.ravel(), minlength=1).cumsum()
    usual = int(np.searchsorted(counts, (changes.size + 1) // 2))
    return min(max(rules.step_per_change * usual, rules.least_step), rules.most_step)


def local_field(plane: ByteArray, window: int, darker: float) -> Field:
    """(H+2,W+2) 64 (value - (1 - darker) local mean + 0.5) with a border that is not dark."""
    half = window // 2
    height, width = plane.shape
    total = np.zeros((height + 1, width + 1), dtype=np.int64)
    total[1:, 1:] = plane.astype(np.int64).cumsum(axis=0).cumsum(axis=1)
    top, bottom = np.maximum(np.arange(height) - half, 0), np.minimum(np.arange(height) + half + 1, height)
    left, right = np.maximum(np.arange(width) - half, 0), np.minimum(np.arange(width) + half + 1, width)
    sums = total[np.ix_(bottom, right)] - total[np.ix_(top, right)] - total[np.ix_(bottom, left)]
    sums += total[np.ix_(top, left)]
    # Integers of 16 bits: a window's sum is shifted as far as they allow, and the product's upper half is the mean.
    shift = (65535 // (255 * window**2)).bit_length() - 1
    pixels = (bottom - top)[:, None] * (right - left)
    share = np.floor(64 * (1 - darker) * (65536 >> shift) / pixels + 0.5).astype(np.int64)
    field = np.ones((height + 2, width + 2), dtype=np.int16)
    field[1:-1, 1:-1] = 64 * plane.astype(np.int64) + 32 - ((sums << shift) * share >> 16)
    return field


_STEPS = ((0, 1), (1, 0), (0, -1), (-1, 0))  # row and column: right, down, left, up


def _follow(dark: NDArray[np.bool_], visited: set[tuple[int, int]], y: int, x: int) -> list[tuple[int, int, int]]:
    """Pixel sides (row, column, side) of an outline, clockwise around the dark region, from a left side on."""
    start, side = (y, x), 2
    sides = []
    while True:
        sides.append((y, x, side))
        if side == 2:
            visited.add((y, x))
        along = (side + 1) % 4
        ahead = y + _STEPS[along][0], x + _STEPS[along][1]
        beyond = ahead[0] + _STEPS[side][0], ahead[1] + _STEPS[side][1]
        if dark[beyond]:
            (y, x), side = beyond, (side + 3) % 4
        elif dark[ahead]:
            y, x = ahead
        else:
            side = along
        if (y, x) == start and side == 2:
            return sides


def _pixels_within(sides: NDArray[np.int64]) -> int:
    """Dark pixels within an outline; negative around bright ones."""
    _, x, side = sides.T
    return int(((x + 1) * (side == 0)).sum() - (x * (side == 2)).sum())


def _crossings(field: Field, sides: NDArray[np.int64]) -> FloatArray:
    """(N,2) x, y where the field crosses zero between a pixel and its neighbor, in single precision."""
    y, x, side = sides.T
    steps = np.array(_STEPS)[side]
    inside = field[y, x].astype(np.float32)
    t = inside / (inside - field[y + steps[:, 0], x + steps[:, 1]].astype(np.float32))
    outline = np.column_stack([x - 1, y - 1]).astype(np.float32)
    return np.asarray(outline + t[:, None] * steps[:, ::-1].astype(np.float32))


def _outline_quads(outline: FloatArray, rules: QuadRules) -> list[FloatArray]:
    corners, area = _four_corners(outline)
    if area < 0.7 * rules.least_side**2:
        return []
    outline = outline.astype(np.float64)
    found = []
    quad = _fit_quad(outline, corners, 0.5 * rules.least_side) if corners else None
    if quad is not None:
        ratio = area / _area(quad)
        if 0.7 <= ratio <= 1.4:
            found.append(quad)
            if 0.95 < ratio < 1.05:
                return found
    if area > rules.completed_side**2:
        found += _completed(outline, rules)
    return found


def _four_corners(outline: FloatArray) -> tuple[list[int], float]:
    """Corners, clockwise as seen: farthest from the middle, farthest from that, and farthest on both sides of the
    line between; none where they are no square's.  And the area of the outline's hull, taken for four parabolas on
    the sides."""
    first = _farthest(outline, np.float32(0.5) * (outline.min(axis=0) + outline.max(axis=0)))
    third = _farthest(outline, outline[first])
    off = _beside(outline, first, third)
    left, right = int(off.argmin()), int(off.argmax())
    if not off[left] < 0 < off[right]:
        return [], 0.0
    corners = [first, left, third, right]
    whole = off[right] - off[left]
    sides = zip(corners, corners[1:] + corners[:1], strict=True)
    beyond = sum((min(_beside(outline, a, b).min(), np.float32(0)) for a, b in sides), np.float32(0))
    inner, area = 0.5 * float(whole), 0.5 * float(whole) - 2 / 3 * float(beyond)
    even = min(off[right], -off[left]) >= np.float32(EVEN) * whole
    return (corners if even and inner >= FULL * area else []), area


def _farthest(outline: FloatArray, point: FloatArray) -> int:
    off = outline - point
    return int((off[:, 0] * off[:, 0] + off[:, 1] * off[:, 1]).argmax())


def _beside(outline: FloatArray, a: int, b: int) -> FloatArray:
    """(N,) how far points lie to the right of the way between two of them, times its length."""
    way, off = outline[b] - outline[a], outline - outline[a]
    return np.asarray(way[0] * off[:, 1] - way[1] * off[:, 0])


def _fit_quad(outline: FloatArray, corners: list[int], least: float) -> FloatArray | None:
    lines = [_fit_line(outline, a, b) for a, b in zip(corners, corners[1:] + corners[:1], strict=True)]
    quad = _quad_of(lines, least)
    return None if quad is None else np.roll(quad, -int((quad @ [1.0, 0.6]).argmin()), axis=0)


def _fit_line(outline: FloatArray, start: int, end: int) -> FloatArray:
    """(4,) point and direction of the line through the outline between two of its points."""
    a, b = outline[start], outline[end]
    length = float(np.linalg.norm(b - a))
    if length < 1e-6:
        return np.array([*a, *(b - a)])
    unit = (b - a) / length
    offset = outline[(start + np.arange((end - start) % len(outline) + 1)) % len(outline)] - a
    along, off = offset @ unit, offset @ np.array([-unit[1], unit[0]])
    used = offset[(along >= 0.1 * length) & (along <= 0.9 * length) & (np.abs(off) <= max(0.06 * length, 1.0))]
    if len(used) < 3:
        return np.array([*a, *(b - a)])
    mean = used.mean(axis=0)
    xx, xy, yy = (used**2).mean(axis=0)[0] - mean[0] ** 2, (used[:, 0] * used[:, 1]).mean() - mean[0] * mean[1], 0.0
    yy = (used**2).mean(axis=0)[1] - mean[1] ** 2
    angle = 0.5 * np.arctan2(2 * xy, xx - yy)
    return np.array([*(a + mean), np.cos(angle), np.sin(angle)])


def _quad_of(lines: list[FloatArray], least: float) -> FloatArray | None:
    """(4,2) where neighboring lines meet; None unless that is a fair square."""
    corners = [_meeting(lines[k - 1], lines[k]) for k in range(4)]
    quad = np.array([corner for corner in corners if corner is not None])
    return quad if len(quad) == 4 and _is_fair(quad, least) else None


def _meeting(a: FloatArray, b: FloatArray) -> FloatArray | None:
    """(2,) where two lines meet; None for nearly parallel ones."""
    det = a[2] * b[3] - a[3] * b[2]
    if abs(det) < 0.05 * np.hypot(a[2], a[3]) * np.hypot(b[2], b[3]):
        return None
    t = ((b[0] - a[0]) * b[3] - (b[1] - a[1]) * b[2]) / det
    return np.asarray(a[:2] + t * a[2:])


def _is_fair(quad: FloatArray, least: float) -> bool:
    """Convex, clockwise, no side under ``least`` or a seventh of the longest."""
    edges = np.roll(quad, -1, axis=0) - quad
    following = np.roll(edges, -1, axis=0)
    turn = edges[:, 0] * following[:, 1] - edges[:, 1] * following[:, 0]
    lengths = np.linalg.norm(edges, axis=1)
    return bool(
        (turn > 0.05 * lengths * np.roll(lengths, -1)).all() and lengths.min() > max(0.15 * lengths.max(), least)
    )


def _completed(outline: FloatArray, rules: QuadRules) -> list[FloatArray]:
    """Squares of the outline's longest straight stretches, for squares of which a part is hidden."""
    total = _length_around(outline)
    stretches, lengths = _long_stretches(outline, rules.straight * total, LONGEST)
    found = []
    for chosen in sorted(combinations(range(len(stretches)), 4), key=lambda places: sum(1 << k for k in places)):
        if lengths[list(chosen)].sum() >= 0.45 * total:
            found += _square_of(outline, [stretches[k] for k in chosen], total, rules.least_side)
    return found


def _completed_inside(outline: FloatArray, rules: QuadRules) -> list[FloatArray]:
    """Squares inside a bright strip, such as a margin.

    Something dark over a corner joins the square to what is dark around the margin, whose outline keeps the square's
    sides: four long stretches in turn.  A hard shadow cuts the margin in two: of three, the one between is a whole
    side.
    """
    total = _length_around(outline)
    stretches, lengths = _long_stretches(outline, 0.5 * rules.straight * total, IN_TURN)
    found: list[FloatArray] = []
    if len(stretches) <= 4:
        return found
    for first in range(len(stretches)):
        chosen = [(first + k) % len(stretches) for k in range(4)]
        sides = [stretches[k] for k in chosen]
        if lengths[chosen].sum() >= 0.25 * total:
            found += _square_of(outline, sides, total, rules.least_side)
        if lengths[chosen[:3]].sum() >= 0.25 * total:
            found += _square_from_three(outline, sides[:3], rules.least_side)
    return found


def _square_of(outline: FloatArray, sides: list[tuple[int, int]], total: float, least: float) -> list[FloatArray]:
    quad = _quad_of([_fit_line(outline, a, b) for a, b in sides], least)
    return [quad] if quad is not None and np.ptp(quad, axis=0).max() < total else []


def _square_from_three(outline: FloatArray, sides: list[tuple[int, int]], least: float) -> list[FloatArray]:
    """The square of which a side and pieces of both beside it are seen: as deep as it is wide."""
    lines = [_fit_line(outline, a, b) for a, b in sides]
    near = [_meeting(lines[0], lines[1]), _meeting(lines[1], lines[2])]
    if near[0] is None or near[1] is None:
        return []
    wide = float(np.linalg.norm(near[1] - near[0]))
    far = []
    for line, corner, end in zip((lines[0], lines[2]), near, (sides[0][0], sides[2][1]), strict=True):
        way = line[2:] / np.hypot(line[2], line[3])
        far.append(corner + (-wide if way @ (outline[end] - corner) < 0 else wide) * way)
    quad = np.array([far[0], near[0], near[1], far[1]])
    return [quad] if _is_fair(quad, least) else []


def _length_around(outline: FloatArray) -> float:
    return float(np.linalg.norm(np.roll(outline, -1, axis=0) - outline, axis=1).sum())


def _long_stretches(outline: FloatArray, tolerance: float, most: int) -> tuple[list[tuple[int, int]], FloatArray]:
    """The longest straight stretches of an outline, in order, by their ends, and their lengths; none where it is no
    polygon of few sides."""
    corners = _simplified(outline, tolerance)
    if not 4 <= len(corners) <= STRETCHES:
        return [], np.zeros(0)
    following = corners[1:] + corners[:1]
    lengths = np.linalg.norm(outline[following] - outline[corners], axis=1)
    longest = sorted(np.argsort(-lengths, kind="stable")[:most].tolist())
    return [(corners[k], following[k]) for k in longest], lengths[longest]


def _simplified(outline: FloatArray, tolerance: float) -> list[int]:
    """Corners of a closed polygon close to the outline (Douglas and Peucker 1973), at most 17 of them."""
    count = len(outline)
    far = _farthest(outline.astype(np.float32), outline[0].astype(np.float32))
    stack = [(far, count), (0, far)]
    corners: list[int] = []
    while stack and len(corners) <= STRETCHES:
        start, end = stack.pop()
        a, b = outline[start], outline[end % count]
        inner = outline[start + 1 : end]
        length = float(np.linalg.norm(b - a))
        if length > 1e-9:
            off = np.abs((b[0] - a[0]) * (inner[:, 1] - a[1]) - (b[1] - a[1]) * (inner[:, 0] - a[0])) / length
        else:
            off = np.linalg.norm(inner - a, axis=1)
        if len(off) and off.max() > tolerance:
            split = start + 1 + int(off.argmax())
            stack += [(split, end), (start, split)]
        else:
            corners.append(start)
    return corners


def _area(points: FloatArray) -> float:
    x, y = points.T
    return float(0.5 * np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))
