"""Calibration boards in images: chessboards, ChArUco boards, boards of landmarks, AprilGrids."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np

from lmkit.arrays import ByteArray, FloatArray, IntArray
from lmkit.detection.april_grids import detect_april_grid
from lmkit.detection.board_corners import refine_corners
from lmkit.detection.charuco_markers import corners_by_markers
from lmkit.detection.config import ACCURATE, DetectOptions
from lmkit.detection.detector import detect_landmarks
from lmkit.model.board import BoardSpec
from lmkit.model.charuco import charuco_board
from lmkit.model.observation import BoardObservation

MIN_CHARUCO_CORNERS = 6
MIN_LANDMARKS = 2
SIZE_CHECK_PX = 1200  # longer side of the images for the search of a chessboard's size
LOOK_PX = 640  # longer side of the copy for the first search of a chessboard
AROUND = 2.0  # of the largest square: margin of the window that is then searched for exact corners
LEAST_LINES = 3  # of inner corners
LEAST_SADDLES = 0.8  # share of a chessboard's corners at which four squares meet
SADDLE_CONTRAST = 0.3  # of opposite quadrants against neighbors, relative to the contrast of all four
BETWEEN = 0.12  # a corner's brightness is so far from both its squares', relative to their contrast; a gap's is not
DRAWN_BLUR_PX, DRAWN_BLUR_SHARE = 1.0, 0.02  # standard deviation, px, and its largest share of a square
COUNTED = r"DICT_\dX\d_\d+"  # names of dictionaries with a number of markers
MIN_MARKERS = 4  # in every image, for another dictionary to be named


def detect_board(image: ByteArray, board: BoardSpec) -> BoardObservation | None:
    """The board in one image, or None.

    Args:
        image: (H,W,3) BGR, 8 bit.
    """
    if board.kind == "landmarks":
        return _detect_landmark_board(image, board)
    if board.kind == "aprilgrid":
        return detect_april_grid(image, board)
    gray = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), dtype=np.uint8)
    if board.kind == "charuco":
        return _detect_charuco(image, gray, board)
    corners = _find_chessboard(gray, board.inner_corners)
    if corners is None:
        return None
    return _refined(gray, np.arange(len(corners)), _dark_first(gray, corners, board.inner_corners), board)


def likelier_board(images: Sequence[ByteArray], board: BoardSpec) -> BoardSpec | None:
    """Another board that fits the images better than ``board``, or None.

    A chessboard that is specified too small is also found inside the true one, so the whole board is searched,
    whatever its size.  For a ChArUco board, the other layout, a rotated one, another first id and the other
    dictionaries are tried.
    """
    grays = [np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), dtype=np.uint8) for image in images]
    if board.kind == "charuco":
        return _likelier_charuco(grays, board)
    if board.is_grid:
        return None
    sizes = Counter(size for gray in grays if (size := grid_size(gray)) is not None)
    given = min(board.inner_corners), max(board.inner_corners)
    if not sizes or sizes[given] == max(sizes.values()):
        return None
    size = sizes.most_common(1)[0][0]
    hides_given = size[0] >= given[0] and size[1] >= given[1]
    if not hides_given and any(
        _find_chessboard(gray, board.inner_corners, thorough=False) is not None for gray in grays
    ):
        return None  # the given board, partly covered in some images
    return _resized(board, size if board.columns < board.rows else (size[1], size[0]))


def grid_size(gray: ByteArray) -> tuple[int, int] | None:
    """Inner corners of the chessboard in an image, the smaller number first, or None."""
    grid = grid_corners(gray)
    return None if grid is None else (min(grid.shape[:2]), max(grid.shape[:2]))


def grid_corners(gray: ByteArray) -> FloatArray | None:
    """(R,C,2) inner corners, pixels, of the chessboard in an image, of any size, or None.

    Lines of corners at which no four squares meet, as on a white rim, are not counted; neither is a grid of other
    things, such as circles.
    """
    scale = min(1.0, SIZE_CHECK_PX / max(gray.shape))
    small = np.asarray(cv2.resize(gray, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_LARGER
    cv2.setRNGSeed(0)  # the search draws random numbers: the same image has the same answer
    # On drawn edges, which no lens has blurred, the search misses one image in ten.
    for image in (small, cv2.GaussianBlur(small, (0, 0), DRAWN_BLUR_PX)):
        found, corners, meta = cv2.findChessboardCornersSBWithMeta(image, (LEAST_LINES, LEAST_LINES), flags)
        if found:
            break
    if not found or corners is None or meta is None:
        return None
    grid = np.asarray(corners, dtype=np.float64).reshape(*meta.shape, 2)
    for _ in range(4):  # each side in turn
        while len(grid) > LEAST_LINES and not _are_saddles(small, grid[0], grid[1], grid[2]):
            grid = grid[1:]
        grid = np.rot90(grid)
    rows, columns = grid.shape[:2]
    is_board = rows * columns > LEAST_LINES**2 and _is_chessboard(small, grid)
    return (grid + 0.5) / scale - 0.5 if is_board else None


def _likelier_charuco(grays: Sequence[ByteArray], board: BoardSpec) -> BoardSpec | None:
    def corners_of(spec: BoardSpec) -> int:
        seen = [_charuco_corners(gray, spec) for gray in grays]
        return sum(len(found[0]) for found in seen if found is not None)

    as_given = corners_of(board)
    turned = replace(board, columns=board.rows, rows=board.columns)
    layouts = [replace(spec, legacy=not spec.legacy) for spec in (board, turned)] + [turned]
    best = max(layouts, key=corners_of)
    if corners_of(best) > 2 * as_given:
        return best
    if as_given:
        return None
    first = min(Counter(_marker_ids(grays, board.dictionary)), default=0)
    if first and corners_of(other := replace(board, first_code=first)):
        return other
    # Markers of another dictionary: the one of which most are seen; small ones first, they hide in large ones.
    names = sorted((n for n in dir(cv2.aruco) if re.fullmatch(COUNTED, n)), key=_dictionary_size)
    counts = {name: _markers_seen(grays, name) for name in names if not _is_within(name, board.dictionary)}
    name = max(names, key=lambda n: counts.get(n, 0))
    return replace(board, dictionary=name) if counts.get(name, 0) >= MIN_MARKERS * len(grays) else None


def _dictionary_size(name: str) -> tuple[str, int]:
    cells, count = name.rsplit("_", 1)
    return cells, int(count)


def _is_within(name: str, dictionary: str) -> bool:
    """Whether all markers of one dictionary are in another: OpenCV's smaller ones are prefixes of larger ones."""
    if not re.fullmatch(COUNTED, dictionary):
        return name == dictionary
    (cells, count), (own_cells, own_count) = _dictionary_size(name), _dictionary_size(dictionary)
    return cells == own_cells and count <= own_count


