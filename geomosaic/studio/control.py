"""Control of a project's images: table, live solution, next point, expected places and sub-pixel measurement."""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from pyproj import CRS

from geomosaic.block import OrientedImage
from geomosaic.control.edit import ControlText, TableRow
from geomosaic.control.points import ControlPoints
from geomosaic.control.read import read_control_file
from geomosaic.control.table import comment_crs
from geomosaic.errors import GeomosaicError, InputError
from geomosaic.geo.crs import geographic, has_heights, horizontal, parse_map
from geomosaic.geo.transform import Transform
from geomosaic.geo.units import metres_per_unit
from geomosaic.georeferencing.live_control import LiveControl, Subscene, live_control, next_control
from geomosaic.georeferencing.run import georeference
from geomosaic.inputs.build import build_block
from geomosaic.inputs.declarations import Block
from geomosaic.inputs.frames import positions_crs
from geomosaic.jobs.manifest import Layout
from geomosaic.options.control import MODELS
from geomosaic.orientation.single.next_point import ground_of
from geomosaic.raster.info import inspect
from geomosaic.sensor.plugin import SensorModel
from geomosaic.sensor.registry import capabilities, plane_sensor
from geomosaic.studio.history import text_of
from geomosaic.studio.workspace import Workspace
from geomosaic.surface.model import Surface
from geomosaic.types import BoolArray, FloatArray

# Points of the table that the order of candidates lists, and cells of the image.
LISTED = 12
# Decimals of image and ground coordinates that are written.
_PIXEL, _GROUND, _DEGREE = 3, 3, 9


@dataclass(frozen=True, eq=False)
class Station:
    """Image whose control is measured, with what its project says of it.

    Attributes
    ----------
    path : Path
    size : tuple of int
        Width and height, pixels.
    table : Path
        Its control points.
    crs : CRS or None
        CRS of the table as declared; None where a comment in it names one, or nothing does.
    model : str or SensorModel
        Plane transformation by name, or the model that the image comes with.
    surface : Surface or None
    """

    path: Path
    size: tuple[int, int]
    table: Path
    crs: CRS | None
    model: str | SensorModel
    surface: Surface | None


