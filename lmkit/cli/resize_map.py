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
from lmkit.model.landmark_map import LandmarkMap, MappedLandmark
from lmkit.units import parse_two_lengths_mm

PRINTS = (".pdf", ".png", ".svg")
MOST_OFF = 0.2  # largest relative error of a size: fitting to another paper format gives less


def _require_measured_print(landmark: MappedLandmark, size_m: float) -> None:
    """Refuse a measurement that is in another unit, or of another print."""
    if abs(size_m / landmark.size_m - 1) > MOST_OFF:
        raise InputError(
            "not_its_size",
            f"--measured: {1000 * size_m:g} mm, but {landmark.id} has {1000 * landmark.size_m:g} mm in the map",
            "measure the outer edges of the border, in mm, or correct size_m in the map",
        )


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
    measured_ids = {LandmarkId(family.name, code) for code in codes}
    for landmark in landmarks:
        if landmark.id in measured_ids:
            _require_measured_print(landmark, true_size_m)
    resized = [
        replace(landmark, size_m=true_size_m) if landmark.id in measured_ids else landmark for landmark in landmarks
    ]
    target = output or path
    if target.suffix.lower() in PRINTS:
        raise InputError("bad_suffix", f"-o {target}: with --measured a map is written", "use a name ending in .yaml")
    write_file(target, map_to_yaml(LandmarkMap(resized)), force)
    print_line(f"{target}: size_m {true_size_m:.5f} for {len(codes)} landmarks")
