"""`lmkit simulate`: photographs of a simulated room with landmarks, with the exact truth."""

from __future__ import annotations

from typing import Annotated

import typer

from lmkit.cli import options
from lmkit.cli.output import print_line, progress
from lmkit.errors import InputError


def run(
    output: options.OutputFolder,
    seed: options.Seed = 0,
    pairs: Annotated[int, typer.Option("--pairs", help="Number of stereo pairs of the room.")] = 8,
    boards: Annotated[int, typer.Option("--boards", help="Number of stereo pairs of a calibration board.")] = 0,
    landmarks: Annotated[int, typer.Option("--landmarks", help="Number of landmarks on the walls.")] = 12,
    family: options.OneFamily = "lm8",
    board: Annotated[
        str, typer.Option("--board", help="Calibration board, such as aprilgrid:6x6:22mm:0.3; see lmkit board.")
    ] = "chessboard:9x6:25mm",
    jobs: options.Jobs = None,
    force: options.Force = False,
) -> None:
    """Simulate a room and a stereo camera. Writes images, rig, map and true poses."""
    for name, value, low, high in (
        ("--pairs", pairs, 1, 10_000),
        ("--boards", boards, 0, 1_000),
        ("--landmarks", landmarks, 1, 64),
        ("--seed", seed, 0, 2**31),
    ):
        if not low <= value <= high:
            hint = f"give {low} to {high}"
            raise InputError("out_of_range", f"{name} {value} is outside {low} to {high}", hint)
    from lmkit.model.families import family_named

    kind = family_named(family)
    if landmarks > kind.code_count:
        raise InputError(
            "too_few_codes",
            f"--landmarks {landmarks}, but {family} has {kind.code_count} codes",
            f"give up to {kind.code_count}, or another --family",
        )
    from lmkit.io.files import check_writable, write_file, write_files
    from lmkit.model.board import BoardSpec
    from lmkit.simulation.dataset import description_files, make_dataset, render_images
    from lmkit.visualization.overlay import encode_png

    data = make_dataset(seed, pairs, boards, landmarks, kind, BoardSpec.parse(board))
    texts = {output / name: text for name, text in description_files(data).items()}
    for path in texts:
        check_writable(path, force)
    for name, image in progress(render_images(data), 2 * (pairs + boards), "rendering"):
        write_file(output / name, encode_png(image), force)
    write_files(texts, force)
    print_line(f"{output}: {pairs} pairs, {boards} board pairs, {landmarks} landmarks")