def _markers_seen(grays: Sequence[ByteArray], name: str) -> int:
    return len(_marker_ids(grays, name))


def _marker_ids(grays: Sequence[ByteArray], name: str) -> list[int]:
    """Ids of the markers of a dictionary in all images."""
    detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name)))
    found = [detector.detectMarkers(gray)[1] for gray in grays]
    return [int(number) for ids in found if ids is not None for number in np.ravel(ids)]


def _resized(board: BoardSpec, size: tuple[int, int]) -> BoardSpec:
    return BoardSpec(board.kind, size[0], size[1], board.square_mm)


def _are_saddles(gray: ByteArray, points: FloatArray, near: FloatArray, nearer: FloatArray) -> bool:
    """Whether four squares meet at most of ``points``, as at the corners of the previous line."""

    height, width = gray.shape
    if ((points < 2) | (points > np.array([width, height]) - 3)).any():
        return False
    known = _saddles(gray, near, np.gradient(near, axis=0), near - nearer)[0]
    here = _saddles(gray, points, np.gradient(points, axis=0), points - near)[0]
    alternating = np.sign(here[1:]) == -np.sign(here[:-1])
    strong = np.abs(here) > 0.4 * np.median(np.abs(known))
    return bool(strong.mean() > 0.8 and alternating.mean() > 0.8)


def _is_chessboard(gray: ByteArray, grid: FloatArray) -> bool:
    """Whether four squares meet at most corners of an (R,C,2) grid, alternately dark and bright.

    Discs set diagonally alternate as squares do, but the gap between two of them is as bright as the paper.
    """
    flat = grid.reshape(-1, 2)
    right, down = (np.gradient(grid, axis=axis).reshape(-1, 2) for axis in (1, 0))
    saddle, darkest, brightest = _saddles(gray, flat, right, down)
    contrast = brightest - darkest
    x, y = np.ascontiguousarray(flat.T[:, :, None], dtype=np.float32)
    # On drawn edges, which no lens has blurred, half a pixel decides whether a corner is dark or bright.
    side_px = float(np.median(np.linalg.norm(right, axis=1)))
    soft = cv2.GaussianBlur(gray, (0, 0), min(DRAWN_BLUR_PX, DRAWN_BLUR_SHARE * side_px))
    center = np.ravel(cv2.remap(soft, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))
    between = np.median((center - darkest) / np.maximum(contrast, 1.0))
    turn = 1 - 2 * (np.indices(grid.shape[:2]).sum(axis=0).ravel() % 2)
    strong = np.abs(saddle) > SADDLE_CONTRAST * contrast
    share = max((strong & (saddle * turn > 0)).mean(), (strong & (saddle * turn < 0)).mean())
    return bool(share > LEAST_SADDLES and BETWEEN < between < 1 - BETWEEN)


