"""Page templates: TOML files that say what stands where on the paper.

Shipped ones live in ``templates/`` of the project; users bring their own by path.
"""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from lmkit.errors import InputError
from lmkit.formats.document import first_problem

PAPERS_MM = {"a4": (210.0, 297.0), "letter": (215.9, 279.4)}

Millimetres = Annotated[float, Field(ge=0, allow_inf_nan=False)]
PointMm = tuple[Millimetres, Millimetres]


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class RulerPlaces(_Part):
    """Where the two rulers start: the left end and the top end, mm."""

    horizontal_mm: PointMm
    vertical_mm: PointMm


class LabelPlace(_Part):
    """Top left of the label, mm."""

    at_mm: PointMm


class PageTemplate(_Part):
    """One sheet with one landmark.

    Attributes:
        name: how ``--template`` calls it.
        paper: a key of ``PAPERS_MM``.
        centre_mm: the landmark's middle, from the paper's top left corner.
        rulers, label: left out when absent.
    """

    format: Literal["lmkit-template/1"]
    name: str
    paper: Literal["a4", "letter"]
    centre_mm: PointMm
    rulers: RulerPlaces | None = None
    label: LabelPlace | None = None

    @property
    def paper_mm(self) -> tuple[float, float]:
        """(width, height) of the paper."""
        return PAPERS_MM[self.paper]


def templates_folder() -> Path:
    """Where the shipped templates lie: inside the wheel, or beside the package in a checkout."""
    inside = Path(__file__).resolve().parents[1] / "templates"
    return inside if inside.is_dir() else Path(__file__).resolve().parents[2] / "templates"


def load_template(name_or_file: str) -> PageTemplate:
    """A shipped template by name, or a user's by path.

    Raises:
        InputError: there is none, or the file is not a valid template.
    """
    path = Path(name_or_file)
    if path.suffix != ".toml":
        path = templates_folder() / f"{name_or_file}.toml"
    if not path.is_file():
        known = ", ".join(sorted(p.stem for p in templates_folder().glob("*.toml")))
        raise InputError(
            "unknown_template",
            f"there is no template {name_or_file!r}",
            f"known: {known}; or give a .toml file",
        )
    try:
        return PageTemplate.model_validate(tomllib.loads(path.read_text(encoding="utf-8")))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError("bad_template", f"{path}: not a TOML file: {error}", "mend the line it names") from None
    except ValidationError as error:
        where, problem = first_problem(error)
        raise InputError("bad_template", f"{path}: {where}: {problem}", "see docs/formats.md") from None
