"""Lines of a DXF drawing (docs/decisions/0031-dxf.md), read by ezdxf.

Lines come from lines, polylines, arcs, circles, ellipses, splines, multilines, solids and blocks, on layers that
are switched on; curves become short lines.  Text, dimensions and hatches are not walls.
"""

from __future__ import annotations

import fnmatch
import logging
import re
import struct
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.errors import EXTRA, InputError, InputWarning, warn_caller
from lmkit.io.documents import require_regular, unreadable
from lmkit.io.tables import LARGEST

if TYPE_CHECKING:
    from ezdxf.document import Drawing
    from ezdxf.entities.dxfgfx import DXFGraphic
    from ezdxf.entities.insert import Insert

MAX_BYTES = 64 * 1024 * 1024
MAX_RECORDS = 120_000  # ezdxf takes 50 us for each
_RECORD = re.compile(rb"^[ \t]*0[ \t]*\r?\n[ \t]*[A-Z]", re.MULTILINE)
HEADER_BYTES = 1024 * 1024  # start of a file, which contains its unit
MAX_LINES, MAX_PLACED, MAX_DEPTH = 200_000, 100_000, 20  # placed: entities of blocks
OFF_CURVE_M = 0.005  # largest distance of short lines from their curve
MAX_STEPS = 10_000  # size of a curve over the least distance allowed between the curve and its lines
SHORTEST = 1e-9  # drawing units
SMALLEST_M, LARGEST_M = 0.5, 2000.0  # of a floor
MOST_LISTED = 8
_LINES = frozenset(
    {"LINE", "LWPOLYLINE", "POLYLINE", "ARC", "CIRCLE", "ELLIPSE", "SPLINE", "HELIX", "SOLID", "TRACE"}
)
_CURVES = frozenset({"ARC", "CIRCLE", "ELLIPSE", "SPLINE", "HELIX"})
_NO_WALLS = frozenset(
    {"TEXT", "MTEXT", "ATTRIB", "ATTDEF", "DIMENSION", "ARC_DIMENSION", "LARGE_RADIAL_DIMENSION", "LEADER",
     "MULTILEADER", "TOLERANCE", "POINT", "HATCH", "MPOLYGON", "VIEWPORT", "WIPEOUT", "LIGHT", "SUN", "RAY", "XLINE",
     "ACAD_TABLE", "OLE2FRAME", "SHAPE", "SEQEND", "VERTEX"}
)  # fmt: skip
_HINT = "save it as DXF R2000 or newer"
_UNIT_HINT = "give --scale in meters per unit: 0.001 for millimeters, 0.0254 for inches"
# Exceptions of ezdxf for truncated or damaged files.
_HARMED = (
    ArithmeticError, AssertionError, AttributeError, LookupError, MemoryError, OSError, RecursionError, RuntimeError,
    StopIteration, TypeError, ValueError, struct.error,
)  # fmt: skip


@dataclass(frozen=True)
class LayerRules:
    """Which layers of a drawing are walls.

    Attributes:
        only: patterns of names, one of which must match; empty: all layers.
        without: patterns of names, none of which may match.
    """

    only: tuple[str, ...] = ()
    without: tuple[str, ...] = ()

    def takes(self, layer: str) -> bool:
        """Whether lines on this layer are walls; case is ignored."""

        def fits(patterns: Iterable[str]) -> bool:
            return any(fnmatch.fnmatchcase(layer.lower(), pattern.lower()) for pattern in patterns)

        return (not self.only or fits(self.only)) and not fits(self.without)


ALL_LAYERS = LayerRules()


def parse_layer_rules(text: str) -> LayerRules:
    """Layers from the option ``--layers``; ``not:`` excludes layers, ``*`` matches any letters.

    >>> parse_layer_rules("A-WALL*,not:A-WALL-PATT")
    LayerRules(only=('A-WALL*',), without=('A-WALL-PATT',))
    """
    parts = [part.strip() for part in text.split(",") if part.strip()]
    without = [part[4:].strip() for part in parts if part.lower().startswith("not:")]
    only = [part for part in parts if not part.lower().startswith("not:")]
    return LayerRules(tuple(only), tuple(without))


