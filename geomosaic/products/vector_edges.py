"""Edge-matched vectors: lines of neighbouring map sheets joined at their ends, attributes compared."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pyproj import CRS

from geomosaic.errors import InputError, counted, warn
from geomosaic.geo.crs import horizontal
from geomosaic.geo.transform import Transform
from geomosaic.options.declaration import compose
from geomosaic.options.vector_edges import VectorEdgeOptions
from geomosaic.orientation.edges.line_ends import Bend, LineEnds, adjusted_places, meeting_ends, turns_back
from geomosaic.raster.files import check_output
from geomosaic.raster.vector import (
    VectorProduct,
    append_layer,
    layer_names,
    plain_tables,
    read_layer,
)
from geomosaic.stores.path import given_path
from geomosaic.types import BoolArray, FloatArray, IntArray, PathLike
from geomosaic.whole_files import under_construction

if TYPE_CHECKING:
    from geopandas import GeoDataFrame

# The correction ends at so many times the tolerance.
REACH = 20.0
# The direction of a line at its end is that over so many times the tolerance.
ALONG = 3.0


@dataclass(frozen=True)
class VectorEdges(VectorProduct):
    """Sheets joined at their edges; `read` gives the layers of the file.

    Attributes
    ----------
    path : Path
    sheets : tuple of str
    places : int
        At which ends of two or more sheets meet.
    before : tuple of float
        RMS and largest distance of the ends that meet, as they were, map units; NaN without any.
    after : float
        The largest as they are written.
    moved : tuple of float
        Largest displacement of a vertex of each sheet, map units.
    unmatched : int
        Ends beside a neighbour that met none.
    differences : int
        Attributes that differ where lines meet.
    """

    path: Path
    sheets: tuple[str, ...]
    places: int
    before: tuple[float, float]
    after: float
    moved: tuple[float, ...]
    unmatched: int
    differences: int


@dataclass(frozen=True, eq=False)
class _Ends:
    """Line ends with the sheet, layer and row that each is of."""

    ends: LineEnds
    layer: list[str]
    row: IntArray


def match_vector_edges(
    sheets: Sequence[PathLike], output: PathLike, *, overwrite: bool = False, **options: Any
) -> VectorEdges:
    """Lines of neighbouring map sheets joined where they end at the common edge.

    Ends within the tolerance meet in their mean weighted by the sigmas of the sheets; each sheet is bent to it,
    smoothly and less and less with the distance, so that what hangs together in a sheet stays so. Points and areas
    move along.

    Parameters
    ----------
    sheets : sequence of path
        Vector files in one CRS, or in any that can be transformed to that of the first.
    output : path
        GeoPackage: the layers of the sheets with a column `sheet`, and `edge_joins`, `edge_unmatched` and
        `edge_differences`.
    overwrite : bool
        Replace an existing file.
    **options
        Of `VectorEdgeOptions`: `tolerance`, `same`, `sigma`, `reach`.

    Returns
    -------
    VectorEdges

    Raises
    ------
    InputError
        Fewer than two sheets, one without CRS, a column that is not there, no line.
    OutputError, OutputExistsError
    """
    asked = compose(VectorEdgeOptions, options)
    paths, output = [given_path(path) for path in sheets], given_path(output)
    if len(paths) < 2:
        raise InputError("edges are matched between two sheets or more", where="`sheets`", hint="name another file")
    if twice := [str(path) for path in paths if [each.resolve() for each in paths].count(path.resolve()) > 1]:
        raise InputError("the sheet is given twice", where=twice[0], hint="name each sheet once")
    if output.suffix.lower() != ".gpkg":
        raise InputError("edge-matched sheets are written as GeoPackage", where=str(output), hint="end in .gpkg")
    if len(asked.sigma) not in (0, len(paths)):
        what = f"{counted(len(asked.sigma), 'standard deviation')} for {len(paths)} sheets"
        raise InputError(what, where="`sigma`", hint="give one for each, in their order")
    check_output(output, overwrite=overwrite, inputs=paths)
    frames, crs = _read(paths)
    found = _line_ends(frames, asked)
    groups = meeting_ends(found.ends, asked.tolerance)
    sigma = np.array(asked.sigma or [1.0] * len(paths))
    places = adjusted_places(found.ends, groups, sigma)
    shift = np.full(found.ends.xy.shape, np.nan)
    for place, members in zip(places, groups, strict=True):
        shift[members] = place - found.ends.xy[members]
    reach = asked.reach or REACH * asked.tolerance
    bends = []
    for number in range(len(paths)):
        own = (found.ends.sheet == number) & np.isfinite(shift[:, 0])
        bends.append(Bend.through(found.ends.xy[own], shift[own], reach))
    unmatched = _unmatched(found, frames, np.isfinite(shift[:, 0]), asked.tolerance)
    differences = _differences(found, frames, groups, places, asked.same)
    names = _sheet_names(paths)
    joins = _joins(found, groups, places, names)
    records = {"edge_joins": joins, "edge_unmatched": _named(unmatched, names), "edge_differences": differences}
    moved, after = _write(output, frames, bends, (names, crs), records, (found, groups, places))
    apart = np.array(joins["distance"])
    rms = float(np.sqrt(np.mean(apart**2))) if len(apart) else float("nan")
    return VectorEdges(
        output, tuple(names), len(groups), (rms, float(apart.max(initial=-np.inf)) if len(apart) else float("nan")),
        after, moved, len(unmatched["x"]), len(differences["x"]),
    )  # fmt: skip


def _sheet_names(paths: Sequence[Path]) -> list[str]:
    """Names of the files, with as many folders as tell all of them apart."""
    parts = [path.resolve().parts for path in paths]
    deep = next(n for n in range(1, max(map(len, parts)) + 1) if len({each[-n:] for each in parts}) == len(parts))
    return ["/".join(each[-deep:]) for each in parts]


def _read(paths: Sequence[Path]) -> tuple[list[dict[str, GeoDataFrame]], CRS]:
    """Layers of each sheet by name, in the CRS of the first; the only layers of single-layer files are one layer."""
    import shapely

    crs: CRS | None = None
    out: list[dict[str, GeoDataFrame]] = []
    for path in paths:
        tables = plain_tables(path) if (names := layer_names(path)) else []
        layers = {}
        for name in (each for each in names if each not in tables):
            frame = read_layer(path, name)
            if frame.crs is None:
                hint = "assign one, or place the sheet with `geomosaic georeference`"
                raise InputError("the layer has no CRS", where=f"{path}, layer {name}", hint=hint)
            own = horizontal(CRS.from_user_input(frame.crs))
            crs = crs or own
            if not own.equals(crs):
                change = Transform(own, crs)
                shapes = shapely.transform(np.asarray(frame.geometry.values), change, include_z=False)
                frame = frame.set_geometry(shapes).set_crs(crs, allow_override=True)
            layers[name] = frame.reset_index(drop=True)
        out.append(layers)
    assert crs is not None
    if all(len(layers) == 1 for layers in out):
        name = next(iter(out[0]))
        out = [{name: next(iter(layers.values()))} for layers in out]
    return out, crs


def _line_ends(frames: Sequence[Mapping[str, GeoDataFrame]], asked: VectorEdgeOptions) -> _Ends:
    """Ends of lines at which no other line of their sheet goes on."""
    import shapely

    xy, sheet, layer, row, outward, kinds = [], [], [], [], [], []
    for number, layers in enumerate(frames):
        lines: list[tuple[str, int, FloatArray]] = []
        for name, frame in layers.items():
            missing = [column for column in asked.same if column not in frame.columns]
            for k, geometry in enumerate(frame.geometry.values):
                parts = shapely.get_parts(geometry) if geometry is not None else ()
                own = [shapely.get_coordinates(part) for part in parts if part.geom_type == "LineString"]
                if own and missing:
                    raise InputError(
                        f"there is no column '{missing[0]}'", where=f"`same`, layer {name}", hint="name another"
                    )
                lines += [(name, k, vertices) for vertices in own if len(vertices) > 1]
        if not lines:
            raise InputError(
                "the sheet has no line", where=f"sheet {number + 1}", hint="edges are matched between lines"
            )
        _, inverse, uses = np.unique(
            np.vstack([vertices for *_, vertices in lines]), axis=0, return_inverse=True, return_counts=True
        )
        once, start = uses[inverse.ravel()] == 1, 0
        for name, k, vertices in lines:
            for index, inward in ((0, 1), (-1, -1)):
                if once[start + index % len(vertices)]:
                    xy.append(vertices[index])
                    outward.append(_outward(vertices[::inward], ALONG * asked.tolerance))
                    sheet.append(number)
                    layer.append(name)
                    row.append(k)
                    kinds.append((name, *(str(layers[name][column].iloc[k]) for column in asked.same)))
            start += len(vertices)
    code = {kind: number for number, kind in enumerate(dict.fromkeys(kinds))}
    ends = LineEnds(
        np.array(xy).reshape(-1, 2), np.array(sheet, dtype=np.int64),
        np.array([code[kind] for kind in kinds], dtype=np.int64), np.array(outward).reshape(-1, 2),
    )  # fmt: skip
    return _Ends(ends, layer, np.array(row, dtype=np.int64))


def _outward(vertices: FloatArray, length: float) -> FloatArray:
    """Unit direction in which a line ends at its first vertex, over some length of it."""
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(vertices, axis=0).T))])
    inner = [np.interp(min(length, along[-1]), along, vertices[:, k]) for k in (0, 1)]
    step: FloatArray = vertices[0] - np.array(inner)
    return np.asarray(step / max(float(np.hypot(*step)), 1e-300))


def _unmatched(
    found: _Ends, frames: Sequence[Mapping[str, GeoDataFrame]], met: BoolArray, tolerance: float
) -> dict[str, list[Any]]:
    """Ends within the tolerance of a neighbour's extent that met none, with the nearest end there and what hinders."""
    ends = found.ends
    boxes = np.array([_extent(layers) for layers in frames])
    out: dict[str, list[Any]] = {
        name: [] for name in ("x", "y", "sheet", "layer", "row", "neighbour", "nearest", "why")
    }
    for k in np.flatnonzero(np.logical_not(met)):
        beyond = np.maximum(np.maximum(boxes[:, :2] - ends.xy[k], ends.xy[k] - boxes[:, 2:]), 0.0)
        beside = [n for n in np.flatnonzero(np.hypot(*beyond.T) <= tolerance) if n != ends.sheet[k]]
        if not beside:
            continue
        others = np.flatnonzero(np.isin(ends.sheet, beside))
        apart = np.hypot(*(ends.xy[others] - ends.xy[k]).T)
        order = np.argsort(apart)
        near, distance = int(others[order[0]]), float(apart[order[0]])
        if distance > tolerance:
            why = "no end within the tolerance"
        elif ends.kind[near] != ends.kind[k]:
            why = "the nearest end is of another layer or kind"
        elif turns_back(ends, np.array([near]), np.array([k]))[0]:
            why = "the nearest line turns back"
        else:
            why = "the nearest end met another"
        x, y = ends.xy[k].tolist()
        values = (x, y, int(ends.sheet[k]), found.layer[k], int(found.row[k]) + 1, int(ends.sheet[near]), distance, why)
        for column, value in zip(out.values(), values, strict=True):
            column.append(value)
    return out


