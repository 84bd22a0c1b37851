"""Image capture for a calibration: selects pairs of frames, and proposes the next view."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from lmkit.arrays import ByteArray, FloatArray
from lmkit.calibration.capture_guide import CaptureGuide, Judgment
from lmkit.calibration.view_coverage import ViewCoverage
from lmkit.detection.boards import detect_board
from lmkit.io.board_corners import SavedCorners
from lmkit.io.image_groups import list_pairs
from lmkit.io.image_sources import Frame
from lmkit.io.images import read_image
from lmkit.model.board import BoardSpec
from lmkit.model.observation import BoardObservation, PairView
from lmkit.pipelines.board_views import checked_board, find_board_pairs, pair_view, require_same_size
from lmkit.pipelines.still_frames import StillFrames, still_frames

LONG_IN_VAIN = 50  # frames without the board, after which another board is searched for
ImagePair = tuple[ByteArray, ByteArray]


@dataclass(frozen=True, eq=False)
class Found:
    """Corners of a board found so far.

    Attributes:
        corners: of all pairs.
        images: of some pairs, by name: the two images, or their files.
    """

    corners: SavedCorners
    images: Mapping[str, ImagePair | tuple[Path, Path]]

    def pixels(self, name: str) -> ImagePair:
        """Left and right image of a pair."""
        left, right = (read_image(side) if isinstance(side, Path) else side for side in self.images[name])
        return left, right

    def some_images(self, names: Sequence[str], most: int) -> dict[str, ImagePair]:
        """Images of at most ``most`` of these pairs, evenly spread, by name."""
        known = [name for name in names if name in self.images]
        step = max(1, len(known) // most)
        return {name: self.pixels(name) for name in known[::step][:most]}


@dataclass(frozen=True, eq=False)
class Looked:
    """One pair of frames with its judgment.

    Attributes:
        judgment: whether the pair was kept, or the reason why not.
        left, right: the images.
        found: all pairs kept so far.
        coverage: coverage of the kept pairs, and the missing views.
        ghost: camera (0 left, 1 right) and outline (4,2), pixels, of the board in the wanted next view.
        done: number of processed frames; skipped frames of a video included.
    """

    judgment: Judgment
    left: ByteArray
    right: ByteArray
    found: Found
    coverage: ViewCoverage
    ghost: tuple[int, FloatArray] | None = None
    done: int = 0


def look_at_frames(
    pairs: Iterable[tuple[Frame, Frame]], board: BoardSpec, moving: bool, until_complete: bool = True
) -> Iterator[Looked]:
    """Judge pair after pair until the views are complete; in videos only the stillest frame of every 0.2 s.

    Args:
        moving: see :class:`lmkit.calibration.capture_guide.CaptureGuide`.
        until_complete: end when the views are complete; False for a caller with its own condition.

    Raises:
        InputError: an image that cannot be read, one camera's images of different sizes, or of another board.
    """
    looking = _SpecCheck(board)
    guide: CaptureGuide | None = None
    images: dict[str, ImagePair] = {}
    sizes = ((0, 0), (0, 0))
    looks = still_frames(pairs) if moving else (StillFrames(k, pair) for k, pair in enumerate(pairs))
    for still in looks:
        one, other = still.frames
        left, right = one.pixels, other.pixels
        if guide is None:
            sizes = ((left.shape[1], left.shape[0]), (right.shape[1], right.shape[0]))
            guide = CaptureGuide(board.object_points, sizes[0], moving, sizes[1])
        for frame, image, size in zip((one, other), (left, right), sizes, strict=True):
            require_same_size(frame.name, (image.shape[1], image.shape[0]), size)
        name = f"{len(guide.views) + 1:03d}" if moving else Path(one.name).stem
        in_left = looking.detect(left)
        board = looking.board
        # Without a board in one camera, the other image is not searched.
        in_right = None if in_left is None else detect_board(right, board)
        view = pair_view(name, in_left, in_right, board)
        before = None if still.before is None else partial(_view_before, still.before, board)
        judgment = guide.judge(None if isinstance(view, str) else view, before)
        if judgment.kept:
            images[name] = (left, right)
        coverage = guide.coverage
        corners = SavedCorners(board, sizes[0], guide.views, (), sizes[1])
        found = Found(corners, images)
        yield Looked(judgment, left, right, found, coverage, guide.ghost(coverage), still.number + 1)
        if until_complete and not coverage.advice:
            return
    looking.end()


def _view_before(frames: Sequence[Frame], board: BoardSpec) -> PairView | None:
    left, right = (detect_board(frame.pixels, board) for frame in frames)
    view = pair_view("before", left, right, board)
    return None if isinstance(view, str) else view


class _SpecCheck:
    """Detects the board, and checks once, at the first detection or at the end, for another board."""

    def __init__(self, board: BoardSpec) -> None:
        self.board = board
        self._last: ByteArray | None = None
        self._in_vain = 0
        self._done = False

    def detect(self, image: ByteArray) -> BoardObservation | None:
        """The board in the image."""
        seen = detect_board(image, self.board)
        self._last, self._in_vain = image, self._in_vain + 1
        if not self._done and (seen is not None or self._in_vain == LONG_IN_VAIN):
            self.end()
            seen = detect_board(image, self.board)
        return seen

    def end(self) -> None:
        """Check by the last image.

        Raises:
            InputError: it shows another board.
        """
        if not self._done and self._last is not None:
            self._done = True
            self.board = checked_board([self._last], self.board)


def find_in_files(
    left: str, right: str, board: BoardSpec, on_pair: Callable[[int, int], None] = lambda done, total: None
) -> Found:
    """Find the board in pairs of files.

    Args:
        left, right: folders or globs, paired by sorted name.
        on_pair: called with the number of finished pairs and of all pairs.

    Raises:
        InputError: no pairs, an unreadable image, or another board.
    """
    pairs = find_board_pairs(list_pairs(left, right), board, on_pair)
    corners = SavedCorners(pairs.board, pairs.image_size, pairs.views, pairs.rejected, pairs.right_size)
    return Found(corners, pairs.files)
