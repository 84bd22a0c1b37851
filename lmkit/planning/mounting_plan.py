"""Mounting plan of a placement: the sheets to print, and the place of each."""

from __future__ import annotations

import math
from pathlib import Path

from lmkit.generation.manifest import manifest_of
from lmkit.generation.page import Page
from lmkit.generation.pdf import pages_to_pdf
from lmkit.model.families import family_named
from lmkit.model.floor_plan import FloorPlan
from lmkit.model.rooms import tape_ends
from lmkit.pipelines.prints import DEFAULT_PAPER, PrintLayout
from lmkit.planning.coverage import Demand
from lmkit.planning.mounting_sites import Mount
from lmkit.planning.placement import Placement
from lmkit.units import counted, length_text
from lmkit.verification.proof import prove_pages

MOST_NAMED = 8  # landmarks that a summary lists


def sheets_to_print(placement: Placement, paper: str = DEFAULT_PAPER) -> bytes:
    """The new landmarks as a verified PDF, one sheet each; landmarks too large for the paper are tiled."""
    pages: list[Page] = []
    for landmark in (mount.landmark for mount in placement.mounts):
        layout = PrintLayout(family_named(landmark.family), None, paper, 1000 * landmark.size_m)
        pages += layout.pages([landmark.code])
    pdf = pages_to_pdf(pages, "landmarks to mount", manifest_of(pages, paper).to_json())
    prove_pages(pdf, pages)
    return pdf


def mounting_csv(placement: Placement) -> str:
    """A line for each new landmark: which wall, place, height, size, and the same in the map."""
    rows = ["code,wall,from_left_end_m,height_m,size_mm,x_m,y_m,facing_deg,family\n"]
    for mount in placement.mounts:
        x, y, z = mount.landmark.T_map_landmark.t
        facing = math.degrees(mount.wall.facing_rad) % 360
        rows.append(
            f"{mount.landmark.code},{mount.wall.name},{mount.along_m:.3f},{z:.3f},"
            f"{1000 * mount.landmark.size_m:.0f},{x:.3f},{y:.3f},{facing:.1f},{mount.landmark.family}\n"
        )
    return "".join(rows)


def placement_lines(placement: Placement, floor: FloorPlan, demand: Demand, listed_in: Path) -> list[str]:
    """A summary, and the first landmarks, as lines of text.

    Args:
        listed_in: the file that lists all of them.

    Distances as on the mounting sheets: along the wall, from the corners that a tape measure reaches.
    """
    count = len(placement.mounts)
    more = " more" if len(placement.landmarks) > count else ""
    lines = [
        f"{counted(count, 'more landmark' if more else 'landmark')}: {demand}",
        f"met at {placement.share:.1%} of {len(placement.coverage.places)} places; position error there "
        f"{length_text(placement.error_m)}",
    ]
    lines += [f"  {mount.landmark.code:3d}: {_where(mount, floor)}" for mount in placement.mounts[:MOST_NAMED]]
    if count > MOST_NAMED:
        lines.append(f"  and {count - MOST_NAMED} more in {listed_in}")
    return lines


def _where(mount: Mount, floor: FloorPlan) -> str:
    """Wall, distances from its corners, height and size of a landmark."""
    left, right = tape_ends(floor, mount.wall, mount.along_m)
    height_m, size_mm = mount.landmark.T_map_landmark.t[2], 1000 * mount.landmark.size_m
    return f"wall {mount.wall.name}, left {left}, right {right}, height {height_m:.3f} m, size {size_mm:.0f} mm"
