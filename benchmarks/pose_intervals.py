"""Whether poses from images lie in the 95 % ellipsoids that `lmkit locate` states, by kinds of cameras.

    uv run --extra benchmark python benchmarks/pose_intervals.py
        [--images 80] [--first 0] [--reported] [--roll 0] [--growth 1.75]

Simulated stereo images of one to three landmarks, 0.8 to 4 m, up to 50 deg aside, by cameras of `TRAINING_KINDS`,
each kind as often as the others, or, with `--reported`, by those of `HELD_OUT_KINDS`.  Lenses and map are exact; hard
shadows, motion, defocus, dim or colored light and a veil trouble every camera with a chance of 30 % each.
`--growth` replaces that of `PatternRegistration.corner_errors`; `--first` is the first seed; `--roll` is
the most that cameras are rolled to either side.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
from accuracy import Situation
from peers import wilson
from scipy.stats import chi2

from lmkit.arrays import FloatArray
from lmkit.detection.config import DetectOptions
from lmkit.detection.detector import detect_landmarks
from lmkit.detection.registration import PatternRegistration
from lmkit.geometry.camera import CameraModel
from lmkit.geometry.pose import Pose
from lmkit.geometry.rotations import rotation_exp, rotation_log
from lmkit.localization.absolute_pose import locate_rig
from lmkit.model.families import families_named
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import LandmarkMap
from lmkit.model.observation import Detection
from lmkit.simulation.cameras import HELD_OUT_KINDS, TRAINING_KINDS, CameraKind, draw_chain
from lmkit.simulation.photograph import ImagingChain, photograph
from lmkit.simulation.scene import Scene, landmark_sheet, studio

TROUBLE, ASIDE_DEG, DISTANCES_M = 0.3, 50.0, (0.8, 4.0)
ERRORS_MM = (50, 90, 95)
NEARNESS_M = (0.8, 1.5, 2.5, 4.0)


@dataclass(frozen=True)
class Located:
    """Squared normalized errors of a pose, None each where none was found, and its error in mm.

    Attributes:
        kind: of the camera.
        distance_m: to the landmarks.
        nees: of place (3), turn (3) and both (6).
        error_mm: of the place.
    """

    kind: str
    distance_m: float
    nees: tuple[float, float, float] | None
    error_mm: float


@dataclass(frozen=True, eq=False)
class Seen:
    """Detections of both cameras of a rig from one place.

    Attributes:
        kind: of the cameras.
        situation: the landmarks and the rig.
        T_map_left: true pose of the left camera.
        detections: of the left and of the right camera.
    """

    kind: str
    situation: Situation
    T_map_left: Pose
    detections: tuple[list[Detection], list[Detection]]

    @property
    def true_corners(self) -> tuple[dict[LandmarkId, FloatArray], ...]:
        """(4,2) px of every landmark, for both cameras."""
        rig, T = self.situation.rig, self.T_map_left.inverse()
        step = Pose("camera", "camera", rig.T_right_left.R, rig.T_right_left.t)
        cameras = ((rig.left, T), (rig.right, step @ T))
        return tuple(
            {m.id: camera.project(at.apply(m.corners_map)) for m in self.situation.landmarks}
            for camera, at in cameras
        )

    @property
    def located(self) -> Located:
        """How far the pose from these detections is off."""
        s, T = self.situation, self.T_map_left
        found = locate_rig(self.detections, s.rig, LandmarkMap(s.landmarks))
        if found.status != "ok":
            return Located(self.kind, s.distance_m, None, np.nan)
        off, turned = found.T_map_camera.t - T.t, rotation_log(found.T_map_camera.R @ T.R.T)
        C, both = found.covariance, np.concatenate([off, turned])
        parts = ((off, C[:3, :3]), (turned, C[3:, 3:]), (both, C))
        place, rotation, all_six = (float(e @ np.linalg.solve(cov, e)) for e, cov in parts)
        return Located(self.kind, s.distance_m, (place, rotation, all_six), 1000 * float(np.linalg.norm(off)))


@dataclass(frozen=True, eq=False)
class Taken:
    """Scene, poses and cameras of a pair of images.

    Attributes:
        situation: the landmarks and the rig.
        T_map_left, T_map_right: true poses of the cameras.
        chain: of both cameras.
    """

    situation: Situation
    T_map_left: Pose
    T_map_right: Pose
    chain: ImagingChain

    @property
    def cameras(self) -> tuple[tuple[CameraModel, Pose], tuple[CameraModel, Pose]]:
        """Both cameras and their poses."""
        rig = self.situation.rig
        return (rig.left, self.T_map_left), (rig.right, self.T_map_right)

    @property
    def scene(self) -> Scene:
        """The landmarks on their sheets."""
        return studio([landmark_sheet(one) for one in self.situation.landmarks])


def draw(rng: np.random.Generator, kind: CameraKind, roll_deg: float = 0.0, family: str = "lm8") -> Taken:
    """A place and cameras of a kind, rolled by so much; all but the landmarks is the same for any family."""
    distance = float(np.exp(rng.uniform(*np.log(DISTANCES_M))))
    count, aside = int(rng.integers(1, 4)), float(rng.uniform(-ASIDE_DEG, ASIDE_DEG))
    s = Situation(count, distance, aside, family=family)
    rig = s.rig
    turn, rolled = rotation_exp(np.deg2rad(rng.uniform(-3, 3, 3))), rotation_exp(np.deg2rad([0.0, 0.0, roll_deg]))
    T = Pose("map", "camera", turn @ s.station.R @ rolled, s.station.t + rng.uniform(-0.03, 0.03, 3))
    chain = draw_chain(rng, [kind], TROUBLE, rig.left.image_size)
    back = rig.T_right_left.inverse()
    return Taken(s, T, Pose("map", "camera", T.R @ back.R, T.t + T.R @ back.t), chain)


def look(kind: CameraKind, seed: int, roll_deg: float = 0.0, family: str = "lm8") -> Seen:
    """Draw a place and cameras of a kind, rolled by so much, take both images and detect the landmarks in them.

    Places, light and cameras depend on the seed alone, whatever the family.
    """
    cv2.setNumThreads(1)
    rng = rng_of(kind, seed)
    taken = draw(rng, kind, roll_deg, family)
    scene = taken.scene
    photos = [photograph(scene, camera, at, taken.chain, rng) for camera, at in taken.cameras]
    left_seen, right_seen = (
        detect_landmarks(photo, DetectOptions(families_named(family), camera=camera))
        for photo, (camera, _) in zip(photos, taken.cameras, strict=True)
    )
    return Seen(kind.name, taken.situation, taken.T_map_left, (left_seen, right_seen))


def rng_of(kind: CameraKind, seed: int) -> np.random.Generator:
    """Source of all that is drawn for a pair of images."""
    return np.random.default_rng([77, seed, *kind.name.encode()])


def roll_of(seed: int, most_deg: float) -> float:
    """Drawn for a seed, deg, uniformly to either side."""
    return float(np.random.default_rng([78, seed]).uniform(-most_deg, most_deg))


def row(name: str, here: list[Located]) -> str:
    nees = np.array([one.nees for one in here if one.nees is not None]).reshape(-1, 3)
    cells = [_inside(nees[:, k], dof) for k, dof in enumerate((3, 3, 6))]
    middle = [f"{np.median(nees[:, k]) / chi2.ppf(0.5, dof):.2f}" for k, dof in enumerate((3, 3, 6))]
    errors = np.percentile([one.error_mm for one in here if one.nees is not None], ERRORS_MM)
    numbers = " / ".join(f"{error:.1f}" for error in errors)
    return f"| {name} | {len(nees)} of {len(here)} | " + " | ".join([*cells, ", ".join(middle), numbers]) + " |"


def _inside(nees: FloatArray, dof: int) -> str:
    hits = int((nees < chi2.ppf(0.95, dof)).sum())
    low, high = wilson(hits, len(nees))
    return f"{100 * hits / len(nees):.0f} ({100 * low:.0f} to {100 * high:.0f})"


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--images", type=int, default=80, help="pairs by each kind of camera")
    parser.add_argument("--reported", action="store_true")
    parser.add_argument("--growth", type=float, default=PatternRegistration.corner_errors.growth)
    parser.add_argument("--first", type=int, default=0, help="seed")
    parser.add_argument("--roll", type=float, default=0.0, help="deg")
    options = parser.parse_args()
    PatternRegistration.corner_errors = PatternRegistration.corner_errors._replace(growth=options.growth)
    kinds = HELD_OUT_KINDS if options.reported else tuple(dict.fromkeys(TRAINING_KINDS))
    seeds = range(options.first, options.first + options.images)
    found = [look(kind, seed, roll_of(seed, options.roll)).located for seed in seeds for kind in kinds]
    print("| | located | place in its ellipsoid, % | turn | both | middle over expected | error, mm |")
    print("|---|---|---|---|---|---|---|")
    for kind in kinds:
        print(row(kind.name, [one for one in found if one.kind == kind.name]))
    for low, high in pairwise(NEARNESS_M):
        print(row(f"{low} to {high} m", [one for one in found if low <= one.distance_m < high]))
    print(row("all", found))


if __name__ == "__main__":
    main()