class ControlDesk:
    """Control of the images of a workspace.

    Parameters
    ----------
    workspace : Workspace
    """

    def __init__(self, workspace: Workspace) -> None:
        self._workspace = workspace
        self._lock = threading.Lock()
        self._stations: dict[tuple[Any, ...], Station] = {}
        # Parameters of the last solution by image, from which the next one starts.
        self._last: dict[Path, FloatArray] = {}

    def state(
        self, layer: str, model: str | None = None, area: Sequence[float] | None = None, other: str | None = None
    ) -> dict[str, Any]:
        """Points of an image, their solution and what is wrong with them.

        Parameters
        ----------
        layer : str
            Image by its id.
        model : str, optional
            Plane transformation in place of the project's.
        area : sequence of float, optional
            Left, top, right and bottom of the part of the image that the fit uses, pixels.
        other : str, optional
            Georeferenced layer by its id, on whose map the points are told too.

        Returns
        -------
        dict
        """
        started = time.perf_counter()
        station, rows, live = self._live(layer, model, area)
        facts = _live_facts(station, rows, live)
        if other:
            on_map, measured = _on_map(live, self._map(other)[0])
            for point, place, there in zip(facts["points"], on_map.tolist(), measured.tolist(), strict=True):
                point |= {"on_map": place, "measured_on_map": there}
        return {
            **facts,
            "history": self._workspace.history.titles,
            "milliseconds": 1e3 * (time.perf_counter() - started),
        }

    def advice(self, layer: str, model: str | None = None, area: Sequence[float] | None = None) -> dict[str, Any]:
        """Expected accuracy over the image, now and with one more point at each place, and the order of points.

        Parameters
        ----------
        layer, model, area
            As for `state`.
        """
        station, rows, live = self._live(layer, model, area)
        names, candidates = self._candidates(station, rows, live)
        found = next_control(live, station.size, station.model, station.surface, candidates, count=LISTED)
        nominal = live.solution is None and isinstance(station.model, str)
        places = found.grid.colrow.reshape(-1, 2)
        if candidates is not None and live.model is not None:
            places = live.model.ground_to_image(candidates)
        order = [
            {"col": places[index, 0], "row": places[index, 1], "rms": rms, "id": names[index] if names else None}
            for index, rms in zip(found.order.chosen.tolist(), found.predicted[1:].tolist(), strict=True)
        ]
        return {
            "unit": "px" if nominal else "m",
            "rms": found.rms,
            "sigma": found.sigma.tolist(),
            "rms_with": found.rms_with.tolist(),
            "order": order,
            "size": list(station.size),
        }

    def expected(self, layer: str, other: str, places: Mapping[str, float], model: str | None = None) -> dict[str, Any]:
        """Place of a layer's point in the image, or of an image's point on the layer, as the solution puts it.

        Parameters
        ----------
        layer : str
            Image by its id.
        other : str
            Georeferenced layer by its id.
        places : mapping
            `col` and `row` of the image, or `map_col` and `map_row` of the layer.
        model : str, optional

        Returns
        -------
        dict
            `col` and `row` of the other side; None where nothing predicts it.
        """
        station, _, live = self._live(layer, model, None)
        if live.model is None:
            return {"col": None, "row": None, "reason": live.reason}
        crs, affine = self._map(other)
        if "map_col" in places:
            xy = np.array([affine @ [places["map_col"], places["map_row"], 1.0]])
            found = live.model.ground_to_image(_ground(xy, crs, live.model.crs, station.surface))[0]
        else:
            xyz = ground_of(live.model, np.array([[places["col"], places["row"]]]), station.surface)
            xy = _to_map(xyz, live.model.crs, crs)[0]
            found = np.linalg.solve(affine[:, :2], xy - affine[:, 2])
        return {"col": found[0], "row": found[1], "reason": ""}

    def add(self, layer: str, values: Mapping[str, Any]) -> str:
        """Add a point to the image's table.

        Parameters
        ----------
        layer : str
        values : mapping
            `col` and `row` of the image; `x` and `y` (and `z`), or `layer`, `map_col` and `map_row`; `id` and `role`
            optionally.

        Returns
        -------
        str
            Its name.
        """
        station = self._station(layer)
        with self._workspace.history.lock:
            text = text_of(station.table)
            table = ControlText.of(text)
            taken = {row.values.get("id", "") for row in table.rows}
            own = {row.values.get("id", "") for row in _rows_of(table, station)}
            name = str(values.get("id") or "").strip() or _free_name(taken)
            if table.qgis:
                name = str(len(table.rows))
            if name in own:
                raise InputError(f"point '{name}' is measured in {station.path.name} already", hint="give another name")
            fields = {"id": name, "image": station.path.name, **self._fields(station, table, values)}
            if missing := {"x", "y", "col", "row"} - fields.keys():
                raise InputError(f"the point has no {', '.join(sorted(missing))}", hint="give both of its places")
            if text is None and station.crs is not None:
                table = replace(table, lines=(f"#CRS: {_code(station.crs)}", *table.lines), header=table.header + 1)
            self._save(f"point {name} measured in {station.path.name}", station, text, table.with_row(None, fields))
        return name

    def change(self, layer: str, name: str, values: Mapping[str, Any]) -> None:
        """Change a point of the image's table.

        Parameters
        ----------
        layer, name : str
        values : mapping
            Any of those of `add`, and `enabled`.
        """
        station = self._station(layer)
        with self._workspace.history.lock:
            text = text_of(station.table)
            table = ControlText.of(text)
            row = _row_of(table, station, name)
            fields = self._fields(station, table, values)
            if not fields:
                raise InputError("nothing is to be changed", hint="give col, row, x, y, role or enabled")
            self._save(_title(name, fields), station, text, table.with_row(row.line, fields))

    def remove(self, layer: str, name: str) -> None:
        """Take a point out of the image's table.

        Parameters
        ----------
        layer, name : str
        """
        station = self._station(layer)
        with self._workspace.history.lock:
            text = text_of(station.table)
            table = ControlText.of(text)
            row = _row_of(table, station, name)
            self._save(f"point {name} taken out of {station.path.name}", station, text, table.without_row(row.line))

    def measure(self, layer: str, values: Mapping[str, Any], model: str | None = None) -> dict[str, Any]:
        """Sub-pixel place near one that was pointed at: centre of a mark, or match of the reference.

        Parameters
        ----------
        layer : str
        values : mapping
            `way`: 'mark' with `col`, `row` and `half`; or 'match' with `layer`, `map_col` and `map_row`.
        model : str, optional

        Returns
        -------
        dict
            `col`, `row`, `sigma` and `correlation`.

        Raises
        ------
        InputError
            Nothing was found.
        """
        station, _, live = self._live(layer, model, None)
        if values.get("way") == "mark":
            return _mark(station, _number(values, "col"), _number(values, "row"), int(values.get("half", 12)))
        if values.get("way") != "match":
            raise InputError(f"no way of measuring is called '{values.get('way')}'", hint="'mark' or 'match'")
        if live.model is None:
            raise InputError("no model says where the reference lies in the image", hint="place three points by hand")
        other = self._workspace.raster(str(values.get("layer")))
        if other is None:
            raise InputError("there is no such layer", hint="choose a reference")
        at = _number(values, "map_col"), _number(values, "map_row")
        return _match(station, live.model, other, at)

    def georeference(self, layer: str, model: str | None = None) -> dict[str, Any]:
        """Write the image placed on the map by its points, as `georeference` does.

        Parameters
        ----------
        layer : str
        model : str, optional
        """
        station = self._station(layer)
        if not isinstance(station.model, str):
            raise InputError("the image has a sensor model: its ortho is a step of the project", hint="run the project")
        project = self._workspace.project()
        if project is None:
            raise InputError("the project file has errors", hint="mend them first")
        control = _points(station, ControlText.of(text_of(station.table)))
        if control is None:
            raise InputError("no point is measured yet", hint="measure some")
        output = Layout(project).orthos[project.images.index(station.path)]
        output.parent.mkdir(parents=True, exist_ok=True)
        made = georeference(station.path, output, control, model=model or station.model, overwrite=True)
        fit = made.solution.fit
        return {"file": output.name, "rms": fit.rms_total, "model": made.solution.model, "points": len(fit.ids)}

    def _live(
        self, layer: str, model: str | None, area: Sequence[float] | None
    ) -> tuple[Station, tuple[TableRow, ...], LiveControl]:
        station = self._station(layer, model)
        with self._workspace.history.lock:
            table = ControlText.of(text_of(station.table))
            control = _points(station, table)
        part = None if area is None else Subscene(*area)
        live = live_control(control, station.size, station.model, part, self._last.get(station.path))
        if live.solution is not None and not isinstance(station.model, str):
            self._last[station.path] = live.solution.fit.model.parameters.values
        return station, _rows_of(table, station), live

    def _station(self, layer: str, model: str | None = None) -> Station:
        if model is not None and model not in MODELS:
            raise InputError(f"there is no model '{model}'", hint=f"choose one of {', '.join(MODELS)}")
        project = self._workspace.project()
        path = self._workspace.raster(layer)
        part = None if project is None else next((one for one in project.blocks if path in one.images), None)
        if path is None or part is None:
            raise InputError("there is no such image in the project", hint="load the page again")
        if not isinstance(part.control, Path):
            raise InputError(
                "the project names no table of control points",
                where="[control] file",
                hint="add file = 'gcps.csv' under [control]; the table is made with the first point",
            )
        key = (path, *(_stamp(file) for file in (self._workspace.path, *part.tables) if file != part.control))
        with self._lock:
            if key not in self._stations:
                self._stations = {other: one for other, one in self._stations.items() if other[0] != path}
                self._stations[key] = _station(path, part, part.control)
            station = self._stations[key]
        return station if model is None or not isinstance(station.model, str) else replace(station, model=model)

    def _candidates(
        self, station: Station, rows: Sequence[TableRow], live: LiveControl
    ) -> tuple[list[str], FloatArray | None]:
        """Names and ground points (N, 3) of the table that are measured in other images only; None without any."""
        model = live.model
        if model is None or live.solution is None:
            return [], None
        measured = {row.values.get("id") for row in rows}
        others: dict[str, list[float]] = {}
        for row in ControlText.of(text_of(station.table)).rows:
            name = row.values.get("id", "")
            try:
                xyz = [float(row.values.get(axis) or "nan") for axis in ("x", "y", "z")]
            except ValueError:
                continue
            if name and name not in measured:
                others[name] = xyz
        if not others or station.crs is None:
            return [], None
        places = np.array(list(others.values()))
        flat = not has_heights(model.crs)
        moved = Transform(station.crs, model.crs)(places[:, :2] if flat else places)
        ground = np.zeros((len(moved), 3))
        ground[:, : moved.shape[1]] = moved
        seen = _inside(model.ground_to_image(ground), station.size)
        if not seen.any():
            return [], None
        return [name for name, there in zip(others, seen, strict=True) if there], ground[seen]

    def _fields(self, station: Station, table: ControlText, values: Mapping[str, Any]) -> dict[str, str]:
        """Fields of a row from what the page sends."""
        fields = {name: f"{_number(values, name):.{_PIXEL}f}" for name in ("col", "row") if name in values}
        if "map_col" in values:
            crs, affine = self._map(str(values.get("layer")))
            xy = np.array([affine @ [_number(values, "map_col"), _number(values, "map_row"), 1.0]])
            own = _table_crs(station, table)
            if own is None:
                raise InputError(
                    "nothing says which CRS the table is in",
                    where=station.table.name,
                    hint="declare `crs` in the project",
                )
            place = _ground(xy, crs, own, station.surface)[0]
            digits = _DEGREE if own.is_geographic else _GROUND
            fields |= {"x": f"{place[0]:.{digits}f}", "y": f"{place[1]:.{digits}f}"}
            if has_heights(own):
                fields["z"] = f"{place[2]:.{_GROUND}f}"
        for name in ("x", "y", "z"):
            if values.get(name) is not None:
                fields[name] = f"{_number(values, name):.12g}"
        if "role" in values:
            fields["role"] = str(values["role"])
            if fields["role"] not in ("control", "check"):
                raise InputError(f"a point cannot have the role '{fields['role']}'", hint="control or check")
        if "enabled" in values:
            fields["enabled"] = "1" if values["enabled"] else "0"
        return fields

    def _map(self, layer: str) -> tuple[CRS, FloatArray]:
        """Map CRS and pixel → map matrix (2, 3) of a layer."""
        path = self._workspace.raster(layer)
        if path is None:
            raise InputError("there is no such layer", hint="choose one of the list")
        info = inspect(path)
        if info.crs is None or info.transform is None:
            raise InputError(f"{path.name} is not georeferenced", hint="choose an ortho, a mosaic or a map")
        return horizontal(info.crs), np.array(list(info.transform)[:6]).reshape(2, 3)

    def _save(self, title: str, station: Station, before: str | None, table: ControlText) -> None:
        self._workspace.history.save(title, {station.table: before}, {station.table: table.text})


