"""`lmkit rectify`: stereo pairs resampled so that matching points share a row."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from lmkit.cli.output import print_line, progress


def run(
    left: Annotated[str, typer.Argument(help="Left picture, folder or glob.")],
    right: Annotated[str, typer.Argument(help="Right picture, folder or glob, paired by sorted name.")],
    rig: Annotated[Path, typer.Option("--rig", help="Rig file.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder for the rectified pictures.")],
    lines: Annotated[bool, typer.Option("--lines", help="Both side by side with lines across, to look at.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Overwrite files.")] = False,
) -> None:
    """Rectify stereo pairs: rows match (columns, where one eye stands above the other)."""
    from lmkit.geometry.rectification import rectification, rectify_pair, with_lines_across
    from lmkit.io.any_rig import read_any_rig
    from lmkit.io.files import check_writable, write_file
    from lmkit.io.image_sources import list_pairs
    from lmkit.io.images import read_image
    from lmkit.visualization.overlay import encode_png

    cameras = read_any_rig(rig)
    pairs = list_pairs(left, right)
    names = [(output / f"{a.stem}_lines.png",) if lines else _names(output, a, b) for a, b in pairs]
    for path in (path for both in names for path in both):
        check_writable(path, force)
    for (left_file, right_file), written in progress(zip(pairs, names, strict=True), len(pairs), "rectifying"):
        pictures = [read_image(left_file), read_image(right_file)]
        for file, picture, camera in zip(
            (left_file, right_file), pictures, (cameras.left, cameras.right), strict=True
        ):
            camera.require_size(str(file), (picture.shape[1], picture.shape[0]))
        rectified = rectify_pair(cameras, pictures[0], pictures[1])
        if lines:
            write_file(written[0], encode_png(with_lines_across(*rectified, rectification(cameras).along)), force)
            continue
        for path, picture in zip(written, rectified, strict=True):
            write_file(path, encode_png(picture), force)
    maps = rectification(cameras)
    f = maps.P_left[0, 0]
    print_line(
        f"wrote {sum(map(len, names))} pictures to {output}; depth = {f * cameras.baseline_m:.4f} m px / disparity"
    )
    if maps.along == 1:
        print_line("the eyes stand above each other: columns match, not rows")


def _names(folder: Path, left: Path, right: Path) -> tuple[Path, ...]:
    """Side by side in one folder, told apart by their eye."""
    return folder / f"{left.stem}_left.png", folder / f"{right.stem}_right.png"
