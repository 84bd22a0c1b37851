"""What `lmkit locate` writes besides its answers: a trajectory, a table, a plan, pictures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from lmkit.errors import InputError

if TYPE_CHECKING:
    from lmkit.geometry.stereo_rig import StereoRig
    from lmkit.model.landmark_map import LandmarkMap
    from lmkit.pipelines.locate_images import Located


@dataclass
class Results:
    """Gathers answers, and writes the files that were asked for."""

    tum: Path | None
    csv: Path | None
    plan: Path | None
    annotate: Path | None
    frame: str
    rig: StereoRig
    landmarks: LandmarkMap
    force: bool
    _located: list[tuple[int, Located]] = field(default_factory=list)

    def __post_init__(self) -> None:
        from lmkit.io.files import check_writable

        for path in (self.tum, self.csv, self.plan):
            if path is not None:
                check_writable(path, self.force)
        if self.plan is not None and self.plan.suffix.lower() not in (".png", ".svg"):
            raise InputError("bad_suffix", f"cannot write {self.plan}: unknown kind", "name it .png or .svg")

    def add(self, number: int, located: Located) -> None:
        """One answer, the picture's number counted from 0; it is drawn at once, so that no picture is kept."""
        if self.annotate is not None:
            self._draw(located)
        if self.tum is not None or self.csv is not None or self.plan is not None:
            from dataclasses import replace

            self._located.append((number, replace(located, image=None, seen=())))

    def write(self) -> Sequence[Path]:
        """Write what was asked for; the files written."""
        if self.tum is None and self.csv is None and self.plan is None:
            return []
        from lmkit.geometry.pose import Pose
        from lmkit.io.files import write_file
        from lmkit.io.image_sources import time_of
        from lmkit.io.trajectory import poses_to_tum
        from lmkit.model.pose_status import PoseStatus
        from lmkit.pipelines.locate_images import ESTIMATE_COLUMNS, estimate_dict, estimate_row
        from lmkit.visualization.plan_view import Found, draw_plan

        answers = [
            (number, estimate_dict(m.estimate, self.rig, m.left, m.right, self.frame))
            for number, m in self._located
            if m.estimate is not None
        ]
        written = []
        if self.tum is not None:
            # Where a name holds no time, the pictures are counted.  A trajectory has no room for doubts.
            timed = all(time_of(answer["left"]) is not None for _, answer in answers)
            poses = [
                (
                    (time_of(answer["left"]) or 0.0) if timed else float(number),
                    Pose.from_quaternion("map", self.frame, answer["position"], answer["quaternion"]),
                )
                for number, answer in answers
                if answer["status"] == PoseStatus.OK
            ]
            write_file(self.tum, poses_to_tum(poses), self.force)
            written.append(self.tum)
        if self.csv is not None:
            write_file(
                self.csv,
                "\n".join([ESTIMATE_COLUMNS, *(estimate_row(answer) for _, answer in answers)]) + "\n",
                self.force,
            )
            written.append(self.csv)
        if self.plan is not None:
            found = [
                Found(
                    Path(m.left).stem, m.estimate.T_map_camera, covariance[:2, :2], m.estimate.status == PoseStatus.OK
                )
                for _, m in self._located
                if m.estimate is not None
                and m.estimate.T_map_camera is not None
                and (covariance := m.estimate.covariance) is not None
            ]
            title = f"{sum(f.sure for f in found)} of {len(self._located)} located"
            kind = self.plan.suffix.lower().removeprefix(".")
            write_file(self.plan, draw_plan(self.landmarks, found, title=title, kind=kind), self.force)
            written.append(self.plan)
        return written

    def _draw(self, located: Located) -> None:
        from lmkit.io.files import write_file
        from lmkit.io.images import read_image
        from lmkit.visualization.overlay import draw_located, encode_jpeg

        assert self.annotate is not None
        assert located.estimate is not None
        image = read_image(Path(located.left)) if located.image is None else located.image
        picture = draw_located(image, located.seen[0], self.rig.left, located.estimate, self.landmarks)
        path = Path(located.left)
        # Frames of a film have their number in their name: FILE#N.
        name = path.stem if located.image is None else path.name.replace("#", "-")
        write_file(self.annotate / f"{name}.jpg", encode_jpeg(picture), self.force)