def _station(path: Path, part: Block, table: Path) -> Station:
    """Image with its model before any of its points is used."""
    info = inspect(path)
    declared = None if part.crs is None else positions_crs(part.crs, part.heights)
    if capabilities(part.sensor).planar:
        kind = str(part.options.get("kind", "affine"))
        order = int(part.options.get("order", 1))
        name = f"poly{order}" if kind == "polynomial" else kind
        flat = None if part.crs is None else parse_map(part.crs, "`crs`")
        return Station(path, info.size, table, flat, name, None)
    alone = replace(part, images=(path,), control=None)
    try:
        block = build_block(alone)
    except GeomosaicError:
        # A sensor that its control alone places.
        block = build_block(replace(alone, control=table))
    return Station(path, info.size, table, block.crs or declared, block.scenes[0].model, block.surface)


def _stamp(path: Path) -> tuple[str, int, int]:
    try:
        found = path.stat()
    except OSError:
        return str(path), 0, 0
    return str(path), found.st_mtime_ns, found.st_size


def _rows_of(table: ControlText, station: Station) -> tuple[TableRow, ...]:
    """Rows of the table that are measured in an image."""
    if table.qgis or "image" not in table.columns:
        return table.rows
    own = {station.path.name.casefold(), station.path.stem.casefold()}
    return tuple(row for row in table.rows if Path(row.values.get("image", "")).name.casefold() in own)