def _saddles(
    gray: ByteArray, at: FloatArray, u: FloatArray, v: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Signed measure of equal opposite quadrants and unequal neighbors around each point; darkest, brightest.

    Args:
        u, v: (N,2) sides of the squares at each point, pixels.

    Returns:
        (N,) of each.
    """
    maps = np.array([at + 0.3 * (a * u + b * v) for a, b in ((1, 1), (-1, 1), (-1, -1), (1, -1))], dtype=np.float32)
    quadrants = cv2.remap(
        gray, maps[:, :, 0], maps[:, :, 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    ).astype(np.float64)
    a, b, c, d = quadrants
    unlike = a + c - b - d
    saddle = (unlike - np.maximum(np.abs(a - c), np.abs(b - d)) * np.sign(unlike)) / 2
    return saddle, quadrants.min(axis=0), quadrants.max(axis=0)


def same_orientation(left: BoardObservation, right: BoardObservation, board: BoardSpec) -> BoardObservation:
    """``right`` with its corners in the order of ``left``.

    A chessboard whose numbers of rows and columns differ by an even number (or by 0) looks the same when rotated by
    180 deg, and a square one when rotated by 90 deg.  The cameras of a rig see it nearly the same way up, so the
    order is chosen in which the corners are placed as those of ``left``.  Colors determine the order of other
    chessboards (:func:`detect_board`).
    """
    columns, rows = board.inner_corners
    if (columns + rows) % 2:
        return right
    grid = right.image_points.reshape(rows, columns, 2)
    turns = (0, 1, 2, 3) if rows == columns else (0, 2)
    orders = [np.rot90(grid, k).reshape(-1, 2) for k in turns]
    centered = left.image_points - left.image_points.mean(axis=0)
    best = max(orders, key=lambda points: float((centered * (points - points.mean(axis=0))).sum()))
    return BoardObservation(right.ids, best.copy(), right.noise_px)


def _dark_first(gray: ByteArray, corners: FloatArray, size: tuple[int, int]) -> FloatArray:
    """Corners from that end of a chessboard whose first square is dark, where its colors tell the ends apart."""
    columns, rows = size
    if (columns + rows) % 2 == 0 or min(size) < 2:
        return corners
    grid = corners.reshape(rows, columns, 2)
    ends = [cell.reshape(-1, 2).mean(axis=0) for cell in (grid[:2, :2], grid[-2:, -2:])]
    first, last = (float(cv2.getRectSubPix(gray, (3, 3), (float(x), float(y))).mean()) for x, y in ends)
    return corners if first <= last else corners[::-1].copy()


def _find_chessboard(gray: ByteArray, size: tuple[int, int], thorough: bool = True) -> FloatArray | None:
    """(N,2) corners by the sector-based detector (Duda and Frese 2018), then by the classic one.

    In a large image the window around the board that a smaller copy shows is searched first.

    Both find grids of circles too, which are refused here.
    Shadow-normalized brightness finds more boards, but its corners are twice as noisy: it comes second.
    """
    cv2.setRNGSeed(0)  # the search draws random numbers: the same image has the same answer
    exact = cv2.CALIB_CB_ACCURACY | cv2.CALIB_CB_EXHAUSTIVE
    window = _window_of_chessboard(gray, size) if thorough else None
    if window is not None:
        part = np.ascontiguousarray(gray[window])
        points = _by_sectors(part, part, size, exact)
        if points is not None:
            return np.asarray(points + np.array([window[1].start, window[0].start]))
    looks = [(gray, exact), (gray, cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE)]
    if thorough:
        # On drawn edges, which no lens has blurred, the search misses one image in ten.
        blurred = np.asarray(cv2.GaussianBlur(gray, (0, 0), DRAWN_BLUR_PX), dtype=np.uint8)
        looks += [(gray, 0), (blurred, exact)]
    for image, flags in looks if thorough else looks[1:]:
        points = _by_sectors(image, gray, size, flags)
        if points is not None:
            return points
    for scale in (1, 2) if thorough else ():
        larger = cv2.resize(gray, None, fx=scale, fy=scale, interpolation=cv2.INTER_LINEAR_EXACT)
        flags = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_FAST_CHECK
        found, corners = cv2.findChessboardCorners(larger, size, flags=flags)
        if not found:
            continue
        points = (np.asarray(corners, dtype=np.float64).reshape(-1, 2) + 0.5) / scale - 0.5
        if _is_chessboard(gray, points.reshape(size[1], size[0], 2)):
            return points
    return None


def _window_of_chessboard(gray: ByteArray, size: tuple[int, int]) -> tuple[slice, slice] | None:
    """Rows and columns around the chessboard of a large image, as a smaller copy shows it; None where it shows none.

    The exact search takes five times as long as one without `CALIB_CB_ACCURACY`, and longer the larger the image.
    """
    scale = LOOK_PX / max(gray.shape)
    if scale >= 1:
        return None
    small = cv2.resize(gray, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    found, corners = cv2.findChessboardCornersSB(small, size, flags=0)
    if not found:
        return None
    points = (np.asarray(corners, dtype=np.float64).reshape(-1, 2) + 0.5) / scale - 0.5
    grid = points.reshape(size[1], size[0], 2)
    largest = max(np.linalg.norm(np.diff(grid, axis=axis), axis=2).max() for axis in (0, 1))
    low = np.maximum(points.min(axis=0) - AROUND * largest, 0).astype(int).tolist()
    high = np.ceil(points.max(axis=0) + AROUND * largest).astype(int).tolist()
    return slice(low[1], high[1]), slice(low[0], high[0])


def _by_sectors(image: ByteArray, gray: ByteArray, size: tuple[int, int], flags: int) -> FloatArray | None:
    """(N,2) corners of the chessboard in a version of an image; None without one, or where it is no chessboard."""
    found, corners = cv2.findChessboardCornersSB(image, size, flags=flags)
    if not found:
        return None
    points = np.asarray(corners, dtype=np.float64).reshape(-1, 2)
    return points if _is_chessboard(gray, points.reshape(size[1], size[0], 2)) else None


def _refined(gray: ByteArray, ids: IntArray, corners: FloatArray, board: BoardSpec) -> BoardObservation:
    on_board, square = board.object_points[ids, :2], board.square_mm / 1000
    # The white around a marker is the least that surrounds a corner of a ChArUco board.
    clear = (1 - board.marker_mm / board.square_mm) / 2
    points, noise_px = refine_corners(gray, corners, on_board, square, clear)
    return BoardObservation(ids, points, noise_px)


def _detect_charuco(image: ByteArray, gray: ByteArray, board: BoardSpec) -> BoardObservation | None:
    found = _charuco_corners(gray, board)
    numbers, points = (np.zeros(0, np.int64), np.zeros((0, 2))) if found is None else found
    if len(numbers) < len(board.object_points):
        own = corners_by_markers(image, board)
        numbers, points = max((numbers, points), own, key=lambda corners: len(corners[0]))
    if len(numbers) < MIN_CHARUCO_CORNERS:
        return None
    # Corners on one line give no pose.
    plane = board.object_points[numbers, :2]
    if np.linalg.matrix_rank(plane - plane.mean(axis=0), tol=1e-6) < 2:
        return None
    return _refined(gray, numbers, points, board)


def _charuco_corners(gray: ByteArray, board: BoardSpec) -> tuple[IntArray, FloatArray] | None:
    """Numbers (N,) and pixels (N,2) of the corners, or None where there are too few."""
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_NONE
    detector = cv2.aruco.CharucoDetector(charuco_board(board), cv2.aruco.CharucoParameters(), parameters)
    corners, ids, _, _ = detector.detectBoard(gray)
    if ids is None or len(ids) < MIN_CHARUCO_CORNERS:
        return None
    return np.asarray(ids, dtype=np.int64).ravel(), np.asarray(corners, dtype=np.float64).reshape(-1, 2)


def _detect_landmark_board(image: ByteArray, board: BoardSpec) -> BoardObservation | None:
    seen = [s for s in detect_landmarks(image, DetectOptions(config=ACCURATE)) if s.code in board.codes]
    # A code read twice is once something else.
    once = [s for s in seen if sum(s.code == other.code for other in seen) == 1]
    if len(once) < MIN_LANDMARKS:
        return None
    ids = np.concatenate([4 * (s.code - board.first_code) + np.arange(4) for s in once])
    noise = [float(np.trace(s.covariance)) / 8 for s in once if s.covariance is not None]
    return BoardObservation(ids, np.concatenate([s.corners for s in once]), float(np.sqrt(np.mean(noise))))
