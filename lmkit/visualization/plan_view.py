"""A room from above: landmarks, true poses, estimated poses with 95 % ellipses; as PNG or SVG."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lmkit.arrays import BoolArray, ByteArray, FloatArray
from lmkit.geometry.pose import Pose
from lmkit.model.landmark import FAMILIES
from lmkit.model.landmark_map import LandmarkMap, MappedLandmark
from lmkit.visualization.canvas import Canvas, PngCanvas, Rgb, SvgCanvas
from lmkit.visualization.labels import LabelPlacer, line_parts_inside, text_width

MOST_PIXELS_PER_M = 150.0
AROUND_M = 0.6  # free space around the drawing without a room
ON_RIM_M = 0.05  # landmarks on the outermost wall of a floor are just outside its last cell
SEEN_PX = 6.0  # ellipses are enlarged until the median has this size
LARGEST_SEEN_PX, LARGEST_SHARE = 120.0, 1 / 8  # largest ellipse, also as a share of the shorter side
GAINS = (1.0, 10.0, 100.0)
CHI2_2D_95 = 5.991
OFF_WALL_PX = 9  # distance of a drawn landmark from its wall
CODE_PX, BEYOND_PX = 15.0, 20.0  # height of codes, and their distance from the wall
ASIDE_PX, FARTHER_PX = (0.0, 14.0, -14.0, 28.0, -28.0), (0.0, 10.0, 22.0, 36.0)  # other places for a label
LEGEND_PX, LEGEND_ROW_PX, UNDER_PX = 78, 26, 34  # below the plan, between rows, below the last row
TITLE_PX = 19.0
SAME_PLACE_M = 0.05
UPRIGHT = 0.3  # length in the plan of the normal of a landmark on a wall; shorter on floors and ceilings

ROOM, WALL, INK = (255, 255, 255), (70, 74, 80), (40, 42, 46)
RED, BLUE, GREEN, ORANGE = (237, 28, 36), (0, 84, 166), (34, 139, 72), (226, 120, 20)
GRID, FAINT = (232, 234, 236), (140, 144, 150)


@dataclass(frozen=True)
class PlanSize:
    """Size of a plan; text and symbols have the same size in all plans.

    Attributes:
        largest_px: length of the longer side of the room.
        margin_px: margin around the room.
        least_width_px: least width of the drawing, for the title and legend of narrow rooms.
    """

    largest_px: float
    margin_px: int
    least_width_px: int


FILE_SIZE, PAGE_SIZE, PHONE_SIZE = PlanSize(1500.0, 90, 960), PlanSize(900.0, 60, 720), PlanSize(400.0, 45, 440)


@dataclass(frozen=True, eq=False)
class Found:
    """A pose to draw.

    Attributes:
        label: text beside it.
        pose: of a camera (it looks along its z axis) in the map.
        covariance: (2,2) of x y, or None.
        sure: False if the images allow another pose.
    """

    label: str
    pose: Pose
    covariance: FloatArray | None = None
    sure: bool = True


@dataclass(frozen=True, eq=False)
class Underlay:
    """An image of the floor below everything else.

    Attributes:
        rgb: (h,w,3) 0..255, its first row at the highest y.
        low, high: (x, y) of its corners, meters.
        legend: meaning of its colors.
        gridded: (h,w) cells with the grid drawn over them; None: all.
    """

    rgb: ByteArray
    low: tuple[float, float]
    high: tuple[float, float]
    legend: tuple[tuple[Rgb, str], ...] = ()
    gridded: BoolArray | None = None


@dataclass(frozen=True, eq=False)
class Polyline:
    """A line to draw.

    Attributes:
        points: (N,2) meters.
        color, width: of the line.
        legend: text beside the color in the legend.
    """

    points: FloatArray
    color: Rgb
    legend: str
    width: float = 4


@dataclass(frozen=True)
class Note:
    """A word at a place of the map, meters."""

    text: str
    at: tuple[float, float]


def draw_plan(
    landmarks: LandmarkMap,
    found: Sequence[Found],
    truth: Sequence[Pose] = (),
    size_m: tuple[float, float] | None = None,
    title: str = "",
    kind: str = "png",
    underlay: Underlay | None = None,
    polylines: Sequence[Polyline] = (),
    notes: Sequence[Note] = (),
    size: PlanSize = FILE_SIZE,
) -> bytes:
    """The bytes of a PNG or SVG file.

    Args:
        truth: true poses of the camera.
        size_m: (x, y) extent of the room, whose corner is the map's origin; None: extent of the drawing, and some
            space.
        kind: ``png`` or ``svg``.
        underlay: the floor; items outside it enlarge the extent.
        polylines, notes: lines and words on top.
        size: of the drawing.
    """
    low, high = (0.0, 0.0), size_m or (0.0, 0.0)
    if size_m is None:
        low, high = _extent(landmarks, [f.pose for f in found] + list(truth), polylines, underlay)
    scale = min(MOST_PIXELS_PER_M, size.largest_px / max(high[0] - low[0], high[1] - low[1]))
    width, height = (round((high[axis] - low[axis]) * scale) + 2 * size.margin_px for axis in (0, 1))
    width = max(width, size.least_width_px)
    of_poses = [f.covariance for f in found if f.covariance is not None and f.sure]
    of_landmarks = [landmark.covariance[:2, :2] for landmark in landmarks if landmark.covariance is not None]
    largest = min(LARGEST_SEEN_PX, LARGEST_SHARE * scale * min(high[axis] - low[axis] for axis in (0, 1)))
    gain = _gain(of_poses, of_landmarks, scale, largest)
    colors = [*(underlay.legend if underlay else ()), *((line.color, line.legend) for line in polylines)]
    rows = _legend_rows([*colors, *_legend(landmarks, found, truth, gain)], width, size.margin_px)
    drawn = (width, height - size.margin_px + LEGEND_PX + LEGEND_ROW_PX * (len(rows) - 1) + UNDER_PX)
    canvas: Canvas = SvgCanvas(drawn) if kind == "svg" else PngCanvas(drawn)
    plan = _Plan(canvas, low, high, scale, size.margin_px)
    plan.room(size_m is not None, underlay)
    for line in polylines:
        plan.line([plan.at(point) for point in line.points], line.color, line.width)
    for landmark in landmarks:
        if landmark.covariance is not None:
            plan.ellipse(landmark.T_map_landmark.t, landmark.covariance[:2, :2], gain, FAINT)
        plan.landmark(landmark)
    for true in truth:
        plan.camera(true, GREEN, 3)
    for one in found:
        if not one.sure:
            plan.camera(one.pose, FAINT, 1)
    for one in found:
        if one.sure:
            plan.camera(one.pose, ORANGE, 2)
            if one.covariance is not None:
                plan.ellipse(one.pose.t, one.covariance, gain)
    # Words come last: they avoid all drawn items.
    for pose, some in _over_each_other(landmarks):
        plan.codes(pose, _codes(some, landmarks))
    for note in notes:
        plan.note(note)
    for one in found:
        if one.sure:
            plan.pose_label(one)
    plan.words(title, rows)
    return canvas.file()


def _legend(
    landmarks: LandmarkMap, found: Sequence[Found], truth: Sequence[Pose], gain: float
) -> list[tuple[Rgb, str]]:
    """Colors of landmarks and poses, and their meaning."""
    families = {landmark.family for landmark in landmarks}
    legend: list[tuple[Rgb, str]] = []
    enlarged = "" if gain == 1 else f", {gain:g} times enlarged"
    if any(landmark.covariance is not None for landmark in landmarks):
        legend.append((FAINT, f"landmark's 95 % ellipse{enlarged}"))
    if found:
        legend.append((ORANGE, f"found, 95 % ellipse{enlarged}"))
    if truth:
        legend.append((GREEN, "true pose"))
    if not all(f.sure for f in found):
        legend.append((FAINT, "ambiguous"))
    if not families:
        return legend
    ink = RED if families & FAMILIES.keys() else INK
    of_family = f" ({next(iter(families))})" if ink == INK and len(families) == 1 else ""
    sizes = " (size)" if len({round(1000 * landmark.size_m) for landmark in landmarks}) > 1 else ""
    return [*legend, (ink, f"landmark and its {'id' if len(families) > 1 else 'code'}{sizes}{of_family}")]


def _legend_rows(legend: Sequence[tuple[Rgb, str]], width: int, margin_px: int) -> list[list[tuple[float, Rgb, str]]]:
    """Rows of the legend: start of each entry (pixels from the left), its color and its text."""
    rows: list[list[tuple[float, Rgb, str]]] = [[]]
    x = float(margin_px)
    for color, text in legend:
        needed = 34 + text_width(text, CODE_PX)
        if rows[-1] and x + needed > width - margin_px / 2:
            rows.append([])
            x = float(margin_px)
        rows[-1].append((x, color, text))
        x += needed + 22
    return rows


def _over_each_other(landmarks: LandmarkMap) -> list[tuple[Pose, list[MappedLandmark]]]:
    """Landmarks at the same place of the plan, with one pose for all."""
    places: list[tuple[Pose, list[MappedLandmark]]] = []
    for landmark in landmarks:
        here = landmark.T_map_landmark
        for there, some in places:
            if np.linalg.norm(here.t[:2] - there.t[:2]) < SAME_PLACE_M and here.R[:, 2] @ there.R[:, 2] > 0:
                some.append(landmark)
                break
        else:
            places.append((here, [landmark]))
    return places


def _codes(some: Sequence[MappedLandmark], landmarks: LandmarkMap) -> str:
    """Codes, with the family or size if these differ in the map."""
    several = len({landmark.family for landmark in landmarks}) > 1
    sizes = len({round(1000 * landmark.size_m) for landmark in landmarks}) > 1
    words = []
    for landmark in some:
        size = f" ({1000 * landmark.size_m:.0f} mm)" if sizes else ""
        words.append(f"{landmark.id if several else landmark.code}{size}")
    return ", ".join(words)


def _extent(
    landmarks: LandmarkMap, poses: Sequence[Pose], polylines: Sequence[Polyline], underlay: Underlay | None
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Lowest and highest x, y of the floor and of items outside it, with some space around the items; meters."""
    places = [landmark.T_map_landmark.t[:2] for landmark in landmarks] + [pose.t[:2] for pose in poses]
    points = np.array([*places, *(point[:2] for line in polylines for point in line.points)]).reshape(-1, 2)
    if underlay is not None:
        floor = np.array([underlay.low, underlay.high])
        outside = (points < floor[0] - ON_RIM_M) | (points > floor[1] + ON_RIM_M)
        points = points[outside.any(axis=1)]
        ends = np.array([*(points - AROUND_M), *(points + AROUND_M), *floor])
    else:
        ends = np.array([*(points - AROUND_M), *(points + AROUND_M)])
    low, high = ends.min(axis=0), ends.max(axis=0)
    return (float(low[0]), float(low[1])), (float(high[0]), float(high[1]))


