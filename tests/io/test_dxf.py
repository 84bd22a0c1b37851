"""DXF drawings give the walls that the same drawing gives as SVG; units, layers and blocks count."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from command_line import run_command
from floors import mounted_every, two_rooms

from lmkit.errors import InputError, InputWarning
from lmkit.io import dxf_lines
from lmkit.io.dxf_lines import LayerRules, parse_layer_rules, read_dxf_lines
from lmkit.io.floor_islands import DrawingOptions
from lmkit.io.floor_plan import read_floor
from lmkit.io.landmark_map import map_to_yaml

ezdxf = pytest.importorskip("ezdxf", reason="the extra dxf is not installed")
SVG = (
    '<svg xmlns="http://www.w3.org/2000/svg"><path d="M0 0h6v4h-6z"/><path d="M3 4V1.4"/>'
    '<path d="M1 4A0.9 0.9 0 0 1 1.9 3.1"/></svg>'
)


def drawing(unit: int = 4, size: float = 1000.0, version: str = "R2010"):
    """Two rooms of 6 x 4 m and the arc of a door, far from the origin."""
    document = ezdxf.new(version)
    document.header["$INSUNITS"] = unit
    for name in ("WALL", "DOOR", "FURN"):
        document.layers.add(name)
    space = document.modelspace()
    corners = np.array([(0, 0), (6, 0), (6, 4), (0, 4)]) * size + [5e5, 6e5]
    space.add_polyline2d(corners.tolist(), close=True, dxfattribs={"layer": "WALL"})
    a = np.array([3, 0]) * size + corners[0]
    space.add_line(a, (a[0], a[1] + 2.6 * size), dxfattribs={"layer": "WALL"})
    hinge = corners[0] + [size, 0.9 * size]
    space.add_arc((hinge[0] + 0.9 * size, hinge[1] - 0.9 * size), 0.9 * size, 90, 180, dxfattribs={"layer": "DOOR"})
    return document, space


def lines(folder, document, *how, **more):
    document.saveas(folder / "plan.dxf")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", InputWarning)
        return np.array(read_dxf_lines(folder / "plan.dxf", *how, **more))


def lengths(ends):
    return sorted(np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1).round(6).tolist())


def without_curves(folder, document):
    return lengths(lines(folder, document, curves=False))


ROOMS = [2.6, 4.0, 4.0, 6.0, 6.0]


@pytest.mark.filterwarnings("ignore::lmkit.errors.InputWarning")
@pytest.mark.parametrize("version", ["R12", "R2018"])
def test_the_walls_are_those_of_the_same_svg(tmp_path, version):
    document, _ = drawing(version=version)
    document.saveas(tmp_path / "plan.dxf")
    (tmp_path / "plan.svg").write_text(SVG)
    for curves in (True, False):
        scale = 0.001 if version == "R12" else None  # R12 has no unit
        ours = read_floor(tmp_path / "plan.dxf", scale, DrawingOptions(curves=curves))
        same = read_floor(tmp_path / "plan.svg", 1.0, DrawingOptions(curves=curves))
        assert ours.free.shape == same.free.shape
        assert (ours.free != same.free).mean() < 0.001
        long = [sorted(round(w.length_m, 3) for w in floor.walls if w.length_m > 0.5) for floor in (ours, same)]
        assert long[0] == long[1]


@pytest.mark.parametrize(("unit", "size"), [(4, 1000.0), (5, 100.0), (6, 1.0), (1, 1 / 0.0254), (2, 1 / 0.3048)])
def test_units_are_meters_of_the_map(tmp_path, unit, size):
    assert without_curves(tmp_path, drawing(unit, size)[0]) == pytest.approx(ROOMS, abs=1e-4)


def test_a_file_without_a_header_has_no_unit(tmp_path):
    pairs = "0 SECTION 2 ENTITIES 0 LINE 8 WALL 10 0 20 0 11 6000 21 4000 0 ENDSEC 0 EOF"
    (tmp_path / "plan.dxf").write_text("\n".join(pairs.split()) + "\n")
    with pytest.raises(InputError, match="unit is unknown"):
        read_dxf_lines(tmp_path / "plan.dxf")
    ((_, end),) = read_dxf_lines(tmp_path / "plan.dxf", 0.001)
    assert end == pytest.approx([6, 4])


def test_a_unit_that_is_missing_or_wrong_is_asked_for(tmp_path):
    document, _ = drawing(0)
    with pytest.raises(InputError, match=r"unit is unknown.*--scale"):
        lines(tmp_path, document)
    assert lengths(lines(tmp_path, document, 0.001, False)) == ROOMS
    for unit, scale in ((6, None), (7, 1.0)):
        with pytest.raises(InputError, match="6000 m long"):
            lines(tmp_path, drawing(unit)[0], scale)
    document, _ = drawing(6)
    document.saveas(tmp_path / "plan.dxf")
    with pytest.warns(InputWarning, match="says that its unit is meters"):
        assert lengths(np.array(read_dxf_lines(tmp_path / "plan.dxf", 0.001, False))) == ROOMS


@pytest.mark.parametrize("state", ["off", "freeze", "invisible", "Defpoints", "paper", "text", "hatch", "not named"])
def test_what_is_not_drawn_is_no_wall(tmp_path, state):
    document, space = drawing()
    layer = document.layers.get("FURN")
    if state in ("off", "freeze"):
        getattr(layer, state)()
    how = {"invisible": 1} if state == "invisible" else {}
    where = document.paperspace() if state == "paper" else space
    how["layer"] = "Defpoints" if state == "Defpoints" else "FURN"
    if state == "text":
        where.add_text("Room 1", dxfattribs=how)
    elif state == "hatch":
        where.add_hatch(dxfattribs=how).paths.add_polyline_path([(0, 0), (9, 0), (9, 9)])
    else:
        where.add_line((5e5, 6e5), (5.03e5, 6.03e5), dxfattribs=how)
    rules = LayerRules(without=("fur*",)) if state == "not named" else LayerRules()
    assert lengths(lines(tmp_path, document, curves=False, layers=rules)) == ROOMS


def test_blocks_are_placed_turned_scaled_and_repeated(tmp_path):
    document, space = drawing()
    leaf = document.blocks.new("LEAF")
    leaf.add_line((0, 0), (0, 100))
    leaf.add_line((0, 0), (7, 0), dxfattribs={"layer": "FURN"})
    outer = document.blocks.new("OUTER")
    outer.add_blockref("LEAF", (10, 0), dxfattribs={"xscale": 2, "yscale": 2, "rotation": 90})
    place = {"layer": "DOOR", "row_count": 2, "row_spacing": 500}
    space.add_blockref("OUTER", (5.01e5, 6.01e5), dxfattribs=place)
    document.layers.get("FURN").off()
    assert without_curves(tmp_path, document) == sorted([*ROOMS, 0.2, 0.2])
    document.layers.get("DOOR").off()  # an entity on layer 0 of a block has the layer of the block
    document.layers.get("FURN").on()
    assert without_curves(tmp_path, document) == sorted([*ROOMS, 0.014, 0.014])
    document.layers.get("DOOR").freeze()
    assert without_curves(tmp_path, document) == ROOMS


def test_arcs_of_polylines_ellipses_and_splines_are_flattened(tmp_path):
    document, space = drawing()
    space.add_lwpolyline([(5e5, 6e5, 1.0), (5.02e5, 6e5, 0.0)], format="xyb")
    space.add_ellipse((5.01e5, 6.01e5), (500, 0), 0.5)
    space.add_spline([(5e5, 6e5), (5.01e5, 6.005e5), (5.02e5, 6e5)])
    ends = lines(tmp_path, document, layers=LayerRules(only=("0",)))
    steps = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1)
    assert steps.max() < 0.5
    assert steps.sum() == pytest.approx(np.pi + 2.4221 + 2.3, rel=0.02)
    assert without_curves(tmp_path, document) == ROOMS


def test_mirrored_entities_lie_where_they_are_drawn(tmp_path):
    document, space = drawing()
    space.add_lwpolyline([(-5e5, 6e5), (-5.03e5, 6.01e5)], dxfattribs={"extrusion": (0, 0, -1), "layer": "FURN"})
    ends = lines(tmp_path, document, curves=False)
    assert ends.max(axis=(0, 1)) == pytest.approx([6.0, 4.0])
    assert any(np.allclose(line, [[0, 0], [3, 1]]) for line in ends)


def test_what_may_be_walls_and_is_left_out_is_named(tmp_path):
    document, space = drawing()
    document.add_xref_def("base.dwg", "BASE")
    space.add_blockref("BASE", (0, 0))
    space.add_3dface([(0, 0), (1, 0), (1, 1)])
    document.saveas(tmp_path / "plan.dxf")
    with pytest.warns(InputWarning) as said:
        read_dxf_lines(tmp_path / "plan.dxf")
    assert "left out: reference to base.dwg (1), 3DFACE (1)" in str(said[0].message)
    assert "lines by layer: DOOR" in str(said[1].message)


@pytest.mark.parametrize(
    ("text", "match"),
    [("not a drawing\n", "not DXF"), ("  0\nSECTION\n  2\nENTITIES\n", "not DXF|no line"), ("", "not DXF")],
)
def test_other_files_are_refused(tmp_path, text, match):
    (tmp_path / "plan.dxf").write_text(text)
    with pytest.raises(InputError, match=match):
        read_dxf_lines(tmp_path / "plan.dxf", 1.0)


def test_bombs_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(dxf_lines, "MAX_PLACED", 1000)
    document, space = drawing()
    for k in range(8):
        block = document.blocks.new(f"B{k}")
        for _ in range(10):
            block.add_blockref(f"B{k - 1}", (0, 0)) if k else block.add_line((0, 0), (1, 0))
    monkeypatch.setattr(dxf_lines, "MAX_RECORDS", 100)
    with pytest.raises(InputError, match="more than 100"):
        lines(tmp_path, document)
    monkeypatch.setattr(dxf_lines, "MAX_RECORDS", 100_000)
    many = {"row_count": 32000, "column_count": 32000, "row_spacing": 1, "column_spacing": 1}
    for name, how in (("B0", many), ("B7", {})):
        bomb = space.add_blockref(name, (0, 0), dxfattribs=how)
        with pytest.raises(InputError, match="more than 1000"):
            lines(tmp_path, document)
        space.delete_entity(bomb)


def test_the_command_line_chooses_layers(tmp_path):
    document, space = drawing()
    space.add_circle((5.02e5, 6.02e5), 400, dxfattribs={"layer": "FURN"})
    document.saveas(tmp_path / "plan.dxf")
    (tmp_path / "map.yaml").write_text(map_to_yaml(mounted_every(two_rooms(tmp_path), 1.0)))
    words = ["map", str(tmp_path / "map.yaml"), "--floor", str(tmp_path / "plan.dxf")]
    with pytest.warns(InputWarning, match="lines by layer"):
        assert run_command(*words).code == 0
    chosen = run_command(*words, "--layers", "WALL")
    assert (chosen.code, "layer" in chosen.err) == (0, False)
    unknown = run_command(*words, "--layers", "MAUER")
    assert unknown.code == 2
    assert "layers with lines: FURN" in unknown.err
    other = run_command(*words[:2], "--floor", str(tmp_path / "floor.yaml"), "--layers", "WALL")
    assert (other.code, "for DXF" in other.err) == (2, True)
    (tmp_path / "plan.dwg").write_bytes(b"AC1032")
    assert "DWG is not read" in run_command(*words[:3], str(tmp_path / "plan.dwg")).err


@pytest.mark.parametrize("radius", [1e308, 1e200, -1e308])
def test_an_arc_of_any_radius_ends(tmp_path, radius):
    document, space = drawing()
    space.add_arc((0, 0), radius, 0, 90)
    with pytest.raises(InputError, match="not finite, or too large"):
        lines(tmp_path, document)


def test_layer_rules():
    rules = parse_layer_rules("A-WALL*, not:A-WALL-PATT")
    assert [rules.takes(name) for name in ("a-wall", "A-WALL-FULL", "A-WALL-PATT", "A-DOOR")] == [
        True,
        True,
        False,
        False,
    ]
    assert parse_layer_rules("") == LayerRules()