def _row_of(table: ControlText, station: Station, name: str) -> TableRow:
    found = next((row for row in _rows_of(table, station) if row.values.get("id") == name), None)
    if found is None:
        raise InputError(
            f"there is no point '{name}' in {station.path.name}", hint="another program may have taken it out"
        )
    return found


def _points(station: Station, table: ControlText) -> ControlPoints | None:
    """Control points of the image, read as the command line reads them; None where there are none."""
    if not _rows_of(table, station):
        return None
    image = None if table.qgis or "image" not in table.columns else station.path.name
    crs = None if comment_crs(table.origins(str(station.table))) else station.crs
    found = read_control_file(station.table, image=image, crs=crs, size=station.size).control
    if station.crs is not None and not isinstance(station.model, str) and found.ground.shape[1] == 3:
        found = replace(found, crs=station.crs)
    return found


def _table_crs(station: Station, table: ControlText) -> CRS | None:
    named = comment_crs(table.origins(str(station.table)))
    return station.crs if named is None or not isinstance(station.model, str) else parse_map(named, station.table.name)


def _ground(xy: FloatArray, crs: CRS, target: CRS, surface: Surface | None) -> FloatArray:
    """Ground points (N, 3) in a CRS under map places (N, 2), with heights of the surface where the CRS has any."""
    found = np.zeros((len(xy), 3))
    if not has_heights(target):
        found[:, :2] = Transform(crs, horizontal(target))(xy)
        return found
    if surface is None:
        raise InputError("the ground has no heights here", hint="give the project a DEM or a height")
    found[:, :2] = Transform(crs, horizontal(surface.crs))(xy)
    found[:, 2] = surface.height(found[:, :2])
    return Transform(surface.crs, target)(found)


