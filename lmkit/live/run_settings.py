"""Settings of a live run, from options or from a file ``lmkit-run/1``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, ValidationError

from lmkit.detection.config import PROFILES
from lmkit.errors import InputError
from lmkit.io.document_models import Document, read_document
from lmkit.io.field_problems import first_problem
from lmkit.live.loop import LoopSettings
from lmkit.live.publication import PublicationRule
from lmkit.live.source_address import SourceAddress, parse_source

LOOP_KEYS = (
    "profile",
    "budget_ms",
    "coast_s",
    "confirm",
    "most_sigma_m",
)  # settings that determine poses, besides images


class RunFile(Document):
    """Layout of a run file."""

    format: Literal["lmkit-run/1"] = "lmkit-run/1"
    sources: list[str] = Field(min_length=1, max_length=16)
    rig: str | None = None
    map: str | None = None
    family: str | None = None  # of the map's markers, if its file has none
    size: str | None = None
    odometry: str | None = None
    odometry_kind: Literal["wheels", "poses"] = "wheels"
    gyro: str | None = None
    to: list[str] = Field(default_factory=list, max_length=16)
    rate: float | None = Field(None, gt=0, le=1000)
    hz: float | None = Field(None, gt=0, le=10000)
    profile: Literal["fast", "balanced", "accurate"] = "balanced"
    budget_ms: float = Field(50.0, ge=0, le=10000)
    coast_s: float = Field(1.0, ge=0, le=60)
    confirm: int = Field(2, ge=1, le=10)
    most_sigma_m: float = Field(0.15, gt=0, le=10)
    health: str | None = None
    record: str | None = None


@dataclass(frozen=True)
class RunSettings:
    """Settings of a live run; names as in the run file.

    Attributes:
        values: values of the run file.
        folder: base of relative paths.
    """

    values: RunFile
    folder: Path = Path()

    def path(self, name: str | None) -> Path | None:
        """A file's path; relative to the run file."""
        return None if name is None else self.folder / Path(name)

    @property
    def sources(self) -> list[SourceAddress]:
        """Addresses of the sources.

        Raises:
            InputError: an invalid source, or a mixture of recorded and live ones.
        """
        found = [parse_source(self._placed(text)) for text in self.values.sources]
        kinds = {address.is_live for address in found}
        if len(kinds) > 1:
            raise InputError("mixed_sources", "recorded and live sources are mixed", "give sources of one kind")
        alone = [a for a in found if a.kind in ("sim", "replay")]
        if alone and len(found) > 1:
            raise InputError("mixed_sources", f"{alone[0].text} gives the images of all cameras", "give it alone")
        return found

    def _placed(self, text: str) -> str:
        """A source with its path relative to the run file."""
        prefix = next((p for p in ("split:", "replay:") if text.startswith(p)), "")
        path = self.folder / text.removeprefix(prefix)
        return prefix + str(path) if self.folder != Path() and path.exists() else text

    def loop(self, motion: str) -> LoopSettings:
        """Settings of the loop."""
        v = self.values
        rule = PublicationRule(v.confirm, v.coast_s, v.most_sigma_m)
        assert v.profile in PROFILES
        return LoopSettings(motion, v.profile, v.budget_ms / 1000, rule)


def settings_of(values: dict[str, Any], folder: Path) -> RunSettings:
    """Settings from options, checked like a run file.

    Raises:
        InputError: a value that is not valid in a run file.
    """
    plain = {name: str(value) if isinstance(value, Path) else value for name, value in values.items()}
    try:
        return RunSettings(RunFile.model_validate(plain), folder)
    except ValidationError as error:
        where, problem = first_problem(error)
        option = "--" + where.split("[")[0].replace("_", "-")
        raise InputError("bad_value", f"{option}: {problem}", "see lmkit run --help") from None


def read_run_file(path: Path) -> RunSettings:
    """Settings of a run file.

    Raises:
        InputError: not readable or not valid; names the path of the key.
    """
    return RunSettings(read_document(path, RunFile, "run file"), path.parent)