def read_dxf_lines(
    path: Path, scale_m: float | None = None, curves: bool = True, layers: LayerRules = ALL_LAYERS
) -> list[tuple[FloatArray, FloatArray]]:
    """(2,) ends of all lines in meters, y up, the lowest and leftmost at 0.

    Args:
        scale_m: meters per drawing unit, instead of the file's own $INSUNITS.
        curves: False leaves out circles, arcs, splines and the arcs of polylines.

    Raises:
        InputError: not DXF, no unit, no lines, too large, a layer that does not exist, or a reference to another
            file.
        InputWarning: the unit was replaced; entities that may be walls were omitted; the list of layers.
    """
    document = _document(path)
    unit_m = _unit_m(path, document, scale_m)
    drawing = _Drawing(document, curves, layers, OFF_CURVE_M / unit_m)
    try:
        ends = drawing.lines()
    except OverflowError as error:
        raise InputError(
            "dxf_too_large", f"{path}: {error}", "choose layers with --layers, or cut the plan into parts"
        ) from None
    except _HARMED as error:
        raise InputError("bad_dxf", f"{path}: a damaged entity ({str(error)[:80]})", _HINT) from None
    _check_layers(path, drawing, layers)
    if not len(ends):
        raise _no_lines(path, document, drawing)
    if not np.abs(ends * unit_m).max() < LARGEST:
        raise InputError("dxf_too_large", f"{path}: coordinates that are not finite, or beyond {LARGEST:g} m", _HINT)
    ends = (ends - ends.reshape(-1, 2).min(axis=0)) * unit_m
    _check_extent(path, float(ends.max()), unit_m)
    for sentence in _remarks(path, drawing):
        warn_caller(InputWarning(sentence))
    return [(a, b) for a, b in ends]


def _document(path: Path) -> Drawing:
    try:
        from ezdxf.filemanagement import readfile
        from ezdxf.lldxf.const import DXFError
    except ImportError:
        raise InputError("extra_missing", f"{path}: DXF needs the package ezdxf", EXTRA.format("dxf")) from None
    require_regular(path, "floor plan")
    try:
        if path.stat().st_size > MAX_BYTES:
            raise InputError("file_too_large", f"{path}: larger than {MAX_BYTES >> 20} MiB", "purge the drawing")
        count = len(_RECORD.findall(path.read_bytes()))
    except OSError as error:
        raise unreadable(path, "floor plan", error) from None
    if count > MAX_RECORDS:
        raise InputError(
            "dxf_too_large",
            f"{path}: {count} entities and other records, more than {MAX_RECORDS}",
            "purge the drawing, or save the layers of the walls alone",
        )
    logger = logging.getLogger("ezdxf")
    level, quiet = logger.level, logging.CRITICAL + 1
    logger.setLevel(quiet)
    try:
        return readfile(str(path))
    except (DXFError, *_HARMED) as error:
        raise InputError("bad_dxf", f"{path}: not DXF that can be read ({str(error)[:80]})", _HINT) from None
    finally:
        logger.setLevel(level)


def _unit_m(path: Path, document: Drawing, scale_m: float | None) -> float:
    """Meters per drawing unit."""
    from ezdxf import units
    from ezdxf.enums import InsertUnits

    # ezdxf assumes meters if the file has no unit.
    with path.open("rb") as stream:
        is_stated = b"$INSUNITS" in stream.read(HEADER_BYTES)
    try:
        own = 1 / units.conversion_factor(InsertUnits.Meters, InsertUnits(int(document.header["$INSUNITS"])))
    except (KeyError, IndexError, TypeError, ValueError):
        own = None
    own = own if is_stated else None
    if own is None and scale_m is None:
        raise InputError("no_scale", f"{path}: its unit is unknown ($INSUNITS is missing or 0)", _UNIT_HINT)
    if own is None or scale_m is None:
        return scale_m or own or 1.0
    if abs(scale_m / own - 1) > 1e-6:
        name = units.unit_name(document.header["$INSUNITS"]).lower()
        sentence = f"{path}: the file says that its unit is {name} ({own:g} m); --scale {scale_m:g} is used"
        warn_caller(InputWarning(sentence))
    return scale_m


