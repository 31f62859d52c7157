"""Vector file as a layer of a sheet."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from pyproj import CRS

from geomosaic.errors import InputError, did_you_mean, warn
from geomosaic.geo.crs import horizontal, is_local, parse_crs
from geomosaic.geo.grid import Bounds
from geomosaic.geo.transform import Transform
from geomosaic.numbers import quantile_breaks
from geomosaic.raster.vector import layer_counts, read_layer
from geomosaic.sheets.page import Page
from geomosaic.sheets.style import (
    Fill,
    Line,
    Marker,
    Ramp,
    Rule,
    Style,
    StyleChange,
    Symbol,
    blend,
    changed,
    plain,
    value_text,
)
from geomosaic.types import AnyArray, FloatArray

KINDS = ("polygon", "line", "point")


@dataclass(frozen=True)
class Features:
    """Objects of one symbol: geometries in the map's CRS, cut at the neatline, and their legend entry."""

    title: str
    symbol: Symbol
    geometries: tuple[Any, ...]


@dataclass(frozen=True)
class LabelRequest:
    """A label to be placed: its text and the geometry (cut at the neatline) that it names."""

    text: str
    geometry: Any


@dataclass(frozen=True)
class Overlay:
    """A layer as it is drawn.

    Attributes
    ----------
    title : str, of the layer
    groups : tuple of Features, lowest first
    names : tuple of Name
    style : Style
    notes : tuple of str, what was not drawn as the style has it, and why
    """

    title: str
    groups: tuple[Features, ...]
    names: tuple[LabelRequest, ...]
    style: Style
    notes: tuple[str, ...]

    @property
    def count(self) -> int:
        """Number of objects drawn; of names, where the style has nothing else."""
        return sum(len(group.geometries) for group in self.groups) if self.groups else len(self.names)


def to_map(geometries: AnyArray, crs: CRS, map_crs: CRS, bounds: Bounds, straight: float) -> AnyArray:
    """Geometries reprojected and cut a little outside the neatline; None or empty where nothing is left.

    Parameters
    ----------
    geometries : array (N,) of shapely geometry
    crs, map_crs : CRS
    bounds : Bounds, neatline in `map_crs`
    straight : float
        In units of `map_crs`: long sides are divided first, so that they bend as the map does, into pieces of about
        this length.
    """
    shapes = shapely.force_2d(geometries)
    flat, target = horizontal(crs), horizontal(map_crs)
    if not flat.equals(target, ignore_axis_order=True):
        operation = Transform(flat, target)
        shapes = shapely.segmentize(shapes, max_segment_length=_in_units_of(flat, straight, target, bounds))

        def move(points: FloatArray) -> FloatArray:
            moved = operation(np.asarray(points, dtype=np.float64))
            return np.where(np.isfinite(moved), moved, 1e30)  # far off: cut away below

        shapes = shapely.transform(shapes, move)
    # Invalid areas would make the intersection below fail.
    shapes = np.where(shapely.is_valid(shapes), shapes, shapely.make_valid(shapes))
    # A little outside: the edge of an area that goes on beyond the sheet is not drawn along the neatline.
    reach = 0.02 * (bounds[2] - bounds[0])
    outer = shapely.box(bounds[0] - reach, bounds[1] - reach, bounds[2] + reach, bounds[3] + reach)
    cut: AnyArray = np.array(shapely.intersection(shapes, outer), dtype=object)
    cut[~shapely.intersects(cut, shapely.box(*bounds))] = None
    return cut


def _in_units_of(crs: CRS, length: float, map_crs: CRS, bounds: Bounds) -> float:
    """A length on the map in units of another CRS, at the middle of the map."""
    x, y = (bounds[0] + bounds[2]) / 2, (bounds[1] + bounds[3]) / 2
    ends = Transform(map_crs, crs)(np.array([[x, y], [x + length, y], [x, y + length]]))
    sides = np.hypot(*(ends[1:] - ends[0]).T)
    return float(sides.min()) if np.isfinite(sides).all() else length


