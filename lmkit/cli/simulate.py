"""`lmkit simulate`: rooms with landmarks, photographed, with the exact truth."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from lmkit.cli.output import print_line, progress
from lmkit.errors import InputError


def run(
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder to write.")],
    seed: Annotated[int, typer.Option("--seed", help="Another seed, another room.")] = 0,
    pairs: Annotated[int, typer.Option("--pairs", help="Stereo pairs of the drive.")] = 8,
    boards: Annotated[int, typer.Option("--boards", help="Stereo pairs of a calibration board.")] = 0,
    landmarks: Annotated[int, typer.Option("--landmarks", help="Landmarks on the walls.")] = 12,
    force: Annotated[bool, typer.Option("--force", help="Overwrite files.")] = False,
) -> None:
    """Photograph a simulated room with a stereo camera; write pictures, rig, map and truth."""
    for name, value, low, high in (
        ("--pairs", pairs, 1, 10_000),
        ("--boards", boards, 0, 1_000),
        ("--landmarks", landmarks, 1, 64),
        ("--seed", seed, 0, 2**31),
    ):
        if not low <= value <= high:
            raise InputError("out_of_range", f"{name} {value} is outside {low} to {high}", "choose another value")
    from lmkit.io.files import check_writable, write_file
    from lmkit.simulation.dataset import description_files, make_dataset, take_pictures
    from lmkit.visualization.overlay import encode_png

    check_writable(output / "truth.json", force)
    data = make_dataset(seed, pairs, boards, landmarks)
    for name, image in progress(take_pictures(data), 2 * (pairs + boards), "photographing"):
        write_file(output / name, encode_png(image), force)
    for name, text in description_files(data).items():
        write_file(output / name, text, force)
    print_line(f"{output}: {pairs} pairs, {boards} board pairs, {landmarks} landmarks")