def _gain(
    of_poses: Sequence[FloatArray], of_landmarks: Sequence[FloatArray], scale: float, largest_px: float
) -> float:
    """Scale that makes ellipses visible, from the covariances (2,2) of poses and of landmarks."""
    groups = [
        [np.sqrt(max(np.linalg.eigvalsh(c)[-1], 0.0) * CHI2_2D_95) * scale for c in group]
        for group in (of_poses, of_landmarks)
        if group
    ]
    if not groups:
        return 1.0
    seen = next((gain for gain in GAINS if gain * np.median(np.concatenate(groups)) >= SEEN_PX), GAINS[-1])
    # Large ellipses must not hide the room, nor those of few landmarks among many poses.
    large = max(np.percentile(sizes, 95) for sizes in groups)
    return max([gain for gain in GAINS if gain <= seen and gain * large < largest_px], default=1.0)


class _Plan:
    """Meters on paper: x to the right, y up."""

    def __init__(
        self, canvas: Canvas, low: tuple[float, float], high: tuple[float, float], scale: float, margin_px: int
    ) -> None:
        self.canvas, self.low, self.high, self.scale, self.margin_px = canvas, low, high, scale, margin_px
        self.bottom = margin_px + round((high[1] - low[1]) * scale)
        self.labels = LabelPlacer()

    def at(self, xy: FloatArray) -> tuple[float, float]:
        x = self.margin_px + (float(xy[0]) - self.low[0]) * self.scale
        return x, self.bottom - (float(xy[1]) - self.low[1]) * self.scale

    def line(self, points: Sequence[tuple[float, float]], color: Rgb, width: float) -> None:
        """A line that labels must not cover."""
        self.canvas.line(points, color, width)
        self.labels.keep_line(points)

    def room(self, walls: bool, underlay: Underlay | None) -> None:
        a, b = self.at(np.array([self.low[0], self.high[1]])), self.at(np.array([self.high[0], self.low[1]]))
        self.canvas.box(a, b, ROOM)
        self._grid(None)
        if underlay is not None:
            (left, below), (right, above) = underlay.low, underlay.high
            self.canvas.image(self.at(np.array([left, above])), self.at(np.array([right, below])), underlay.rgb)
            self._grid(underlay)
        rim = [a, (b[0], a[1]), b, (a[0], b[1]), a, (b[0], a[1])]
        self.canvas.line(rim, WALL if walls else GRID, 5 if walls else 1)

    def _grid(self, underlay: Underlay | None) -> None:
        for axis in (0, 1):
            for meter in range(int(np.ceil(self.low[axis] + 1e-9)), int(np.ceil(self.high[axis]))):
                self._grid_line(axis, meter, underlay)

    def _grid_line(self, axis: int, meter: int, underlay: Underlay | None) -> None:
        """A line of the grid, only where the underlay allows it."""
        ends = np.array([self.low, self.high])
        ends[:, axis] = meter
        if underlay is None or underlay.gridded is None:
            self.canvas.line([self.at(end) for end in ends], GRID, 1)
            return
        gridded = underlay.gridded[::-1]
        cell = (underlay.high[0] - underlay.low[0]) / gridded.shape[1]
        if not underlay.low[axis] <= meter <= underlay.high[axis]:
            return
        across = min(int((meter - underlay.low[axis]) / cell), gridded.shape[1 - axis] - 1)
        shown = gridded[:, across] if axis == 0 else gridded[across]
        edges = np.flatnonzero(np.diff(np.concatenate([[0], shown.astype(np.int8), [0]])))
        for start, stop in zip(edges[::2], edges[1::2], strict=True):
            ends[:, 1 - axis] = underlay.low[1 - axis] + np.array([start, stop]) * cell
            self.canvas.line([self.at(end) for end in ends], GRID, 1)

    def landmark(self, landmark: MappedLandmark) -> None:
        """A bar on the landmark's own side of its wall, in the colors of its family."""
        pose, size_m = landmark.T_map_landmark, landmark.size_m
        border, ground = (RED, BLUE) if landmark.family in FAMILIES else (INK, ROOM)
        # Across the normal, so that a landmark that is rotated on its wall is as wide as any other.
        across = np.array([-pose.R[1, 2], pose.R[0, 2]])
        along = across if np.linalg.norm(across) > UPRIGHT else pose.R[:2, 0]
        along = along / max(float(np.linalg.norm(along)), 1e-9)
        inset = 0.02 if landmark.family in FAMILIES else 0.2
        middle = pose.t[:2] + OFF_WALL_PX / self.scale * pose.R[:2, 2]
        a, b = middle - along * size_m / 2, middle + along * size_m / 2
        self.line([self.at(a), self.at(b)], border, 12)
        self.labels.keep_box(self.at(middle), 14, 14)
        self.canvas.line([self.at(a + inset * (b - a)), self.at(b - inset * (b - a))], ground, 6)

    def codes(self, pose: Pose, label: str) -> None:
        """Codes beside the landmark, on the side from which it is seen."""
        x, y = self.at(pose.t[:2])
        out = np.array([pose.R[0, 2], -pose.R[1, 2]])  # in the drawing, y down
        out = out / np.linalg.norm(out) if np.linalg.norm(out) > UPRIGHT else np.array([0.0, -1.0])
        half = abs(out[0]) * text_width(label, CODE_PX) / 2 + abs(out[1]) * CODE_PX / 2
        across = np.array([-out[1], out[0]])
        steps = [(far, aside) for far in FARTHER_PX for aside in ASIDE_PX]
        places = [np.array([x, y]) + (BEYOND_PX + half + far) * out + aside * across for far, aside in steps]
        candidates = [(float(place[0]), float(place[1])) for place in places]
        self._word(label, CODE_PX, candidates, True)

    def pose_label(self, found: Found) -> None:
        """The name of a pose beside it, if there is space."""
        x, y = self.at(found.pose.t[:2])
        back = np.array([-found.pose.R[0, 2], found.pose.R[1, 2]])
        wide = text_width(found.label, 14) / 2 + 16
        around = [(x + 30 * back[0], y + 30 * back[1]), (x, y - 26), (x, y + 26), (x + wide, y), (x - wide, y)]
        around += [(x, y - 38), (x, y + 38), (x + wide + 14, y), (x - wide - 14, y)]
        self._word(found.label, 14, around, False)

    def _word(self, text: str, size: float, candidates: Sequence[tuple[float, float]], needed: bool) -> None:
        place, clear = self.labels.place(text, size, candidates)
        if needed or clear:
            self.canvas.text(place, text, size, INK, "middle", True)

    def camera(self, pose: Pose, color: Rgb, width: float) -> None:
        """An arrow head at the pose that points where the camera looks."""
        unit = 30 / self.scale
        forward, right = pose.R[:2, 2], pose.R[:2, 0]
        tip, notch = pose.t[:2] + 0.9 * unit * forward, pose.t[:2] - 0.2 * unit * forward
        tails = [pose.t[:2] - 0.5 * unit * forward + side * 0.5 * unit * right for side in (-1, 1)]
        self.line([self.at(point) for point in (tip, tails[0], notch, tails[1], tip, tails[0])], color, width)

    def ellipse(self, center: FloatArray, covariance: FloatArray, gain: float, color: Rgb = ORANGE) -> None:
        values, vectors = np.linalg.eigh(covariance)
        angles = np.linspace(0, 2 * np.pi, 48)
        radii = np.sqrt(np.clip(values, 0, None) * CHI2_2D_95) * gain
        points = center[:2] + (np.column_stack([np.cos(angles), np.sin(angles)]) * radii) @ vectors.T
        low, high = self.at(np.array([self.low[0], self.high[1]])), self.at(np.array([self.high[0], self.low[1]]))
        for part in line_parts_inside([self.at(p) for p in points], low, high):
            self.line(part, color, 1)

    def note(self, note: Note) -> None:
        x, y = self.at(np.array(note.at))
        around = [(x + dx, y + dy) for dy in (0.0, 18.0, -18.0) for dx in (0.0, 24.0, -24.0, 48.0, -48.0)]
        self._word(note.text, 16, around, True)

    def words(self, title: str, rows: Sequence[Sequence[tuple[float, Rgb, str]]]) -> None:
        """Title above the plan, legend below it."""
        room = self.canvas.size[0] - 1.5 * self.margin_px
        size = min(TITLE_PX, TITLE_PX * room / max(text_width(title, TITLE_PX), 1.0))
        self.canvas.text((self.margin_px, self.margin_px * 0.28), title, size, INK, "start")
        for row, entries in enumerate(rows):
            y = float(self.bottom + LEGEND_PX + LEGEND_ROW_PX * row)
            for x, color, text in entries:
                self.canvas.line([(x, y), (x + 26, y)], color, 5)
                self.canvas.text((x + 34, y), text, CODE_PX, INK, "start")
        self.canvas.text((self.canvas.size[0] - self.margin_px, self.margin_px * 0.7), "grid 1 m", 14, FAINT, "end")