def _to_map(xyz: FloatArray, source: CRS, crs: CRS) -> FloatArray:
    """Map places (N, 2) of ground points (N, 2) or (N, 3)."""
    if source.is_geocentric:
        level = geographic(source)
        xyz, source = Transform(source, level)(xyz), level
    return Transform(horizontal(source), crs)(xyz[:, :2])


def _on_map(live: LiveControl, crs: CRS) -> tuple[FloatArray, FloatArray]:
    """Map places (N, 2) of the control points, and of where they were measured in the image, by the residuals."""
    control = live.control
    places = _to_map(control.ground, control.crs, crs)
    if live.solution is None:
        return places, np.full(places.shape, np.nan)
    steps = live.solution.map_residuals
    if not control.crs.is_geocentric:
        return places, _to_map(control.xy + steps, horizontal(control.crs), crs)
    # Metres east and north; what the map's own scale and convergence do to them is not seen.
    return places, places + steps / metres_per_unit(crs, places)


def _inside(colrow: FloatArray, size: tuple[int, int]) -> BoolArray:
    return np.asarray(((colrow >= 0.0) & (colrow <= size)).all(axis=1))


def _free_name(taken: set[str]) -> str:
    number = 1
    while str(number) in taken:
        number += 1
    return str(number)


def _title(name: str, fields: Mapping[str, str]) -> str:
    if "enabled" in fields:
        return f"point {name} switched {'on' if fields['enabled'] == '1' else 'off'}"
    return f"point {name} made a {fields['role']} point" if "role" in fields else f"point {name} moved"


def _code(crs: CRS) -> str:
    found = horizontal(crs).to_epsg()
    return f"EPSG:{found}" if found else horizontal(crs).to_wkt()


def _number(values: Mapping[str, Any], name: str) -> float:
    value = values.get(name)
    if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
        raise InputError(f"'{name}' is no number", hint="give pixels, or units of the map")
    return float(value)


def _mark(station: Station, col: float, row: float, half: int) -> dict[str, Any]:
    from geomosaic.geo.grid import Window
    from geomosaic.matching.marks import measure_mark
    from geomosaic.raster.source import Source

    half = min(max(half, 5), 64)
    border = 3 * half
    left, top = int(col) - border, int(row) - border
    window = Window(left, top, 2 * border + 1, 2 * border + 1).intersection(Window(0, 0, *station.size))
    if window.empty:
        raise InputError("the place lies outside the image", hint="point at a mark")
    source = Source(str(station.path))
    try:
        grey = np.asarray(source.read(window)[0], dtype=np.float64).mean(axis=2)
    finally:
        source.close()
    found = measure_mark(grey, (col - window.col, row - window.row), half)
    if not found.found:
        raise InputError(
            "nothing symmetric is there: no dot, cross, ring or square", hint="point nearer to it, or place it by hand"
        )
    return {
        "col": window.col + found.col, "row": window.row + found.row,
        "sigma": found.sigma, "correlation": found.correlation,
    }  # fmt: skip


