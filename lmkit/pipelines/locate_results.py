"""Files that `lmkit locate` writes besides its results: a trajectory, a table, a plan view, annotated images."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import TracebackType

from lmkit.geometry.pose import Pose
from lmkit.geometry.rig import AnyRig
from lmkit.geometry.rig_plausibility import rig_warnings
from lmkit.io.images import read_image
from lmkit.io.trajectory import poses_to_tum
from lmkit.localization.base_pose import with_base
from lmkit.localization.contradicted_prior import OPENING
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import LandmarkMap
from lmkit.model.pose_status import PoseStatus
from lmkit.pipelines.annotated import AnnotatedFolder
from lmkit.pipelines.locate_images import LOCATED_COLUMNS, Located, located_dict, located_row
from lmkit.units import counted
from lmkit.visualization.overlay import draw_located

MOST_NAMED = 5


@dataclass
class LocateResults:
    """Collects results and writes them to files; a context manager, which completes annotated videos.

    Attributes:
        rig, landmarks: rig and map of the localization.
        frame: ``camera`` (the first one) or ``base``, whose poses are written.
        annotate: folder for annotated left images, or None.
        force: overwrite existing files.
    """

    rig: AnyRig
    landmarks: LandmarkMap
    frame: str
    annotate: Path | None = None
    force: bool = False
    answers: list[Located] = field(default_factory=list)
    _read: set[LandmarkId] = field(default_factory=set)
    _stack: ExitStack = field(default_factory=ExitStack)
    _annotated: AnnotatedFolder | None = None

    def __enter__(self) -> LocateResults:
        if self.annotate is not None:
            self._annotated = self._stack.enter_context(AnnotatedFolder(self.annotate, self.force))
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None
    ) -> None:
        self._stack.__exit__(kind, error, at)

    def add(self, located: Located) -> None:
        """Add one result; its image is drawn immediately and not stored."""
        if self._annotated is not None and located.estimate is not None:
            image = read_image(Path(located.left)) if located.image is None else located.image
            seen = located.seen[0]
            shown = with_base(located.estimate, self.rig) if self.frame == "base" else located.estimate
            drawn = draw_located(image, seen, self.rig.left, shown, self.landmarks, enlarge=1)
            self._annotated.add(located.left, drawn, located.time_s)
        self._read.update(detection.id for seen in located.seen for detection in seen)
        self.answers.append(replace(located, image=None, seen=()))

    @property
    def located(self) -> int:
        """Number of results with a pose."""
        return sum(a.estimate is not None and a.estimate.T_map_camera is not None for a in self.answers)

    @property
    def timed(self) -> bool:
        """Whether the time of every frame is known."""
        return all(a.time_s is not None for a in self.answers if a.estimate is not None)

    @property
    def swapped(self) -> bool:
        """Whether the left and right image of a pair are swapped."""
        return any(a.estimate is not None and a.estimate.status == PoseStatus.SWAPPED for a in self.answers)

    @property
    def contradicted_prior(self) -> str | None:
        """Warning of the first frame that contradicts the prior on the pose."""
        for answer in self.answers:
            for text in () if answer.estimate is None else answer.estimate.warnings:
                if text.startswith(OPENING):
                    return f"{Path(answer.left).name}: {text}"
        return None

    @property
    def contradicted_map(self) -> str | None:
        """Warning if at least half of the frames that can be compared with the map contradict it."""
        telling = [e for a in self.answers if (e := a.estimate) is not None and len(e.inliers) + len(e.outliers) > 1]
        of_rig = rig_warnings(self.rig, "the rig")
        causes = [
            [text for text in e.warnings if text not in of_rig]
            for e in telling
            if e.status == PoseStatus.INCONSISTENT
        ]
        named = Counter(texts[0] for texts in causes if texts)
        if not named or 2 * len(causes) < len(telling):
            return None
        cause = named.most_common(1)[0][0]
        frames = f"{len(causes)} of {counted(len(telling), 'frame')}"
        return f"{frames} that saw two landmarks or more contradict the map: {cause}"

    @property
    def advice(self) -> str:
        """Advice for the most frequent cause if no frame has a pose."""
        if self.swapped:
            return "swap LEFT and RIGHT"
        named = Counter(text for a in self.answers if a.estimate is not None for text in a.estimate.warnings)
        if named:
            return named.most_common(1)[0][0]
        if self._read and not any(id_ in self.landmarks for id_ in self._read):
            names = ", ".join(map(str, sorted(self._read)[:MOST_NAMED]))
            more = f" and {len(self._read) - MOST_NAMED} more" if len(self._read) > MOST_NAMED else ""
            return f"the images show {names}{more}, and the map has none of them: give the map of this place"
        return "check that landmarks of the map are in view"

    def tum(self) -> str:
        """Poses with status ``ok``; frame numbers instead of times unless all times are known."""
        rows = [
            (number, located_dict(answer, self.rig, self.frame))
            for number, answer in enumerate(self.answers)
            if answer.estimate is not None
        ]
        poses = [
            (
                row["time_s"] if self.timed else float(number),
                Pose.from_quaternion("map", self.frame, row["position"], row["quaternion"]),
            )
            for number, row in rows
            if row["status"] == PoseStatus.OK
        ]
        return poses_to_tum(poses)

    def csv(self) -> str:
        """All results with standard deviations."""
        rows = [
            located_row(located_dict(answer, self.rig, self.frame))
            for answer in self.answers
            if answer.estimate is not None
        ]
        return "\n".join([LOCATED_COLUMNS, *rows]) + "\n"

    def plan(self, kind: str) -> bytes:
        """The map with poses and their ellipses from above, as ``png`` or ``svg``."""
        from lmkit.visualization.plan_view import Found, draw_plan

        found = [
            Found(
                _label(answer.left),
                estimate.T_map_camera,
                covariance[:2, :2],
                estimate.status == PoseStatus.OK,
            )
            for answer in self.answers
            if (estimate := answer.estimate) is not None
            and estimate.T_map_camera is not None
            and (covariance := estimate.covariance) is not None
        ]
        title = f"{sum(f.sure for f in found)} of {len(self.answers)} located"
        return draw_plan(self.landmarks, found, title=title, kind=kind)

    def files(self, tum: Path | None, csv: Path | None, plan: Path | None) -> Mapping[Path | None, bytes | str]:
        """Contents of the requested files, by path."""
        contents: dict[Path | None, bytes | str] = {}
        if tum is not None:
            contents[tum] = self.tum()
        if csv is not None:
            contents[csv] = self.csv()
        if plan is not None:
            contents[plan] = self.plan(plan.suffix.lower().lstrip("."))
        return contents


def _label(path: str) -> str:
    """A file's name without folder and suffix; undecodable bytes are escaped, as in JSON."""
    return Path(path).stem.encode("utf-8", "backslashreplace").decode()