def overlay(
    geometries: Sequence[Any],
    columns: Mapping[str, Sequence[Any]],
    crs: CRS,
    style: Style,
    title: str,
    page: Page,
    where: str,
) -> Overlay:
    """Overlay of a vector layer: objects by symbol, and labels.

    Parameters
    ----------
    geometries : sequence of shapely geometry or None, in `crs`
    columns : mapping of str to sequence, one value per geometry
    crs : CRS
    style : Style
    title : str, of the layer, where the style has none
    page : Page, whose CRS and neatline cut them
    where : str, file, named in errors

    Raises
    ------
    InputError
        A column that the style names is missing or has no numbers.
    """
    notes = []
    shapes = np.array(list(geometries), dtype=object)
    cut = to_map(shapes, crs, page.crs, page.bounds, 2.0 / page.mm_per_unit) if len(shapes) else shapes
    here = [i for i, shape in enumerate(cut) if shape is not None and not shape.is_empty]
    if not here:
        notes.append("no object lies on the sheet" if len(shapes) else "the layer is empty")
    rules, column = style.rules, style.column
    if style.ramp is not None:
        column = style.ramp.column
        rules = _ramp_rules(style.ramp, _numbers(columns, column, where), style.symbol)
    members: dict[int, list[Any]] = {}
    hidden: set[int] = set()
    if rules:
        cells = _column(columns, column, where)
        lost = 0
        for i in here:
            number = next((n for n, rule in enumerate(rules) if rule_matches(rule, cells[i])), -1)
            lost += number < 0
            members.setdefault(number, []).append(cut[i])
            if rules[number].hide if number >= 0 else style.symbol == Symbol():
                hidden.add(i)
        if lost:
            what = "drawn as [line], [fill] and [marker] have it" if style.symbol != Symbol() else "not drawn"
            notes.append(f"{lost} of {len(here)} objects have a value of '{column}' that no rule names: {what}")
    else:
        members[-1] = [cut[i] for i in here]
    name = style.title or title
    groups = []
    if members.get(-1) and style.symbol != Symbol():
        groups.append(Features("other" if rules else name, style.symbol, tuple(members[-1])))
    same: dict[tuple[str, Symbol], list[Any]] = {}  # rules of one name and one look are one entry of the legend
    for n, rule in enumerate(rules):
        if members.get(n) and not rule.hide:
            same.setdefault((rule.name, Symbol(rule.line, rule.fill, rule.marker)), []).extend(members[n])
    groups += [Features(title, symbol, tuple(found)) for (title, symbol), found in same.items()]
    bare = sorted({kind for group in groups for kind in _without_symbol(group)}, key=KINDS.index)
    if bare:
        notes.append(f"the style has nothing for {' and '.join(f'{kind}s' for kind in bare)}: not drawn")
    names: list[LabelRequest] = []
    if style.label is not None:
        cells = _column(columns, style.label.column, where)
        for i in here:
            text = _label_text(cells[i], style.label.decimals)
            if text and i not in hidden:
                names.append(LabelRequest(text, cut[i]))
        names.sort(key=lambda item: -shapely.length(item.geometry))
    return Overlay(name, tuple(groups), tuple(names), style, tuple(notes))


def _without_symbol(group: Features) -> list[str]:
    """Kinds of geometry of which a group has some and its symbol draws none."""
    symbol = group.symbol
    drawn = {"polygon": symbol.fill or symbol.line, "line": symbol.line, "point": symbol.marker}
    return [kind for kind in KINDS if not drawn[kind] and parts_of(group.geometries, kind)]


def _column(columns: Mapping[str, Sequence[Any]], name: str, where: str) -> Sequence[Any]:
    if name not in columns:
        hint = did_you_mean(name, columns)
        raise InputError(
            f"the layer has no column '{name}'", where=where, hint=hint or f"it has {', '.join(columns) or 'none'}"
        )
    return columns[name]


def _numbers(columns: Mapping[str, Sequence[Any]], name: str, where: str) -> FloatArray:
    try:
        values = np.array([math.nan if v is None else float(v) for v in _column(columns, name, where)])
    except (TypeError, ValueError):
        values = np.array([])
    if not np.isfinite(values).any():
        raise InputError(
            f"column '{name}' has no numbers to make classes of", where=where, hint="name a column of numbers"
        )
    return values


def _ramp_rules(ramp: Ramp, values: FloatArray, base: Symbol) -> tuple[Rule, ...]:
    """Classes of numbers with colours between two, evenly."""
    limits = [None, *quantile_breaks(values, ramp.count, ramp.method), None]
    steps = max(1, len(limits) - 2)
    rules = []
    for k, (least, below) in enumerate(itertools.pairwise(limits)):
        shade = blend(ramp.start, ramp.end, k / steps)
        line = Line(shade, 0.5) if base.line is None else _recolored(base.line, shade, base.fill is None)
        fill = Fill(shade, 0.7) if base.fill is None else _recolored(base.fill, shade, True)
        marker = Marker(color=shade) if base.marker is None else _recolored(base.marker, shade, True)
        edge = base.line if base.fill is not None else None
        rules.append(Rule(least=least, below=below, line=edge or line, fill=fill, marker=marker))
    return tuple(rules)


def _recolored(part: Any, shade: str, change: bool) -> Any:
    return replace(part, color=shade) if change else part


