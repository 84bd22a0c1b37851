"""`lmkit rectify`: stereo pairs resampled so that matching points share a row."""

from __future__ import annotations

from typing import Annotated

import typer

from lmkit.cli import options
from lmkit.cli.output import check_outputs, print_line, progress, warn, write_outputs


def run(
    left: Annotated[
        str, typer.Argument(help="Left image, folder, glob or video; split:SOURCE has both side by side.")
    ],
    rig: options.RigFile,
    output: options.OutputFolder,
    right: Annotated[
        str | None, typer.Argument(help="Right image, folder, glob or video; images are paired by file name.")
    ] = None,
    lines: Annotated[
        bool, typer.Option("--lines", help="Write both images side by side with lines across, for a visual check.")
    ] = False,
    force: options.Force = False,
) -> None:
    """Rectify stereo pairs. Matching points then share a row, or a column if one camera is above the other."""
    from lmkit.calibration.sanity_checks import end_of_lens
    from lmkit.geometry.rectification import rectification
    from lmkit.geometry.rig import as_stereo
    from lmkit.io.any_rig import read_any_rig
    from lmkit.io.image_groups import SPLIT, are_files, list_groups, require_image_of_each
    from lmkit.io.image_sources import frame_count
    from lmkit.pipelines.rectify_images import rectified_calibration, rectify_frames

    cameras = as_stereo(read_any_rig(rig), "rectify")
    for name, camera in (("left", cameras.left), ("right", cameras.right)):
        if (message := end_of_lens(camera, f"the {name} camera")) is not None:
            warn(message)
    sources = [left] if right is None else [left, right]
    require_image_of_each(("left", "right"), sources)
    calibration = {} if lines else rectified_calibration(cameras, output)
    check_outputs(list(calibration), force)
    count = len(list_groups(sources)) if are_files(sources) else frame_count([left.removeprefix(SPLIT)])
    written = [
        path for paths in progress(rectify_frames(sources, cameras, output, lines, force), count, "rectifying")
        for path in paths
    ]  # fmt: skip
    maps = rectification(cameras)
    depth = maps.P_left[0, 0] * cameras.baseline_m
    print_line(f"wrote {len(written)} images to {output}; depth = {depth:.4f} m px / disparity")
    for path, text in calibration.items():
        write_outputs({path: text}, force)
        print_line(f"wrote {path}")
    if maps.along == 1:
        print_line("one camera is above the other: matching points share a column, not a row")