def _check_extent(path: Path, extent_m: float, unit_m: float) -> None:
    """Refuse a plan of implausible size, whose file has the wrong unit.

    Raises:
        InputError: names the size.
    """
    if not SMALLEST_M <= extent_m <= LARGEST_M:
        raise InputError(
            "bad_unit", f"{path}: {extent_m:.4g} m long if its unit is {unit_m:g} m, which no floor is", _UNIT_HINT
        )


class _Drawing:
    """Lines of the model space, counted by layer."""

    def __init__(self, document: Drawing, curves: bool, layers: LayerRules, off_curve: float) -> None:
        self.document, self.curves, self.layers, self.off_curve = document, curves, layers, off_curve
        self.placed = self.count = 0
        self.by_layer: Counter[str] = Counter()
        self.left_out: Counter[str] = Counter()  # kinds of entities that may be walls
        self.hidden: set[str] = set()

    def lines(self) -> FloatArray:
        """(N,2,2) ends, in drawing units."""
        found = [ends for entity in self.document.modelspace() for ends in self._lines_of(entity, "0", 0)]
        return np.vstack(found) if found else np.empty((0, 2, 2))

    def _lines_of(self, entity: DXFGraphic, inherited: str, depth: int) -> Iterator[FloatArray]:
        """Lines of an entity.

        Args:
            inherited: layer of its block, used by entities on layer 0.
        """
        self.placed += depth > 0
        if depth > MAX_DEPTH or self.placed > MAX_PLACED:
            raise OverflowError(f"blocks nested more than {MAX_DEPTH} deep, or of more than {MAX_PLACED} entities")
        kind, own = entity.dxftype(), str(entity.dxf.get("layer", "0"))
        layer = inherited if own == "0" and depth else own
        if entity.dxf.get("invisible", 0):
            return
        if kind == "INSERT":
            yield from self._block(entity, layer, depth)  # type: ignore[arg-type]
        elif kind == "MLINE":
            for part in entity.virtual_entities():  # type: ignore[attr-defined]
                yield from self._lines_of(part, layer, depth + 1)
        elif kind in _NO_WALLS or not self._shown(layer):
            return
        elif kind not in _LINES or (kind == "POLYLINE" and not _is_line(entity)):
            self.left_out[kind] += self.layers.takes(layer)
        else:
            ends = self._drawn(entity, kind)
            self.by_layer[layer] += len(ends)
            if self.layers.takes(layer):
                self.count += len(ends)
                if self.count > MAX_LINES:
                    raise OverflowError(f"more than {MAX_LINES} lines")
                yield ends

    def _block(self, insert: Insert, layer: str, depth: int) -> Iterator[FloatArray]:
        block = insert.block()
        if self._is(layer, "is_frozen"):
            self.hidden.add(layer)
            return
        if block is None:
            return
        if block.block is not None and (block.block.is_xref or block.block.is_xref_overlay):
            if self._shown(layer) and self.layers.takes(layer):
                name = str(block.block.dxf.get("xref_path", insert.dxf.name))[:60]
                self.left_out[f"reference to {name}"] += 1
            return
        if insert.mcount > MAX_PLACED:
            raise OverflowError(f"a block repeated more than {MAX_PLACED} times")
        for one in insert.multi_insert() if insert.mcount > 1 else (insert,):
            for part in one.virtual_entities():
                yield from self._lines_of(part, layer, depth + 1)

    def _shown(self, layer: str) -> bool:
        if layer.lower() == "defpoints":  # AutoCAD never prints it
            return False
        hidden = self._is(layer, "is_frozen") or self._is(layer, "is_off")
        if hidden:
            self.hidden.add(layer)
        return not hidden

    def _is(self, layer: str, state: str) -> bool:
        layers = self.document.layers
        return layer in layers and bool(getattr(layers.get(layer), state)())

    def _drawn(self, entity: DXFGraphic, kind: str) -> FloatArray:
        """(N,2,2) ends of the lines of an entity that has no parts."""
        from ezdxf.path import Command, make_path

        if kind in _CURVES and not self.curves:
            return np.empty((0, 2, 2))
        path = make_path(entity)
        extent = max((max(abs(p.x), abs(p.y)) for p in path.control_vertices()), default=0.0)
        # Flattening a curve this far away would not end.
        if not extent * OFF_CURVE_M / self.off_curve < LARGEST:
            raise OverflowError("coordinates that are not finite, or too large")
        if self.curves:
            size = float(np.ptp([(p.x, p.y) for p in path.control_vertices()] or [(0.0, 0.0)], axis=0).max())
            points = np.array([(p.x, p.y) for p in path.flattening(max(self.off_curve, size / MAX_STEPS))])
            ends = np.stack([points[:-1], points[1:]], axis=1) if len(points) else np.empty((0, 2, 2))
        else:
            at, kept = path.start, []
            for command in path.commands():
                if command.type == Command.LINE_TO:
                    kept.append(((at.x, at.y), (command.end.x, command.end.y)))
                at = command.end
            ends = np.array(kept).reshape(-1, 2, 2)
        return np.asarray(ends[~(np.abs(ends[:, 0] - ends[:, 1]).max(axis=1, initial=0.0) <= SHORTEST)])