def rule_matches(rule: Rule, cell: Any) -> bool:
    """Whether a cell is what a rule names.

    Parameters
    ----------
    rule : Rule
    cell : object
    """
    if rule.value is not None:
        return not is_missing(cell) and (value_text(cell) == rule.value or _equal(cell, rule.value))
    try:
        value = float(cell)
    except (TypeError, ValueError):
        return False
    return (rule.least is None or value >= rule.least) and (rule.below is None or value < rule.below)


def _equal(cell: Any, value: str) -> bool:
    """Whether a number equals the number that a text writes, such as 1 and '1.0'."""
    if isinstance(cell, str | bool):
        return False
    try:
        return float(cell) == float(value)
    except (TypeError, ValueError):
        return False


def is_missing(cell: Any) -> bool:
    """Whether a cell has no value: None, NaN, NaT, or blank.

    Parameters
    ----------
    cell : object
    """
    return cell is None or cell != cell or (isinstance(cell, str) and not cell.strip())


def _label_text(cell: Any, digits: int | None = None) -> str:
    """Text of a label, '' where there is none."""
    if is_missing(cell):
        return ""
    if digits is not None and not isinstance(cell, str):
        return f"{float(cell):.{digits}f}"
    return value_text(cell.item() if isinstance(cell, np.generic) else cell).strip()


def parts_of(geometries: Sequence[Any], kind: str) -> list[Any]:
    """Simple parts of one kind ('polygon', 'line' or 'point'), collections taken apart.

    Parameters
    ----------
    geometries : sequence of shapely geometry
    kind : str
    """
    names = {"polygon": ("Polygon",), "line": ("LineString", "LinearRing"), "point": ("Point",)}[kind]
    found: list[Any] = []
    for geometry in geometries:
        stack = [geometry]
        while stack:
            part = stack.pop()
            if part.geom_type.startswith("Multi") or part.geom_type == "GeometryCollection":
                stack.extend(reversed(shapely.get_parts(part).tolist()))
            elif part.geom_type in names and not part.is_empty:
                found.append(part)
    return found


# Colours of layers without a style, in turn; red first, since it is rare in pictures of the ground.
COLORS = ("#d7191c", "#2c6fbb", "#f58231", "#7b3294", "#1a9641", "#00a6c8")


@dataclass(frozen=True)
class VectorInput:
    """Vector file with layer (the first by default), style and its changes, and title."""

    path: Path
    layer: str | None = None
    style: Style | None = None
    title: str = ""
    change: StyleChange = field(default_factory=StyleChange)


def read_overlay(vector: VectorInput, page: Page, number: int) -> Overlay:
    """Vector layer in the CRS of the map; in a local frame vectors without a CRS are used unchanged.

    Parameters
    ----------
    vector : VectorInput
    page : Page
    number : int, of the layer: chooses the colour where it has no style

    Raises
    ------
    InputError
        The file cannot be read, has no CRS, or one that has nothing to do with a local frame.
    """
    name = vector.layer or _first_layer(vector.path)
    frame = read_layer(vector.path, name)
    where = f"{vector.path}, layer '{vector.layer}'" if vector.layer else str(vector.path)
    local = is_local(page.crs)
    if frame.crs is None and not local:
        raise InputError(
            "the layer has no CRS", where=where, hint="assign one: ogr2ogr -a_srs EPSG:... OUT IN, or add a .prj file"
        )
    # WKT between the libraries: each has a PROJ of its own.
    crs = page.crs if frame.crs is None else horizontal(parse_crs(frame.crs.to_wkt(), where))
    if local and not is_local(crs):
        raise InputError(
            f"the layer is in '{crs.name}', the map in the local frame '{page.crs.name}'",
            where=where,
            hint="give vectors in the coordinates of the map, without a CRS",
        )
    crs = page.crs if local else crs
    geometries = list(frame.geometry)
    known = [geometry for geometry in geometries if geometry is not None]
    kind = next((kind for kind in KINDS if parts_of(known, kind)), "point")
    style = changed(vector.style or plain(kind, COLORS[number % len(COLORS)]), vector.change, where)
    columns = {str(name): frame[name].tolist() for name in frame.columns if name != frame.geometry.name}
    title = vector.title or (vector.layer or vector.path.stem).replace("_", " ")
    made = overlay(geometries, columns, crs, style, title, page, where)
    if vector.title and vector.title != made.title:
        made = replace(made, title=vector.title)
    for note in made.notes:
        warn(f"{where}: {note}")
    return made


def _first_layer(path: Path) -> str | None:
    """The first layer that has objects; the others that have some are named in a note."""
    full = [name for name, count in layer_counts(path).items() if count]
    # GPX has each track a second time, as its points.
    others = [name for name in full[1:] if name not in ("track_points", "route_points")]
    if others:
        warn(f"{path}: layer '{full[0]}' is drawn; name one with FILE#LAYER for {', '.join(others)}")
    return full[0] if full else None
