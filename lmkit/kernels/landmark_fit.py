"""The complete fit of one landmark in one call: sampling, decoding and registration, until the code is stable.

`lmkit.detection.register_and_decode` has the definition, step by step, with the kernels that this kernel calls.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lmkit.kernels.covering import Covering, CoveringRules
from lmkit.kernels.hypotheses import HEAD, TAIL, Decoded, DecodingRules, Words
from lmkit.kernels.lens import Lens
from lmkit.kernels.load import address, addresses, contiguous, function
from lmkit.kernels.mosaic import MosaicRules
from lmkit.kernels.pattern import INKS, Drawing
from lmkit.kernels.pixel_sampling import VISITED, Edges, Source
from lmkit.kernels.plane import STATE, View
from lmkit.kernels.registration import BLOCK, Limits, Priors, Steps, scratch_floats
from lmkit.kernels.shadow_edge import BINS, Split, room_for_edge
from lmkit.kernels.workspace import Workspace

FloatArray = NDArray[np.floating[Any]]

READ, FINISH = 1, 2  # phases
NORMAL = 3  # index of the normal matrix in the results


class Promising(NamedTuple):
    """Least margins and colors of a decoding for a registration."""

    correlated_pixels: float
    turn_margin: float
    pattern: float
    red_over_blue: float
    least_contrast: float


class Settled(NamedTuple):
    """Least margins of a stable decoding for the last steps, without shadow normalization.

    A turn margin over ``clear`` is sufficient alone.
    """

    code_margin: float
    turn_margin: float
    clear: float


class Start(NamedTuple):
    """Initial blur of a fit: at least a number of px, or a share of the side up to a largest number of px."""

    least_blur: float
    blur_share: float
    blurred_side: float


class CornerErrors(NamedTuple):
    """Errors of corners, px, that are not in the residuals.

    Attributes:
        least: least error of every coordinate, for any residuals.
        few_edges: side at which the error from few edges equals the others.
        mosaic: period of the color mosaic, px.
        growth, full: factor of the variance, and the scatter with the full factor; below, the factor is proportional.
        stretch: error of width and height, as a share of the scatter.
    """

    least: float
    few_edges: float
    mosaic: float
    growth: float
    full: float
    stretch: float


class RivalRules(NamedTuple):
    """Parameters for the fit of rivals of a reading.

    Attributes:
        rivals: number of rivals.
        most, to_px, negligible: most steps of a fit, and the motion and the decrease of chi2 at which it ends.
        hopeless, by_error: rivals are skipped if their margin is over ``hopeless`` and over this multiple of the
            reading's error.
    """

    rivals: int
    most: int
    to_px: float
    negligible: float
    hopeless: float
    by_error: float


class Rivals(NamedTuple):
    """Errors per value of a reading and of its best rival, and the number of pixels; None without a close rival."""

    pixels: int
    error: float
    rivals_error: float | None


class LightEdge(NamedTuple):
    """An edge in the logarithm of the light on a landmark; (2,) least and largest positions of its pixels, px."""

    split: Split
    low: FloatArray
    high: FloatArray


class FitRules(NamedTuple):
    """Parameters for the fit of a landmark.

    Attributes:
        reach, paper: half sides of the sampled square, and of the square that is certainly paper, mm.
        band: distance from an edge within which a pixel is near it, px, times the side of the face, mm.
        near_share: share of pixels near edges in the last steps; at first they are thinned evenly.
        least_pixels: least number of pixels for a reading.
        coarse_pixels, pixels: number of pixels at first, and in the last steps.
        read_rounds: largest number of changes of the code.
        coarse, fine: registration at first, and in the last steps.
        channel_weights: factors of blue, green and red values in the last steps.
        mosaic: weights of values interpolated from a color mosaic, in the last steps.
    """

    reach: float
    paper: float
    band: float
    near_share: float
    least_pixels: int
    coarse_pixels: int
    pixels: int
    read_rounds: int
    coarse: Steps
    fine: Steps
    decoding: DecodingRules
    priors: Priors
    limits: Limits
    promising: Promising
    settled: Settled
    start: Start
    errors: CornerErrors
    channel_weights: tuple[float, float, float]
    mosaic: MosaicRules
    floor: float = 1e-8


class Fitted(NamedTuple):
    """Result of a fit.

    Attributes:
        state: (15,) where it ended.
        pixels: number of them.
        error: per value, of the last registration.
        normal: (15,15) J'WJ of the registration with all pixels; 0 before.
        plain, robust: decodings with the pixels' own weights, and with outliers down-weighted, without their
            parts; None if the pixels do not determine the inks.
        corners: (4,2) in the image, distortion and all; ``covariance``: (8,8) px^2.  Both once all pixels are used.
    """

    state: FloatArray
    pixels: int
    error: float
    normal: FloatArray
    plain: Decoded | None
    robust: Decoded | None
    corners: FloatArray
    covariance: FloatArray


class _Steps(ctypes.Structure):
    _fields_ = (
        ("rounds", ctypes.c_int64),
        ("most", ctypes.c_int64),
        ("to_px", ctypes.c_double),
        ("negligible", ctypes.c_double),
    )


class _Fit(ctypes.Structure):
    _fields_ = (
        *((name, ctypes.c_int64) for name in ("height", "width")),
        *((name, ctypes.c_void_p) for name in ("image", "linear", "white", "shift", "lens")),
        *((name, ctypes.c_void_p) for name in ("drawing", "edges", "masks")),
        *((name, ctypes.c_int64) for name in ("squares", "circles", "codes", "gaps")),
        *((name, ctypes.c_int64) for name in ("visited", "least_pixels", "coarse_pixels", "pixels", "read_rounds")),
        ("coarse", _Steps),
        ("fine", _Steps),
        *((name, ctypes.c_double) for name in ("skew", "reach", "band", "near_share", "noise", "floor", "paper")),
        ("decoding", ctypes.c_double * 9),
        ("priors", ctypes.c_double * 6),
        ("limits", ctypes.c_double * 5),
        ("promising", ctypes.c_double * 5),
        ("settled", ctypes.c_double * 3),
        ("start", ctypes.c_double * 3),
        ("errors", ctypes.c_double * 6),
        ("channel_weights", ctypes.c_double * 3),
        ("color_mosaic", ctypes.c_double * 4),
    )


class FitTask:
    """Parameters for landmarks of one drawing, independent of the image; packed once.

    Attributes:
        rules: parameters of the fit.
        masks: open gaps of all codes.
    """

    def __init__(self, drawing: Drawing, words: Words, edges: Edges, rules: FitRules) -> None:
        self.rules, self.masks = rules, words.masks
        known = np.array([*edges.squares, *edges.circles], np.float32)
        gaps = len(drawing.gaps)
        self._arrays = (drawing.flat, known, words.masks)  # kept alive, so that their addresses stay valid
        self.packed = _Fit(
            *[0] * 2,
            *[None] * 5,
            *addresses(*self._arrays),
            *(len(edges.squares), len(edges.circles), words.masks.shape[1], gaps),
            *(VISITED, rules.least_pixels, rules.coarse_pixels, rules.pixels, rules.read_rounds),
            *(
                _Steps(steps.rounds, steps.most, steps.to_px, steps.negligible)
                for steps in (rules.coarse, rules.fine)
            ),
            *(0.0, rules.reach, rules.band, rules.near_share, 0.0, rules.floor, rules.paper),
            *map(_numbers, (rules.decoding.flat, rules.priors, rules.limits, rules.promising)),
            *map(_numbers, (rules.settled, rules.start, rules.errors, rules.channel_weights, rules.mosaic)),
        )
        self.most = most = max(rules.pixels, rules.coarse_pixels)
        self.capacity = capacity = most + most // 5 + 64
        self.decoding = TAIL + 2 * (2 + gaps)
        self.room = (
            ("planes", 9 * capacity),
            ("work", max(scratch_floats(capacity), (capacity + BLOCK) * drawing.column_count + 3 * capacity)),
            ("subsets", 2 * (7 << gaps)),
        )


class LandmarkFit:
    """Fits landmarks of one drawing in one image.

    Attributes:
        view: geometry of the image; its origin is not used.
    """

    def __init__(
        self, task: FitTask, source: Source, view: View, lens: Lens | None, skew: float, noise: float
    ) -> None:
        self.view = view
        struct = None if lens is None else lens.struct
        self._kept = (task, source, struct)
        self._task = packed = _Fit.from_buffer_copy(task.packed)
        packed.height, packed.width = source.image.shape[:2]
        packed.image, packed.linear, packed.white, packed.shift = addresses(*source)
        packed.lens = None if struct is None else ctypes.addressof(struct)
        packed.skew, packed.noise = skew, noise
        self._capacity, self._decoding = task.capacity, task.decoding
        self._width = NORMAL + STATE * STATE + 2 * task.decoding + 8 + 64
        planes, work, subsets = task.room
        self._room = (planes, work, ("kinds", VISITED * task.most // 2 + (packed.height + 8) // 2), subsets)

    def run(
        self,
        view: View,
        state: FloatArray,
        fit_distortion: bool,
        phases: int = READ | FINISH,
        so_far: Fitted | None = None,
    ) -> Fitted | None:
        """Fit from a (15,) state; None without a landmark, or with too little of it.

        Args:
            phases: ``READ`` until the code is stable, ``FINISH`` with all pixels, or both.
            so_far: result of ``READ``, for ``FINISH`` alone.
        """
        kernel = _kernel()
        assert kernel is not None
        out = np.zeros(self._width)
        if so_far is not None and so_far.plain is not None:
            out[NORMAL + STATE * STATE :][:2] = so_far.plain.turn, so_far.plain.code
        moved = np.array(state, dtype=np.float64)
        rooms = [WORKSPACE.floats(*room) for room in self._room]
        task = ctypes.addressof(self._task)
        status = kernel(
            task, address(view.flat), phases, fit_distortion, self._capacity, *rooms, address(moved), address(out)
        )
        return None if status else self._fitted(moved, out)

    def run_all(self, quads: FloatArray, distortion_side: float) -> list[Fitted]:
        """Fits from all squares (N,4,2); squares without a landmark are omitted.

        Args:
            distortion_side: for squares with a larger side, the distortion is also fitted.
        """
        kernel = _all_kernel()
        assert kernel is not None
        quads, width = contiguous(quads, (-1, 4, 2)), 1 + STATE + self._width
        rows = np.zeros((len(quads), width))
        rooms = [WORKSPACE.floats(*room) for room in self._room]
        task, first = ctypes.addressof(self._task), address(rows)
        view = address(self.view.flat)
        kernel(task, view, len(quads), address(quads), distortion_side, self._capacity, *rooms, width, first)
        fitted = zip(rows, rows[:, 0].tolist(), strict=True)
        return [self._fitted(row[1 : 1 + STATE], row[1 + STATE :]) for row, is_fitted in fitted if is_fitted]

    def run_rivals(self, state: FloatArray, turn: int, code: int, rules: RivalRules) -> Rivals | None:
        """The reading of a quarter turn and a code, and its rivals, from a (15,) state; None with too few pixels."""
        kernel = _rivals_kernel()
        assert kernel is not None
        masks, moved, out = self._kept[0].masks.copy(), np.array(state, dtype=np.float64), np.empty(3)
        rooms = [WORKSPACE.floats(*room) for room in self._room]
        task = ctypes.addressof(self._task)
        ends = addresses(masks, moved, out)
        status = kernel(task, address(self.view.flat), turn, code, *rules, self._capacity, *rooms, *ends)
        return None if status else Rivals(int(out[0]), float(out[1]), float(out[2]) if out[2] >= 0 else None)

    def run_covering(self, state: FloatArray, turn: int, code: int, rules: CoveringRules) -> Covering | None:
        """The reading of a turn and a code, at a (15,) state, compared with others behind an object; else None."""
        kernel = _covering_kernel()
        assert kernel is not None
        state, results, out = np.array(state, dtype=np.float64), np.empty(HEAD), np.empty(2)
        rooms = [WORKSPACE.floats(*room) for room in self._room]
        ends = addresses(state, results, out)
        task = ctypes.addressof(self._task)
        status = kernel(task, address(self.view.flat), turn, code, *rules, self._capacity, *rooms, *ends)
        return None if status else Covering(float(out[0]), float(out[1]))

    def run_shadow_edge(
        self, view: View, state: FloatArray, turn: int, code: int, normals: FloatArray
    ) -> LightEdge | None:
        """The edge of the light on the landmark, at a (15,) state of the reading of a quarter turn and a code.

        Args:
            normals: (D,2) directions across the edge.
        """
        kernel = _shadow_edge_kernel()
        assert kernel is not None
        normals, out = contiguous(normals, (-1, 2)), np.empty(8)
        rooms = [WORKSPACE.floats(*room) for room in self._room]
        room = WORKSPACE.floats("edge", 2 * (6 * self._capacity + room_for_edge(self._capacity)))
        task, ends = ctypes.addressof(self._task), (address(state), room, address(out))
        directions = len(normals), address(normals), BINS
        status = kernel(task, address(view.flat), turn, code, *directions, self._capacity, *rooms, *ends)
        return None if status else LightEdge(Split.of(out), out[4:6], out[6:])

    def _fitted(self, state: FloatArray, out: FloatArray) -> Fitted:
        first = NORMAL + STATE * STATE
        second, end = first + self._decoding, first + 2 * self._decoding
        plain, robust = _decoded(out[first:second]), _decoded(out[second:end])
        normal, corners = out[NORMAL:first].reshape(STATE, STATE), out[end : end + 8].reshape(4, 2)
        covariance = out[end + 8 :].reshape(8, 8)
        return Fitted(state, int(out[0]), float(out[1]), normal, plain, robust, corners, covariance)


WORKSPACE = Workspace()


def is_compiled() -> bool:
    """Whether the kernel is available; without it, callers run the steps one by one."""
    return _kernel() is not None


def _decoded(out: FloatArray) -> Decoded | None:
    if out[0] < 0:
        return None
    parts = out[TAIL:].reshape(2, -1)
    turn, code, left, by_code, by_turn, by_frame = out[:6].tolist()
    inks = out[6:HEAD].reshape(INKS, 3)
    evidence, foreign = out[HEAD:TAIL].tolist()
    return Decoded(
        int(turn), int(code), left, by_code, by_turn, by_frame, inks, evidence, foreign, parts[0], parts[1]
    )


def _numbers(numbers: Sequence[float]) -> Any:
    return (ctypes.c_double * len(numbers))(*numbers)


@lru_cache(maxsize=1)
def _kernel() -> Any:
    p, n = ctypes.c_void_p, ctypes.c_int64
    return function("lmkit_fit_landmark", p, p, n, n, n, *[p] * 6)


@lru_cache(maxsize=1)
def _all_kernel() -> Any:
    p, n, d = ctypes.c_void_p, ctypes.c_int64, ctypes.c_double
    return function("lmkit_fit_landmarks", p, p, n, p, d, n, *[p] * 4, n, p)


@lru_cache(maxsize=1)
def _rivals_kernel() -> Any:
    p, n, d = ctypes.c_void_p, ctypes.c_int64, ctypes.c_double
    return function("lmkit_fit_rivals", p, p, n, n, n, n, d, d, d, d, n, *[p] * 7)


@lru_cache(maxsize=1)
def _covering_kernel() -> Any:
    p, n, d = ctypes.c_void_p, ctypes.c_int64, ctypes.c_double
    return function("lmkit_fit_covering", p, p, n, n, d, d, n, *[p] * 7)


@lru_cache(maxsize=1)
def _shadow_edge_kernel() -> Any:
    p, n = ctypes.c_void_p, ctypes.c_int64
    return function("lmkit_fit_shadow_edge", p, p, n, n, n, p, n, n, *[p] * 7)