def _is_line(polyline: Any) -> bool:
    return bool(polyline.is_2d_polyline or polyline.is_3d_polyline)


def _check_layers(path: Path, drawing: _Drawing, layers: LayerRules) -> None:
    """Refuse patterns that match no layer with lines.

    Raises:
        InputError: names the existing layers.
    """
    names = {*drawing.by_layer, *(layer.dxf.name for layer in drawing.document.layers)}
    for pattern in (*layers.only, *layers.without):
        if not any(LayerRules((pattern,)).takes(name) for name in names):
            listed = _listed(drawing.by_layer) or "none"
            raise InputError(
                "unknown_layer", f"{path}: no layer is named {pattern!r}", f"layers with lines: {listed}"
            )


def _no_lines(path: Path, document: Drawing, drawing: _Drawing) -> InputError:
    hint = "draw the walls as lines or polylines in the model space, on layers that are on"
    if drawing.by_layer:
        hint = f"layers with lines: {_listed(drawing.by_layer)}"
    elif drawing.left_out:
        hint = f"it contains {_listed(drawing.left_out)}, which are not read: explode or bind them, then save"
    elif drawing.hidden:
        hint = f"layers that are off or frozen: {', '.join(sorted(drawing.hidden)[:MOST_LISTED])}"
    elif any(len(document.layout(name)) > 1 for name in document.layout_names() if name != "Model"):
        hint = "its lines are in a paper layout: draw the walls in the model space"
    return InputError("no_walls", f"{path}: the model space contains no line that is shown", hint)


def _remarks(path: Path, drawing: _Drawing) -> Iterator[str]:
    """Sentences on omitted entities, and on layers to choose from."""
    if drawing.left_out:
        yield f"{path}: left out: {_listed(drawing.left_out)}; explode or bind what are walls"
    used = Counter({name: n for name, n in drawing.by_layer.items() if n and drawing.layers.takes(name)})
    if len(used) > 1 and drawing.layers == ALL_LAYERS:
        yield f"{path}: lines by layer: {_listed(used)}; choose with --layers NAME,... or not:NAME,..."


def _listed(counts: Counter[str]) -> str:
    named = [f"{name} ({n})" for name, n in counts.most_common(MOST_LISTED)]
    more = len(counts) - len(named)
    return ", ".join(named) + (f" and {more} more" if more > 0 else "")
