"""Arguments for the kernels of detection; see kernel_pairs.py."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import cv2
import numpy as np

from lmkit.kernels.cell_codes import cell_codes, cell_codes_numpy
from lmkit.kernels.grid_moments import grid_moments, grid_moments_numpy
from lmkit.kernels.grid_pattern import GridDrawing, jets_numpy
from lmkit.kernels.hypotheses import DecodingRules, Words, decode, decode_numpy
from lmkit.kernels.mosaic import MosaicRules
from lmkit.kernels.noise import noise, noise_numpy
from lmkit.kernels.occlusion import OcclusionRules
from lmkit.kernels.pattern import Drawing, coverage_columns_numpy
from lmkit.kernels.pixel_sampling import Edges, SamplingRules, Source, sample, sample_numpy
from lmkit.kernels.plane import View, plane_numpy
from lmkit.kernels.quad_rules import QuadRules
from lmkit.kernels.quads import Contrast, dark_quads, where_to_look
from lmkit.kernels.quads_numpy import dark_quads_numpy, where_to_look_numpy
from lmkit.kernels.registration import (
    Hypothesis,
    Limits,
    Mosaic,
    Priors,
    Samples,
    Steps,
    linearize,
    linearize_numpy,
    register,
    register_numpy,
    robust_weights,
    robust_weights_numpy,
)
from lmkit.kernels.screening import (
    Pyramid,
    ScreenRules,
    ScreenTables,
    Shares,
    Thresholds,
    likely,
    likely_numpy,
    screen,
    screen_numpy,
)
from lmkit.kernels.shadow_edge import shadow_edge, shadow_edge_numpy


def drawing_with(rings: int) -> Drawing:
    """A drawing with this number of rings, each with four gaps between the same eight lines, as in the families."""
    lines = [(np.cos(a), np.sin(a), 0.0) for a in np.arange(8) * np.pi / 8]
    lines += [(np.cos(a), np.sin(a), -10.0) for t in range(4) for a in np.arange(3) * 2 * np.pi / 3 + t * np.pi / 6]
    gaps = [(r, 2 * k, 1 - 2 * (k > 1), 2 * k + 1, 1 - 2 * (k % 2)) for r in range(rings) for k in range(4)]
    triangles = [[(8 + 3 * t + k, 1) for k in range(3)] for t in range(4)]
    radii = [(60.0 - 17 * r, 70.0 - 17 * r) for r in range(rings)]
    return Drawing.of((100, 90, 80), np.reshape(radii, (-1, 2)), lines, np.reshape(gaps, (-1, 5)), triangles)


def words_with(rng: np.random.Generator, rings: int, count: int) -> Words:
    masks = np.stack([rng.permutation(1 << (4 * rings))[:count] for _ in range(4)])
    return Words.of(masks, 4 * rings)


VIEW = View(np.array([300.0, 200.0]), np.array([319.5, 239.5]), 320.0, 90.0)
PRIORS = Priors(1e-5, 0.12, 0.05, 0.1, 10.0, 0.2)
LIMITS = Limits(0.04, 64.0, 0.3, 0.6, 1.0)


def _landmark(rng: np.random.Generator, rings: int, count: int, wild: bool) -> tuple[Any, ...]:
    """Drawing (a grid of -rings cells where negative), pixels drawn with it, a state near the truth, hypothesis."""
    drawing: Drawing | GridDrawing
    if rings < 0:
        drawing, hypothesis = GridDrawing.of(110.0, 90.0, rng.random((-rings, -rings))), Hypothesis(0, 0)
    else:
        drawing = drawing_with(rings)
        hypothesis = Hypothesis(int(rng.integers(1 << (4 * rings))), int(rng.integers(4)))
    corners = np.array([[-27, -25], [28, -27], [26, 30], [-29, 27.0]]) + VIEW.origin
    truth = np.concatenate([corners.ravel(), [0.8, 0.1, 0.9, 0.02, 0.05, -0.03, 0.1]])
    at = rng.integers(-33, 33, (2, count)).astype(np.float32)
    points, spread, _, _ = plane_numpy(VIEW, truth, at.T.astype(np.float64))
    inks = np.array([[0.8, 0.8, 0.7], [0.05, 0.06, 0.5], [0.4, 0.1, 0.05], [0.3, 0.3, 0.3]])
    values = jets_numpy(drawing, points, spread, *hypothesis, slopes=False)[0].T @ inks
    values = rng.random(values.shape) if wild else values + rng.normal(0, 0.01, values.shape)
    samples = Samples.of(at, values.T, 1e-4 * (1 + rng.random(count)))
    state = truth.copy()
    state[:8] += rng.normal(0, 0.3, 8)
    return drawing, samples, state, hypothesis


def _linearizations(rng: np.random.Generator) -> Iterator[tuple[Any, ...]]:
    for rings, count in [(2, 300), (2, 64), (1, 65), (3, 500), (0, 40), (-8, 400)]:
        drawing, samples, state, hypothesis = _landmark(rng, rings, count, False)
        yield drawing, VIEW, samples, PRIORS, state, hypothesis, True
        state[14] = 0.0
        yield drawing, VIEW, samples, PRIORS, state, hypothesis, False


def _registrations(rng: np.random.Generator) -> Iterator[tuple[Any, ...]]:
    for rings, count in [(2, 400), (1, 300), (3, 600), (-6, 500)]:
        drawing, samples, state, hypothesis = _landmark(rng, rings, count, False)
        for rounds in (0, 2):
            yield drawing, VIEW, samples, PRIORS, LIMITS, state, hypothesis, Steps(rounds, 12, 1e-4, rings == 2)
    for rings, count in [(2, 900), (1, 70)]:
        drawing, samples, state, hypothesis = _landmark(rng, rings, count, False)
        column, row = samples.at.astype(int) % 2
        smeared = samples.values + rng.normal(0, 0.02, samples.values.shape) * ((row + column) % 2 == 0)
        mosaic = Mosaic((2 * row + column).astype(np.float32), MosaicRules(0.3, 0.15, 2.0, 0.04))
        samples = Samples.of(samples.at, smeared, samples.variance)
        yield drawing, VIEW, samples, PRIORS, LIMITS, state, hypothesis, Steps(2, 12, 1e-4), mosaic


def _weightings(rng: np.random.Generator) -> Iterator[tuple[Any, ...]]:
    for rings, count, wild in [(2, 300, False), (2, 127, True), (3, 64, False), (-8, 300, False)]:
        drawing, samples, state, hypothesis = _landmark(rng, rings, count, wild)
        yield drawing, VIEW, samples, PRIORS, state, hypothesis


def _decodings(rng: np.random.Generator) -> Iterator[tuple[Any, ...]]:
    rules = DecodingRules(1e-5, 1e-4, OcclusionRules(0.08, 0.7, 6.0, 12.0, 6.0, 3, 10 / 9))
    for rings, count, codes, wild in [
        (2, 400, 256, False),
        (1, 129, 16, False),
        (3, 300, 184, False),
        (2, 200, 3, True),
    ]:
        drawing, samples, state, _ = _landmark(rng, rings, count, wild)
        yield drawing, words_with(rng, rings, codes), VIEW, samples, state, rules


def _grids(rng: np.random.Generator) -> Iterator[tuple[Any, ...]]:
    for side, count in [(6, 300), (8, 64), (9, 65), (3, 40)]:
        drawing, samples, state, _ = _landmark(rng, -side, count, False)
        yield drawing, 1, VIEW, samples, state


def _codes(rng: np.random.Generator) -> Iterator[tuple[Any, ...]]:
    for cells, count in ((16, 200), (36, 2348), (49, 40), (64, 300)):
        words = rng.integers(0, 1 << 63, count, dtype=np.uint64) >> np.uint64(64 - cells)
        white = ((words[count // 3] >> np.arange(cells, dtype=np.uint64)) & np.uint64(1)).astype(np.float64)
        columns = np.abs(rng.normal(0, 1, (cells + 3, 8 * cells))) ** 4  # most pixels lie in one cell
        for error in (0.02, 0.3, 3.0):
            light = 0.8 * white @ columns[:-3] + 0.1 * (1 - white) @ columns[:-3] + 0.1 * columns[-3]
            values = light + 0.8 * columns[-2] + 0.4 * columns[-1] + rng.normal(0, error, (3, columns.shape[1]))
            rows = np.vstack([columns, values])
            yield words, rows @ rows.T
    yield words, np.zeros((70, 70))


def _samplings(rng: np.random.Generator) -> Iterator[tuple[Any, ...]]:
    image = rng.integers(0, 256, (400, 500, 3), dtype=np.uint8)
    linear = np.linspace(0, 1, 256) ** 2.2
    white = rng.random((400, 500)) + 0.5
    shift = rng.normal(0, 0.3, (400, 500, 2))
    edges = Edges((90.0, 80.0), (70.0, 60.0, 47.0, 37.0))
    _, _, state, _ = _landmark(rng, 2, 40, False)
    box = (265, 165, 335, 240)
    for at_most, near, source in [
        (5000, 0.8, Source.of(image, linear)),
        (600, 0.8, Source.of(image, linear)),
        (600, 0.0, Source.of(image, linear, white)),
        (100, 0.8, Source.of(image, linear, None, shift)),
        (20, 0.0, Source.of(image, linear, white, shift)),
    ]:
        yield source, VIEW, state, box, edges, SamplingRules(97.0, 9.0, at_most, near, 0.01, paper=100.0)
    yield source, VIEW, state, (0, 0, 500, 400), edges, SamplingRules(97.0, 9.0, 300, 0.8, 0.01)
    yield source, VIEW, state, (0, 0, 500, 400), edges, SamplingRules(97.0, 9.0, 300, 0.8, 0.01, paper=95.0)
    yield source, VIEW, state, (10, 10, 30, 30), edges, SamplingRules(97.0, 9.0, 300, 0.8, 0.01)
    yield source, VIEW, state, (10, 10, 10, 10), edges, SamplingRules(97.0, 9.0, 300, 0.8, 0.01)


def _landmark_image(rng: np.random.Generator, rings: int) -> tuple[np.ndarray, np.ndarray]:
    """An image of 96 x 128 with one landmark, and its corners."""
    drawing = drawing_with(rings)
    corners = np.array([[30, 25], [92, 30], [88, 80], [34, 84.0]])
    view = View(np.zeros(2), np.array([63.5, 47.5]), 64.0, 90.0)
    y, x = np.mgrid[:96, :128]
    at = np.column_stack([x.ravel(), y.ravel()]).astype(np.float64)
    points, spread, _, _ = plane_numpy(view, np.concatenate([corners.ravel(), [1, 0, 1], np.zeros(4)]), at)
    inks = np.array([[200, 210, 205], [30, 40, 160], [120, 60, 20], [90, 80, 90.0]])
    jets = jets_numpy(drawing, points, spread, int(rng.integers(1 << (4 * rings))), 1, slopes=False)[0]
    return (jets.T @ inks + rng.normal(0, 2, (len(at), 3))).clip(0, 255).round().reshape(96, 128, 3), corners


def _lookings(rng: np.random.Generator) -> Iterator[tuple[Any, ...]]:
    for shape in [(96, 128), (61, 77), (8, 8), (1, 3)]:
        image = rng.integers(0, 256, (*shape, 3), dtype=np.uint8) // 4 + 80
        for dilate in (False, True):
            yield image, 14.0, Contrast(0.55, 0.4, 0.6, 0.45), dilate


def _noises(rng: np.random.Generator) -> Iterator[tuple[Any, ...]]:
    for shape in [(96, 128), (3, 3), (4, 200), (2, 9), (50, 1)]:
        yield (rng.integers(0, 256, (*shape, 3), dtype=np.uint8),)
        yield (rng.integers(80, 90, (*shape, 3), dtype=np.uint8),)


def _shadows(rng: np.random.Generator) -> Iterator[tuple[Any, ...]]:
    angles = np.arange(36) * np.pi / 36
    normals = np.column_stack([np.cos(angles), np.sin(angles)])
    for normal in normals[::7]:
        at = rng.uniform(0, 50, (400, 2))
        values = np.where(at @ normal > np.median(at @ normal), 0.0, -1.0) + rng.normal(0, 0.1, 400)
        yield at, values, rng.uniform(0.1, 1.0, 400), normals
    yield np.ones((5, 2)), np.ones(5), np.ones(5), normals


def _quads(rng: np.random.Generator) -> Iterator[tuple[Any, ...]]:
    """Outlines that do not depend on the last bit: squares with a part hidden or not, in smooth light."""
    y, x = np.mgrid[:120, :160].astype(np.float64)
    for hidden in (False, True):
        plane = 150 + 40 * np.sin(x / 50) * np.cos(y / 60)
        for cx, cy, half, angle in [(40, 40, 21, 0.3), (110, 50, 14, 0.7), (60, 95, 9, 0.1), (130, 100, 5, 0.4)]:
            u = (x - cx) * np.cos(angle) + (y - cy) * np.sin(angle)
            v = (y - cy) * np.cos(angle) - (x - cx) * np.sin(angle)
            u, v = (u + 0.15 * v) / (1 + u / 200), (v - 0.04 * u) / (1 + u / 200)
            inside = 1 / (1 + np.exp(np.minimum(np.maximum(np.abs(u), np.abs(v)) - half, 50)))
            plane = plane * (1 - 0.7 * inside)
        if hidden:
            plane[:, 22:30] = 190
        rules = QuadRules(4.0, 0.04, 8 * 280, 10.0, 0.012)
        where = rng.integers(0, 2, (30, 40)).astype(np.uint8)
        smooth = plane.round().astype(np.uint8)
        for window in (3, 7, 15):
            yield smooth, None, window, rules
            yield smooth, where, window, rules
        from_steps = rules._replace(darker=0.01, step_per_change=3.0, least_step=2.0, most_step=12.0)
        yield smooth, None, 5, from_steps
        yield smooth, None, 5, from_steps._replace(darker=-0.02)
        yield (plane + rng.normal(0, 3, plane.shape)).clip(0, 255).astype(np.uint8), None, 5, from_steps
    # A sheet with a dark object over a corner, and one that a shadow's edge cuts: their margins are strips.
    for cut in (x + y < 66, 0.2 * x + y < 66):
        u, v = np.abs(x - 80.3) + 0.04 * y, np.abs(y - 60.2) - 0.05 * x
        plane = 60 + 130 * ((u < 40) & (v < 34)) - 120 * ((u < 33) & (v < 27))
        plane = np.where(cut, 0.15 * plane + 10, plane)
        yield cv2.GaussianBlur(plane, (0, 0), 1.1).round().astype(np.uint8), None, 5, from_steps
    yield np.zeros((1, 1), np.uint8), None, 7, rules
    yield np.full((3, 200), 9, np.uint8), None, 7, rules
    yield (np.indices((40, 40)).sum(axis=0) % 2 * 255).astype(np.uint8), None, 7, rules
    # Cells of the image before it was halved, and of an image halved once more; odd sizes.
    for shape, halvings, level in (((61, 79), 1, 2), ((15, 19), -1, 0)):
        yield smooth, rng.integers(0, 2, shape).astype(np.uint8), 7, rules, halvings, level


def _screenings(rng: np.random.Generator) -> Iterator[tuple[Any, ...]]:
    first, moved = Thresholds(1.1, 1.1, 0.1, 0.05, 0.0), Thresholds(1.1, 1.2, 0.2, 0.1, 0.01)
    rules = ScreenRules(40.0, 1.2, 1e-5, 0.02, 20.0, 1.2, 0.0, 0.02, 1.5, 1.05, first, moved)
    for rings in (2, 1):
        image, corners = _landmark_image(rng, rings)
        shaded = image.copy()
        shaded[:, 60:] /= 3
        quads = corners + rng.normal(0, 1.2, (6, 4, 2))
        quads[4] += 30  # partly outside of the image
        quads[5, 0] = quads[5, 2]  # not convex
        quads = np.concatenate([quads, np.roll(quads[:1], 1, axis=1)])
        tables = _tables(rng, rings)
        for seen, window in ((image, 0), (shaded, 9)):
            full = seen.astype(np.uint8)
            half = full.reshape(48, 2, 64, 2, 3).mean(axis=(1, 3)).astype(np.uint8)
            pyramid = Pyramid((full, half), (np.arange(256, dtype=np.float32) / 255) ** 2.2)
            for rounds in (0, 1, 3):
                yield pyramid, tables, rules, quads, rounds, window


def screening_of_a_landmark(rng: np.random.Generator) -> tuple[Any, ...]:
    """Pyramid, tables and rules of an image with one landmark, and a square a pixel or so off it."""
    pyramid, tables, rules, quads, *_ = next(_screenings(rng))
    return pyramid, tables, rules, quads[0]


def _likely_squares(rng: np.random.Generator) -> Iterator[tuple[Any, ...]]:
    for pyramid, tables, rules, quads, rounds, window in _screenings(rng):
        yield pyramid, tables, rules, quads, Shares(0.02, 0.05), rounds, window


def _tables(rng: np.random.Generator, rings: int) -> ScreenTables:
    drawing, side = drawing_with(rings), 25
    steps = np.linspace(-96, 96, side)
    grid = np.zeros((2, 640))
    grid[:, : side * side] = np.array([(x, y) for y in -steps for x in steps]).T
    points = grid[:, : side * side].T
    columns = np.zeros((2, 3, drawing.column_count, 640))
    for k, blur in enumerate((4.0, 9.0)):
        spread = np.tile([blur**2, 0, blur**2], (side * side, 1))
        for j, step in enumerate(([0, 0], [0.05, 0], [0, 0.05])):
            columns[k, j, :, : side * side] = coverage_columns_numpy(drawing, points + step, spread)
        columns[k, 1:] = (columns[k, 1:] - columns[k, 0]) / 0.05
    moves = np.zeros((2, 8, 640))
    u, v = points.T / 180 + 0.5
    shares = ((1 - u) * v, u * v, u * (1 - v), (1 - u) * (1 - v))
    for k, share in enumerate(shares):
        moves[0, 2 * k, : side * side] = moves[1, 2 * k + 1, : side * side] = share
    on = np.linspace(-60, 60, 10)
    gate = np.concatenate([np.stack([on, np.full(10, half)]) for half in (95.0, 85.0, 75.0)], axis=1)
    words = words_with(rng, rings, 1 << (4 * rings))._replace(masks=np.tile(np.arange(1 << (4 * rings)), (4, 1)))
    words = Words.of(words.masks, words.gaps)
    return ScreenTables.of(90.0, grid, side, moves, gate, [4.0, 9.0], columns, words)


# Kernel, definition, arguments, tolerance.
PATTERN_CALLS = [
    (linearize, linearize_numpy, _linearizations, 1e-5),
    (register, register_numpy, _registrations, 5e-4),
    (grid_moments, grid_moments_numpy, _grids, 1e-5),
    (cell_codes, cell_codes_numpy, _codes, 1e-6),
    (robust_weights, robust_weights_numpy, _weightings, 1e-4),
    (decode, decode_numpy, _decodings, 1e-4),
    (sample, sample_numpy, _samplings, 1e-5),
    (where_to_look, where_to_look_numpy, _lookings, 1e-12),
    (noise, noise_numpy, _noises, 1e-12),
    (shadow_edge, shadow_edge_numpy, _shadows, 1e-12),
    (dark_quads, dark_quads_numpy, _quads, 1e-5),
    (screen, screen_numpy, _screenings, 1e-4),
    (likely, likely_numpy, _likely_squares, 1e-4),
]
