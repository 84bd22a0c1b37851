"""`lmkit generate --measured`: the map with the measured size of printed landmarks."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from lmkit.cli.output import print_line, warn
from lmkit.errors import InputError
from lmkit.io.files import write_file
from lmkit.io.landmark_map import map_to_yaml, read_map
from lmkit.model.families import MarkerFamily
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import LandmarkMap
from lmkit.units import parse_two_lengths_mm


def write_measured_map(
    path: Path, family: MarkerFamily, codes: list[int], measured: str, output: Path | None, force: bool
) -> None:
    """Write the map with the measured size of these landmarks."""
    width, height = parse_two_lengths_mm(measured, "--measured")
    landmarks = read_map(path)
    missing = [code for code in codes if LandmarkId(family.name, code) not in landmarks]
    if missing:
        raise InputError(
            "not_in_map", f"{path} has no {family.name} landmark of code {missing[0]}", "check --codes and --family"
        )
    if abs(width / height - 1) > 0.005:
        warn(f"width and height differ by {abs(width / height - 1):.1%}; the map gets their mean")
    true_size_m = round((width + height) / 2000, 7)
    resized = [
        replace(landmark, size_m=true_size_m)
        if landmark.family == family.name and landmark.code in codes
        else landmark
        for landmark in landmarks
    ]
    target = output or path
    write_file(target, map_to_yaml(LandmarkMap(resized)), force)
    print_line(f"{target}: size_m {true_size_m:.5f} for {len(codes)} landmarks")