def _match(station: Station, model: SensorModel, other: Path, at: tuple[float, float]) -> dict[str, Any]:
    from geomosaic.reference_matching.drawing import Drawer, georeferenced
    from geomosaic.reference_matching.match import Reference, match_place

    scene, grid = georeferenced(other, "the reference")
    x, y = grid.xy(np.array([at]))[0].tolist()
    image = OrientedImage(station.path.stem, str(station.path), plane_sensor(), model)
    with (
        (opened := Reference.open(scene, grid)).drawer,
        Drawer.open(image, station.surface, grid.crs) as drawer,
    ):
        found = match_place(drawer, opened, (x, y))
    if found is None:
        raise InputError(
            "the image does not show there what the reference shows", hint="place it by hand, or choose another place"
        )
    sigma = float(np.sqrt(np.trace(found.covariance) / 2.0))
    return {"col": found.colrow[0], "row": found.colrow[1], "sigma": sigma, "correlation": found.correlation}


def _live_facts(station: Station, rows: Sequence[TableRow], live: LiveControl) -> dict[str, Any]:
    """JSON values of the points and their solution."""
    solution, planar = live.solution, isinstance(station.model, str)
    blamed = {name for one in live.diagnostics for name in one.points if one.severity == "error"}
    metres = np.ones((len(live.control), 2))
    if solution is not None and live.model is not None and not live.model.crs.is_geocentric:
        metres = metres_per_unit(live.model.crs, live.control.ground)[:, :2]
    texts = {row.values.get("id", ""): row.values for row in rows}
    points = []
    for index, name in enumerate(live.control.names):
        point: dict[str, Any] = {
            "id": name,
            "state": live.states[index],
            "role": live.control.roles[index],
            "enabled": bool(live.control.enabled[index]),
            "col": live.control.colrow[index, 0],
            "row": live.control.colrow[index, 1],
            "ground": [texts.get(name, {}).get(axis, "") for axis in ("x", "y", "z")],
            "blamed": name in blamed,
        }
        if solution is not None:
            point |= {
                "residual": solution.residuals[index].tolist(),
                "residual_m": (solution.map_residuals[index] * metres[index]).tolist(),
                "left_out": solution.leave_one_out[index].tolist(),
                "redundancy": solution.redundancy_numbers[index].tolist(),
                "toggled": {"sigma0": solution.toggled_sigma0[index], "rms": solution.toggled_rms[index]},
            }
        points.append(point)
    return {
        "image": station.path.name,
        "size": list(station.size),
        "table": station.table.name,
        "model": station.model if planar else "sensor",
        "models": [name for name in MODELS if name != "auto"] if planar else [],
        "points": points,
        "solution": None if solution is None else _solution_facts(live),
        "predicts": live.model is not None,
        "reason": live.reason,
        "messages": [
            {"code": one.code, "severity": one.severity, "what": one.what, "points": list(one.points), "hint": one.hint}
            for one in live.diagnostics
        ],
    }


def _solution_facts(live: LiveControl) -> dict[str, Any]:
    assert live.solution is not None
    solution, fit = live.solution, live.solution.fit
    lengths = np.hypot(*solution.leave_one_out[solution.used].T)
    known = lengths[np.isfinite(lengths)]
    residuals = fit.residuals
    return {
        "points": len(fit.ids),
        "rms": fit.rms_total,
        "rms_axes": np.sqrt((residuals**2).mean(axis=0)).tolist(),
        "sigma0": fit.sigma0,
        "redundancy": fit.redundancy,
        "leave_one_out": float(np.sqrt((known**2).mean())) if len(known) else None,
        "check_rms": live.check_rms,
        "clean_rms": solution.clean_rms,
    }
