"""The additional view that reduces the covariance of a poorly determined landmark most.

Every candidate is a stereo view from a place that the robot can reach: the landmark and its neighbors in view, with
corners as accurate as measured ones of their size.  The information of this view and of the map gives the covariance
of the landmark after it (the greedy choice of active vision; Davison and Murray 2002).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from lmkit.arrays import BoolArray, FloatArray
from lmkit.geometry.pose import Pose
from lmkit.geometry.pose_array import PoseArray
from lmkit.geometry.rig import AnyRig
from lmkit.mapping.bundle_adjustment import BundleProblem
from lmkit.mapping.bundle_results import Bundle
from lmkit.mapping.survey_results import Survey, deviations
from lmkit.model.detector_model import corner_sigma_px, half_read_px, recognized
from lmkit.model.landmark_id import LandmarkId, ids_text
from lmkit.model.landmark_map import LandmarkMap, MappedLandmark
from lmkit.model.observation import Detection
from lmkit.model.recording import RigFrame
from lmkit.simulation.observations import look

DISTANCES_M = (0.6, 1.0, 1.5, 2.2, 3.0)
ASIDE_DEG = (0.0, -25.0, 25.0, -50.0, 50.0)
PAN_DEG = (0.0, -18.0, 18.0)
REACHED_M = 1.0  # largest distance of a view from the robot's path
BEFORE_WALL = 0.98  # of the line of sight: a landmark does not occlude itself
PIECE_M = 0.5  # of wall on each side of a landmark, which occludes
LEAST_BESIDE = 2
LEAST_READ = 0.5  # probability
MOST_ADVISED = 6
NO_SINGLE_VIEW = (
    "one more view does not help, because the landmarks around share the error; drive on from there until better "
    "known landmarks come into view again, or measure one there and give it as known (--known)"
)
WORTH = 0.7  # of the standard deviation at most remains, or the view is not worthwhile


@dataclass(frozen=True)
class NextView:
    """A view to take next.

    Attributes:
        id: the landmark.
        T_map_left: of the left camera.
        place_m, turn_rad: its standard deviations now.
        distance_m, aside_deg: of the camera from it, and angle off its normal, to the right when facing it.
        beside: landmarks that should be in view, too.
        then_m, then_rad: its standard deviations after that view.
    """

    id: LandmarkId
    T_map_left: Pose
    place_m: float
    turn_rad: float
    distance_m: float
    aside_deg: float
    beside: tuple[LandmarkId, ...]
    then_m: float
    then_rad: float

    def __str__(self) -> str:
        side = "from straight ahead"
        if self.aside_deg:
            side = f"{abs(self.aside_deg):.0f} deg to its {'right' if self.aside_deg > 0 else 'left'}"
        beside = f", with {_listed(self.beside)} in view" if self.beside else ""
        return (
            f"look at it from {self.distance_m:g} m, {side}{beside} "
            f"(then {1000 * self.then_m:.0f} mm, {np.rad2deg(self.then_rad):.1f} deg)"
        )


def next_view(landmark: MappedLandmark, bundle: Bundle, rig: AnyRig) -> NextView | None:
    """The view that reduces the uncertainty of a landmark most; None if no view helps much."""
    cameras = bundle.poses.t
    now_m, now_rad = deviations(landmark)
    height = float(np.median(cameras[:, 2]))
    mapped = list(bundle.landmarks)
    places = np.array([m.T_map_landmark.t[:2] for m in mapped])
    along = np.array([m.T_map_landmark.R[:2, 0] for m in mapped])
    best: NextView | None = None
    for distance, aside, pan in product(DISTANCES_M, ASIDE_DEG, PAN_DEG):
        T_map_left = _looking(landmark, distance, aside, pan, height)
        at = T_map_left.t
        if np.linalg.norm(cameras[:, :2] - at[:2], axis=1).min() > REACHED_M:
            continue
        clear = _clear(at[:2], places, along)
        frame = _view(LandmarkMap([m for m, seen in zip(mapped, clear, strict=True) if seen]), rig, T_map_left)
        if landmark.id not in {o.id for o in frame.seen[0]}:
            continue
        then_m, then_rad = _afterwards(landmark, bundle, rig, T_map_left, frame)
        beside = tuple(sorted({o.id for o in frame.seen[0]} - {landmark.id}))
        view = NextView(landmark.id, T_map_left, now_m, now_rad, distance, aside, beside, then_m, then_rad)
        if best is None or _cost(view) < _cost(best):
            best = view
    if best is None or (best.then_m > WORTH * now_m and best.then_rad > WORTH * now_rad):
        return None
    return best


def advise(survey: Survey, rig: AnyRig) -> dict[LandmarkId, str]:
    """Advice on the least certain landmarks of a survey, by id."""
    advice = {}
    for id_, _, _ in sorted(survey.poorly_determined, key=lambda one: -(one[1] + one[2]))[:MOST_ADVISED]:
        landmark = survey.bundle.landmarks.find(id_)
        assert landmark is not None
        advice[id_] = str(next_view(landmark, survey.bundle, rig) or NO_SINGLE_VIEW)
    return advice


def _cost(view: NextView) -> tuple[bool, float]:
    # With a single neighbor the view itself may stay ambiguous.  A radian counts as a meter.
    return len(view.beside) < LEAST_BESIDE, view.then_m + view.then_rad


def _looking(landmark: MappedLandmark, distance: float, aside_deg: float, pan_deg: float, height: float) -> Pose:
    """T_map_left of a level camera at that place, panned away from the landmark."""
    T, aside = landmark.T_map_landmark, np.deg2rad(aside_deg)
    toward = np.cos(aside) * T.R[:2, 2] + np.sin(aside) * T.R[:2, 0]
    toward = toward / max(float(np.linalg.norm(toward)), 1e-9)
    heading = np.arctan2(-toward[1], -toward[0]) + np.deg2rad(pan_deg)
    c, s = np.cos(heading), np.sin(heading)
    R = np.array([[s, 0.0, c], [-c, 0.0, s], [0.0, -1.0, 0.0]])
    return Pose("map", "left", R, np.array([*(T.t[:2] + distance * toward), height]))


def _clear(side: FloatArray, places: FloatArray, along: FloatArray) -> BoolArray:
    """(L,) True where no other landmark's piece of wall lies between the camera and a landmark.

    Args:
        places, along: (L,2) of the landmarks, and unit vectors along their walls.
    """
    way, off = places - side, places - side
    # camera + share way = place + aside along, for every way (rows) and wall (columns).
    det = along[None, :, 0] * way[:, None, 1] - along[None, :, 1] * way[:, None, 0]
    det = np.where(np.abs(det) < 1e-9, np.inf, det)
    share = (along[:, 0] * off[:, 1] - along[:, 1] * off[:, 0]) / det
    aside = (way[:, None, 0] * off[None, :, 1] - way[:, None, 1] * off[None, :, 0]) / det
    hidden = (share > 0) & (share < BEFORE_WALL) & (np.abs(aside) < PIECE_M)
    np.fill_diagonal(hidden, False)
    return np.asarray(~hidden.any(axis=1))


def _view(landmarks: LandmarkMap, rig: AnyRig, T_map_left: Pose) -> RigFrame:
    """Simulated detections of all cameras from there, with covariances by their size."""
    at_the_camera = replace(rig, T_base_left=Pose.identity("base", "left"))
    base = Pose("map", "base", T_map_left.R, T_map_left.t)
    cameras = look(landmarks, at_the_camera, base, 1e-3, np.random.default_rng(0))
    seen = tuple(tuple(o for o in map(_as_measured, camera) if o is not None) for camera in cameras)
    return RigFrame(0.0, seen)


def _as_measured(seen: Detection) -> Detection | None:
    side = np.linalg.norm(seen.corners - np.roll(seen.corners, 1, axis=0), axis=1).mean()
    if recognized(side, np.zeros(()), half_read_px(seen.id.family)) < LEAST_READ:
        return None
    return replace(seen, covariance=corner_sigma_px(side) ** 2 * np.eye(8))


def _afterwards(
    landmark: MappedLandmark, bundle: Bundle, rig: AnyRig, T_map_left: Pose, frame: RigFrame
) -> tuple[float, float]:
    """The landmark's standard deviations after adding that view."""
    ids = {o.id for o in frame.detections}
    mapped = list(bundle.landmarks)
    rows = [k for k, m in enumerate(mapped) if m.id in ids]
    view = BundleProblem(
        [frame],
        rig,
        PoseArray.from_poses("map", "left", [T_map_left]),
        LandmarkMap([replace(mapped[k], covariance=None) for k in rows]),
        {},
    )
    at = (6 * np.array(rows)[:, None] + np.arange(6)).ravel()
    C = bundle.joint[at[:, None], at[None]]
    # (C^-1 + I)^-1, for a C that may be singular.
    after = np.linalg.solve(np.eye(len(at)) + C @ view.landmark_information(), C)
    first = 6 * rows.index(mapped.index(landmark))
    own = slice(first, first + 6)
    return deviations(replace(landmark, covariance=(after[own, own] + after[own, own].T) / 2))


def _listed(ids: Sequence[LandmarkId]) -> str:
    some = ids_text(ids[:4]).split(", ")
    return some[0] if len(some) == 1 else ", ".join(some[:-1]) + " and " + some[-1]
