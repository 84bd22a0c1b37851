"""Recordings as `lmkit survey` and `lmkit track` read them from their options."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from lmkit.cli.output import ProgressBars, require_no
from lmkit.cli.parsing import require_rate
from lmkit.errors import InputError
from lmkit.units import parse_length_mm

if TYPE_CHECKING:
    from lmkit.geometry.rig import AnyRig
    from lmkit.model.recording import Recording

POSES = (".tum", ".txt")  # suffixes of visual odometry


@dataclass(frozen=True)
class RecordingOptions:
    """Options that name a recording's files; `check` refuses combinations before any file is read."""

    images: Sequence[str]
    detections: Path | None
    readings: Path | None
    odometry: Path | None
    gyro: Path | None
    wheel_track: str | None
    hz: float | None

    def in_folder(self, rig: AnyRig) -> RecordingOptions:
        """The files of a recording folder, if this is the only source.

        Raises:
            InputError: options name files that the folder contains.
        """
        from lmkit.geometry.rig import mounted_cameras
        from lmkit.pipelines.recording_folder import image_files, is_recording_folder, motion_files

        names = [camera.name for camera in mounted_cameras(rig)]
        if len(self.images) != 1 or not is_recording_folder(folder := Path(self.images[0]), names):
            return self
        require_no(f"recording folder {folder}", {"--odometry": self.odometry, "--gyro": self.gyro})
        (images, detections), (odometry, gyro) = image_files(folder, names), motion_files(folder)
        return replace(self, images=images, detections=detections, odometry=odometry, gyro=gyro)

    def check(self) -> None:
        """Refuse options that do not make a recording.

        Raises:
            InputError: not exactly one of images, detections and readings; options that do not fit together.
        """
        if self.readings is not None:
            require_no(
                "--readings", {"images": self.images or None, "--detections": self.detections, "--hz": self.hz}
            )
        elif self.detections is not None:
            require_no("--detections", {"images": self.images or None, "--hz": self.hz})
        elif not self.images:
            raise InputError(
                "no_images",
                "no recording given",
                "give one folder of images per camera, a recording folder, or --detections FILE",
            )
        require_rate(self.hz)
        self._check_odometry()

    def _check_odometry(self) -> None:
        wheels_only = {"--gyro": self.gyro, "--wheel-track": self.wheel_track}
        if self.odometry is None:
            for name, value in wheels_only.items():
                if value is not None:
                    raise InputError("no_odometry", f"{name} needs wheel odometry", "add --odometry FILE.csv")
            if self.readings is not None:
                raise InputError(
                    "no_odometry", "--readings needs wheel odometry",
                    "add --odometry FILE.csv; for single poses use lmkit locate --readings",
                )  # fmt: skip
        elif self.odometry.suffix.lower() in POSES:
            require_no(f"--odometry {self.odometry}", wheels_only)
            if self.readings is not None:
                raise InputError(
                    "poses_in_space",
                    f"--readings needs wheel odometry, and {self.odometry} holds poses",
                    "give --odometry FILE.csv",
                )

    def read(self, rig: AnyRig | None, families: Sequence[str]) -> Recording:
        """Read the files, and detect landmarks in images.

        Raises:
            InputError: a file cannot be read, or the rig lacks what the odometry needs.
        """
        from lmkit.model.families import family_named
        from lmkit.pipelines.detect_recording import open_recording

        track_m = None if self.wheel_track is None else parse_length_mm(self.wheel_track, "--wheel-track") / 1000
        with ProgressBars() as bars:
            opened = open_recording(
                self.images,
                rig,
                self.detections,
                self.readings,
                self.odometry,
                self.gyro,
                track_m,
                families if not self.images else [family_named(name.strip()).name for name in families],
                self.hz,
            )
            return opened.read(bars.counter("detecting landmarks"))
