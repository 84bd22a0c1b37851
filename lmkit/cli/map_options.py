"""Options about maps: family and size of markers in those of other programs, and known maps."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lmkit.units import parse_length_mm

if TYPE_CHECKING:
    from lmkit.model.landmark_map import LandmarkMap

MarkerFamily = Annotated[
    str | None,
    typer.Option("--family", help="Family of the map's markers, such as tag16h5, if the map file does not name one."),
]
MarkerSize = Annotated[
    str | None,
    typer.Option("--size", help="Size of the map's markers, such as 152.4mm, if the map file does not give one."),
]
KnownMap = Annotated[Path | None, typer.Option("--known", help="Map of landmarks with known poses (at least one).")]
KnownSigma = Annotated[
    str | None,
    typer.Option(
        "--known-sigma", help="Standard deviation of known poses, such as 50mm,3deg. Default: as in the file."
    ),
]
KeepDoubtful = Annotated[
    bool, typer.Option("--keep-doubtful", help="Keep doubtful codes in the map, such as those read in one frame.")
]


def read_mounted_map(path: Path) -> LandmarkMap:
    """The map for a command whose --family and --size describe landmarks to mount or to find.

    Raises:
        InputError: not readable, or family or size are missing: the hint says how to convert the file.
    """
    from lmkit.io.external_maps import read_any_map
    from lmkit.io.marker_maps import MarkerDefaults

    return read_any_map(path, MarkerDefaults(can_be_given=False))


def read_map_file(path: Path, family: str | None, size: str | None) -> LandmarkMap:
    """The map of a file of lmkit or another program.

    Raises:
        InputError: not readable, or family or size differ from the file.
    """
    from lmkit.io.external_maps import read_any_map
    from lmkit.io.marker_maps import MarkerDefaults
    from lmkit.model.families import family_named

    name = None if family is None else family_named(family).name
    size_m = None if size is None else parse_length_mm(size, "--size") / 1000
    return read_any_map(path, MarkerDefaults(name, size_m))
