"""Plans of a floor as images: expected errors, mounted landmarks, a route."""

from __future__ import annotations

from lmkit.io.landmark_map import map_to_yaml
from lmkit.model.floor_plan import FloorPlan
from lmkit.model.landmark_map import LandmarkMap
from lmkit.planning.coverage import Demand, PoseCoverage
from lmkit.planning.mounting_plan import mounting_csv, sheets_to_print
from lmkit.planning.placement import Placement
from lmkit.planning.route import Route
from lmkit.reports.mounting_sheet import mounting_sheets
from lmkit.units import length_text
from lmkit.visualization.floor_layer import floor_underlay, island_notes, wall_notes
from lmkit.visualization.plan_view import BLUE, Note, Polyline, draw_plan

# Names of the files that `placement_files` may make.
PLACEMENT_FILES = ("map.yaml", "mounting.csv", "mounting.pdf", "plan.png", "coverage.png", "landmarks.pdf")
BESIDE_M = 0.25  # distance of the letters A and B from the ends of a route


def draw_coverage(
    floor: FloorPlan, landmarks: LandmarkMap, coverage: PoseCoverage, demand: Demand, kind: str = "png"
) -> bytes:
    """The expected error at every place, as colors; the bytes of a PNG or SVG file."""
    met = coverage.covered(demand)
    title = (
        f"Expected position error in the best {demand.headings:.0%} of headings; "
        f"requirement met on {met.mean():.0%} of the floor"
    )
    underlay = floor_underlay(floor, coverage.places, coverage.typical_error_m(demand.headings), ~met)
    return draw_plan(landmarks, [], title=title, kind=kind, underlay=underlay, notes=island_notes(floor))


def draw_placement(floor: FloorPlan, placement: Placement) -> bytes:
    """Plan of the landmarks to mount, with the names of the walls; PNG."""
    title = f"{len(placement.mounts)} landmarks to mount; letters name the walls; distances in mounting.pdf"
    return draw_plan(
        placement.landmarks,
        [],
        title=title,
        underlay=floor_underlay(floor),
        notes=[*wall_notes(floor), *island_notes(floor)],
    )


def draw_map(landmarks: LandmarkMap, floor: FloorPlan | None, name: str, kind: str = "png") -> bytes:
    """Plan of a map, with walls and their names if a floor is given; the bytes of a PNG or SVG file."""
    title = f"{name}: {len(landmarks)} landmarks"
    if floor is None:
        return draw_plan(landmarks, [], title=title, kind=kind)
    return draw_plan(
        landmarks,
        [],
        title=title,
        kind=kind,
        underlay=floor_underlay(floor),
        notes=[*wall_notes(floor), *island_notes(floor)],
    )


def draw_route(floor: FloorPlan, landmarks: LandmarkMap, route: Route, kind: str = "png") -> bytes:
    """Plan with the route from A to B, as PNG or SVG."""
    ends = [
        Note(word, (float(x), float(y) - BESIDE_M))
        for word, (x, y) in zip("AB", route.waypoints[[0, -1]], strict=True)
    ]
    title = f"{route.length_m:.2f} m; expected error at most {length_text(float(route.error_m.max()))}"
    path = Polyline(route.waypoints, BLUE, "route")
    return draw_plan(
        landmarks, [], title=title, kind=kind, underlay=floor_underlay(floor), polylines=[path], notes=ends
    )


def placement_files(
    floor: FloorPlan, placement: Placement, demand: Demand, prints: bool = True, paper: str = "a4"
) -> dict[str, bytes | str]:
    """Contents by file name: map, mounting list and sheets, drawings, and the landmarks to print."""
    files: dict[str, bytes | str] = {
        "map.yaml": map_to_yaml(placement.landmarks),
        "mounting.csv": mounting_csv(placement),
        "mounting.pdf": mounting_sheets(placement.landmarks, floor, "map.yaml", paper),
        "plan.png": draw_placement(floor, placement),
        "coverage.png": draw_coverage(floor, placement.landmarks, placement.coverage, demand),
    }
    if prints and placement.mounts:
        files["landmarks.pdf"] = sheets_to_print(placement, paper)
    return files