def _extent(layers: Mapping[str, GeoDataFrame]) -> FloatArray:
    """Left, bottom, right, top of a sheet."""
    bounds = np.array([frame.total_bounds for frame in layers.values() if len(frame)])
    return np.concatenate([np.nanmin(bounds[:, :2], axis=0), np.nanmax(bounds[:, 2:], axis=0)])


def _differences(
    found: _Ends,
    frames: Sequence[Mapping[str, GeoDataFrame]],
    groups: Sequence[IntArray],
    places: FloatArray,
    same: tuple[str, ...],
) -> dict[str, list[Any]]:
    """Attributes of common columns that differ where lines meet."""
    out: dict[str, list[Any]] = {name: [] for name in ("x", "y", "layer", "column", "rows", "values")}
    for place, members in zip(places.tolist(), groups, strict=True):
        rows = [frames[found.ends.sheet[k]][found.layer[k]].iloc[int(found.row[k])] for k in members]
        columns = [name for name in rows[0].index if all(name in row.index for row in rows)]
        for name in columns:
            if name in (*same, "geometry"):
                continue
            values = ["" if row[name] is None or row[name] != row[name] else str(row[name]) for row in rows]
            if len(set(values)) > 1:
                numbers = ", ".join(str(int(found.row[k]) + 1) for k in members)
                found_here = (*place, found.layer[int(members[0])], str(name), numbers, " | ".join(values))
                for column, value in zip(out.values(), found_here, strict=True):
                    column.append(value)
    return out


