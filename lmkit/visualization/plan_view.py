"""A room from above: landmarks, true poses, found poses with their 95 % ellipses; as PNG or SVG."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lmkit.arrays import ByteArray, FloatArray
from lmkit.geometry.pose import Pose
from lmkit.model.landmark import FAMILIES
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import LandmarkMap, MappedLandmark
from lmkit.visualization.canvas import Canvas, PngCanvas, Rgb, SvgCanvas

MOST_PIXELS_PER_M = 150.0
LARGEST_PX = 1500.0
MARGIN_PX = 90
LEAST_WIDTH_PX = 960  # for title and legend beside narrow rooms
AROUND_M = 0.6  # free space around what is drawn, where the room is not known
SEEN_PX = 6.0  # ellipses are enlarged until the median is as large
LARGEST_SEEN_PX = 120.0
GAINS = (1.0, 10.0, 100.0)
CHI2_2D_95 = 5.991
OFF_WALL_PX = 9  # so far before its wall a landmark is drawn
LABEL_PX = 48.0  # between labels, so that they can be read
SAME_PLACE_M = 0.05
UPRIGHT = 0.3  # length in the plan of the normal of a landmark on a wall; shorter on floors and ceilings

ROOM, WALL, INK = (255, 255, 255), (70, 74, 80), (40, 42, 46)
RED, BLUE, GREEN, ORANGE = (237, 28, 36), (0, 84, 166), (34, 139, 72), (226, 120, 20)
GRID, FAINT = (232, 234, 236), (140, 144, 150)


@dataclass(frozen=True, eq=False)
class Found:
    """A pose to draw.

    Attributes:
        label: written beside it.
        pose: of a camera (it looks along its z axis) in the map.
        covariance: (2,2) of x y, or None.
        sure: False where the images allow another pose.
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
        legend: what its colors mean.
    """

    rgb: ByteArray
    low: tuple[float, float]
    high: tuple[float, float]
    legend: tuple[tuple[Rgb, str], ...] = ()


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
) -> bytes:
    """The bytes of a PNG or SVG file.

    Args:
        truth: true poses of the camera.
        size_m: (x, y) extent of the room, whose corner is the map's origin; None: what is drawn, and some space.
        kind: ``png`` or ``svg``.
        underlay: the floor, which then gives the extent.
        polylines, notes: lines and words on top.
    """
    if underlay is not None:
        low, high = underlay.low, underlay.high
    else:
        low, high = (
            _extent(landmarks, [f.pose for f in found] + list(truth)) if size_m is None else ((0.0, 0.0), size_m)
        )
    scale = min(MOST_PIXELS_PER_M, LARGEST_PX / max(high[0] - low[0], high[1] - low[1]))
    width, height = (round((high[axis] - low[axis]) * scale) + 2 * MARGIN_PX for axis in (0, 1))
    size = (max(width, LEAST_WIDTH_PX), height)
    canvas: Canvas = SvgCanvas(size) if kind == "svg" else PngCanvas(size)
    plan = _Plan(canvas, low, high, scale)
    plan.room(size_m is not None, underlay)
    for line in polylines:
        canvas.line([plan.at(point) for point in line.points], line.color, line.width)
    known = [f.covariance for f in found if f.covariance is not None and f.sure]
    known += [landmark.covariance[:2, :2] for landmark in landmarks if landmark.covariance is not None]
    gain = _gain(known, scale)
    families = {landmark.family for landmark in landmarks}
    several = len(families) > 1
    for landmark in landmarks:
        if landmark.covariance is not None:
            plan.ellipse(landmark.T_map_landmark.t, landmark.covariance[:2, :2], gain, FAINT)
        plan.landmark(landmark)
    for pose, ids in _over_each_other(landmarks):
        plan.codes(pose, ", ".join(str(id_) if several else str(id_.code) for id_ in ids))
    for true in truth:
        plan.camera(true, GREEN, 3, None)
    for one in found:
        if not one.sure:
            plan.camera(one.pose, FAINT, 1, None)
    labeled: list[FloatArray] = []
    for one in (f for f in found if f.sure):
        here = np.array(plan.at(one.pose.t[:2]))
        clear = all(np.abs(here - other).max() > LABEL_PX for other in labeled)
        if clear:
            labeled.append(here)
        plan.camera(one.pose, ORANGE, 2, one.label if clear else None)
        if one.covariance is not None:
            plan.ellipse(one.pose.t, one.covariance, gain)
    for note in notes:
        plan.note(note)
    legend = [*(underlay.legend if underlay else ()), *((line.color, line.legend) for line in polylines)]
    enlarged = "" if gain == 1 else f", {gain:g} times enlarged"
    if any(landmark.covariance is not None for landmark in landmarks):
        legend.append((FAINT, f"landmark's 95 % ellipse{enlarged}"))
    if found:
        legend.append((ORANGE, f"found, 95 % ellipse{enlarged}"))
    if truth:
        legend.append((GREEN, "true pose"))
    if not all(f.sure for f in found):
        legend.append((FAINT, "ambiguous"))
    ink = RED if families & FAMILIES.keys() or not families else INK
    of_family = f" ({families.pop()})" if ink == INK and not several else ""
    plan.words(title, [*legend, (ink, f"landmark and its {'id' if several else 'code'}{of_family}")])
    return canvas.file()


def _over_each_other(landmarks: LandmarkMap) -> list[tuple[Pose, list[LandmarkId]]]:
    """Landmarks that are mounted at one place of the plan, as one pose and their ids."""
    places: list[tuple[Pose, list[LandmarkId]]] = []
    for landmark in landmarks:
        here = landmark.T_map_landmark
        for there, ids in places:
            if np.linalg.norm(here.t[:2] - there.t[:2]) < SAME_PLACE_M and here.R[:, 2] @ there.R[:, 2] > 0:
                ids.append(landmark.id)
                break
        else:
            places.append((here, [landmark.id]))
    return places


def _extent(landmarks: LandmarkMap, poses: Sequence[Pose]) -> tuple[tuple[float, float], tuple[float, float]]:
    points = np.array([landmark.T_map_landmark.t[:2] for landmark in landmarks] + [pose.t[:2] for pose in poses])
    low, high = points.min(axis=0) - AROUND_M, points.max(axis=0) + AROUND_M
    return (float(low[0]), float(low[1])), (float(high[0]), float(high[1]))


def _gain(covariances: Sequence[FloatArray], scale: float) -> float:
    """How much ellipses are enlarged to be seen."""
    if not covariances:
        return 1.0
    sizes = [np.sqrt(max(np.linalg.eigvalsh(c)[-1], 0.0) * CHI2_2D_95) * scale for c in covariances]
    seen = next((gain for gain in GAINS if gain * np.median(sizes) >= SEEN_PX), GAINS[-1])
    # The large ones shall not hide the room.
    return max(
        [gain for gain in GAINS if gain <= seen and gain * np.percentile(sizes, 95) < LARGEST_SEEN_PX], default=1.0
    )


class _Plan:
    """Meters on paper: x to the right, y up."""

    def __init__(self, canvas: Canvas, low: tuple[float, float], high: tuple[float, float], scale: float) -> None:
        self.canvas, self.low, self.high, self.scale = canvas, low, high, scale

    def at(self, xy: FloatArray) -> tuple[float, float]:
        x = MARGIN_PX + (float(xy[0]) - self.low[0]) * self.scale
        return x, self.canvas.size[1] - MARGIN_PX - (float(xy[1]) - self.low[1]) * self.scale

    def room(self, walls: bool, underlay: Underlay | None) -> None:
        a, b = self.at(np.array([self.low[0], self.high[1]])), self.at(np.array([self.high[0], self.low[1]]))
        self.canvas.box(a, b, ROOM)
        if underlay is not None:
            self.canvas.image(a, b, underlay.rgb)
        for axis in (0, 1):
            for meter in range(int(np.ceil(self.low[axis] + 1e-9)), int(np.ceil(self.high[axis]))):
                ends = np.array([self.low, self.high])
                ends[:, axis] = meter
                self.canvas.line([self.at(end) for end in ends], GRID, 1)
        rim = [a, (b[0], a[1]), b, (a[0], b[1]), a, (b[0], a[1])]
        self.canvas.line(rim, WALL if walls else GRID, 5 if walls else 1)

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
        self.canvas.line([self.at(a), self.at(b)], border, 12)
        self.canvas.line([self.at(a + inset * (b - a)), self.at(b - inset * (b - a))], ground, 6)

    def codes(self, pose: Pose, label: str) -> None:
        """Codes beside the landmark, on the side from which it is seen."""
        self.canvas.text(self.at(pose.t[:2] + 34 / self.scale * pose.R[:2, 2]), label, 15, INK, "middle")

    def camera(self, pose: Pose, color: Rgb, width: float, label: str | None) -> None:
        """An arrow head at the pose that points where the camera looks."""
        unit = 30 / self.scale
        forward, right = pose.R[:2, 2], pose.R[:2, 0]
        tip, notch = pose.t[:2] + 0.9 * unit * forward, pose.t[:2] - 0.2 * unit * forward
        tails = [pose.t[:2] - 0.5 * unit * forward + side * 0.5 * unit * right for side in (-1, 1)]
        self.canvas.line([self.at(point) for point in (tip, tails[0], notch, tails[1], tip, tails[0])], color, width)
        if label is not None:
            self.canvas.text(self.at(pose.t[:2] - unit * forward), label, 14, INK, "middle")

    def ellipse(self, center: FloatArray, covariance: FloatArray, gain: float, color: Rgb = ORANGE) -> None:
        values, vectors = np.linalg.eigh(covariance)
        angles = np.linspace(0, 2 * np.pi, 48)
        radii = np.sqrt(np.clip(values, 0, None) * CHI2_2D_95) * gain
        points = center[:2] + (np.column_stack([np.cos(angles), np.sin(angles)]) * radii) @ vectors.T
        self.canvas.line([self.at(p) for p in points], color, 1)

    def note(self, note: Note) -> None:
        self.canvas.text(self.at(np.array(note.at)), note.text, 16, INK, "middle")

    def words(self, title: str, legend: Sequence[tuple[Rgb, str]]) -> None:
        self.canvas.text((MARGIN_PX, MARGIN_PX * 0.28), title, 19, INK, "start")
        x, y = float(MARGIN_PX), self.canvas.size[1] - MARGIN_PX * 0.6
        for color, text in legend:
            width = 60 + 8.5 * len(text)
            if x > MARGIN_PX and x + width > self.canvas.size[0] - MARGIN_PX / 2:
                x, y = float(MARGIN_PX), y + 26
            self.canvas.line([(x, y), (x + 26, y)], color, 5)
            x += 60 + self.canvas.text((x + 34, y), text, 15, INK, "start")
        self.canvas.text((self.canvas.size[0] - MARGIN_PX, MARGIN_PX * 0.7), "grid 1 m", 14, FAINT, "end")