def _joins(found: _Ends, groups: Sequence[IntArray], places: FloatArray, names: Sequence[str]) -> dict[str, list[Any]]:
    """Places where ends meet: sheets, largest distance between them, and how far each was moved."""
    out: dict[str, list[Any]] = {name: [] for name in ("x", "y", "layer", "sheets", "distance", "moved")}
    for place, members in zip(places, groups, strict=True):
        at = found.ends.xy[members]
        apart = float(np.hypot(*(at[:, None] - at[None]).transpose(2, 0, 1)).max())
        moved = ", ".join(f"{length:.4g}" for length in np.hypot(*(place - at).T))
        sheets = ", ".join(names[n] for n in found.ends.sheet[members])
        for column, value in zip(
            out.values(), (*place.tolist(), found.layer[members[0]], sheets, apart, moved), strict=True
        ):
            column.append(value)
    return out


def _named(records: dict[str, list[Any]], names: Sequence[str]) -> dict[str, list[Any]]:
    return {
        name: [names[value] for value in values] if name in ("sheet", "neighbour") else values
        for name, values in records.items()
    }


def _write(
    output: Path,
    frames: Sequence[Mapping[str, GeoDataFrame]],
    bends: Sequence[Bend],
    named: tuple[Sequence[str], CRS],
    records: Mapping[str, dict[str, list[Any]]],
    met: tuple[_Ends, Sequence[IntArray], FloatArray],
) -> tuple[tuple[float, ...], float]:
    """Write the bent sheets and what was found; largest displacement of each sheet, and misfit of ends after it."""
    import geopandas
    import pandas
    import shapely

    names, crs = named
    largest, turned = [0.0] * len(names), 0
    with under_construction(output, ".gpkg") as unfinished:
        for layer in dict.fromkeys(name for layers in frames for name in layers):
            made = []
            for number, layers in enumerate(frames):
                if layer not in layers:
                    continue
                frame = layers[layer]
                before = np.asarray(frame.geometry.values)

                def bent(xy: FloatArray, bend: Bend = bends[number]) -> FloatArray:
                    return xy + bend.at(xy)

                after = _moved(before, bent)
                a, owner = shapely.get_coordinates(before, return_index=True)
                b = shapely.get_coordinates(after)
                if len(a):
                    largest[number] = max(largest[number], float(np.hypot(*(b - a).T).max()))
                    back = (np.diff(a, axis=0) * np.diff(b, axis=0)).sum(axis=1) < 0.0
                    turned += int((back & (owner[1:] == owner[:-1])).sum())
                made.append(frame.set_geometry(after).assign(sheet=names[number]))
            joined = geopandas.GeoDataFrame(pandas.concat(made, ignore_index=True), crs=crs)
            append_layer(unfinished, joined, layer, "GPKG")
        for name, columns in records.items():
            points = shapely.points(np.column_stack([columns["x"], columns["y"]]) if columns["x"] else np.empty((0, 2)))
            rest = {key: value for key, value in columns.items() if key not in ("x", "y")}
            append_layer(unfinished, geopandas.GeoDataFrame(rest, geometry=points, crs=crs), name, "GPKG")
    if turned:
        warn(
            f"{output}: {counted(turned, 'segment')} shorter than the correction along them turned back: give a larger "
            "`reach`, or a smaller `tolerance`"
        )
    found, groups, places = met
    off = [0.0]
    for place, members in zip(places, groups, strict=True):
        for k in members:
            at = found.ends.xy[k : k + 1]
            off.append(float(np.hypot(*(at + bends[found.ends.sheet[k]].at(at) - place).T)[0]))
    return tuple(largest), max(off)


def _moved(geometries: Any, bent: Callable[[FloatArray], FloatArray]) -> Any:
    """Geometries with x and y changed; z, where there is one, stays."""
    import shapely

    deep = np.asarray(shapely.has_z(geometries), dtype=bool)
    out = geometries.copy()
    out[deep] = shapely.transform(
        geometries[deep], lambda xyz: np.column_stack([bent(xyz[:, :2]), xyz[:, 2]]), include_z=True
    )
    flat = np.logical_not(deep)
    out[flat] = shapely.transform(geometries[flat], bent)
    return out
