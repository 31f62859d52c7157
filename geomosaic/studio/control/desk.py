"""Control of a project's images: live solution, next point, expected places and sub-pixel measurement."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from geomosaic.control.edit import ControlText, TableRow
from geomosaic.errors import InputError, OutputError
from geomosaic.georeferencing.live_control import LiveControl, Subscene, live_control
from geomosaic.georeferencing.run import georeference
from geomosaic.jobs.manifest import Layout
from geomosaic.orientation.single.next_point import ground_of
from geomosaic.studio.control.advice import advice_facts
from geomosaic.studio.control.block_prior import block_prior
from geomosaic.studio.control.edits import TableEdits
from geomosaic.studio.control.facts import live_facts
from geomosaic.studio.control.measuring import mark_centre, reference_match
from geomosaic.studio.control.places import ground_under, map_frame, map_places, points_on_map
from geomosaic.studio.control.station import Station, Stations
from geomosaic.studio.control.table import number, points_of, rows_of
from geomosaic.studio.history import text_of
from geomosaic.studio.workspace import Workspace
from geomosaic.types import FloatArray


class ControlDesk:
    """Control of the images of a workspace.

    Attributes
    ----------
    edits : TableEdits
    """

    def __init__(self, workspace: Workspace) -> None:
        self._workspace = workspace
        self._stations = Stations(workspace)
        self.edits = TableEdits(workspace, self._stations)
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
        """
        started = time.perf_counter()
        station, rows, live = self._live(layer, model, area)
        facts = live_facts(station, rows, live)
        if other:
            on_map, measured = points_on_map(live, map_frame(self._workspace.raster(other))[0])
            for point, place, there in zip(facts["points"], on_map.tolist(), measured.tolist(), strict=True):
                point |= {"on_map": place, "measured_on_map": there}
        return {
            **facts,
            "written": self._written(station),
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
        project = self._workspace.project()
        # A part of the image, or a model tried on it, is a question about its own points.
        tried = model is not None and station.model != self._stations.find(layer).model
        prior = None if project is None or area is not None or tried else block_prior(project, station.path)
        return advice_facts(station, rows, live, prior, _subscene(area))

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
        crs, affine = map_frame(self._workspace.raster(other))
        if "map_col" in places:
            xy = np.array([affine @ [places["map_col"], places["map_row"], 1.0]])
            found = live.model.ground_to_image(ground_under(xy, crs, live.model.crs, station.surface))[0]
        else:
            xyz = ground_of(live.model, np.array([[places["col"], places["row"]]]), station.surface)
            xy = map_places(xyz, live.model.crs, crs)[0]
            found = np.linalg.solve(affine[:, :2], xy - affine[:, 2])
        return {"col": found[0], "row": found[1], "reason": ""}

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
            return mark_centre(station, number(values, "col"), number(values, "row"), int(values.get("half", 12)))
        if values.get("way") != "match":
            raise InputError(f"no way of measuring is called '{values.get('way')}'", hint="'mark' or 'match'")
        if live.model is None:
            raise InputError("no model says where the reference lies in the image", hint="place three points by hand")
        other = self._workspace.raster(str(values.get("layer")))
        if other is None:
            raise InputError("there is no such layer", hint="choose a reference")
        at = number(values, "map_col"), number(values, "map_row")
        return reference_match(station, live.model, other, at)

    def georeference(self, layer: str, model: str | None = None, *, overwrite: bool = False) -> dict[str, Any]:
        """Write the image placed on the map by its points, as `georeference` does.

        Parameters
        ----------
        layer : str
        model : str, optional
        overwrite : bool
            Replace what was written before.

        Raises
        ------
        InputError
            The image has a sensor model, or no point.
        OutputError
            It was written before.
        """
        station = self._stations.find(layer)
        if not isinstance(station.model, str):
            raise InputError("the image has a sensor model: its ortho is a step of the project", hint="run the project")
        control = points_of(station, ControlText.of(text_of(station.table)))
        if control is None:
            raise InputError("no point is measured yet", hint="measure some")
        output = self._output(station)
        if output.exists() and not overwrite:
            raise OutputError(
                f"{output.parent.name}/{output.name} is there already",
                hint="'Write the image again' replaces it; or move it elsewhere first",
            )
        output.parent.mkdir(parents=True, exist_ok=True)
        made = georeference(station.path, output, control, model=model or station.model, overwrite=True)
        fit = made.solution.fit
        return {
            "file": f"{output.parent.name}/{output.name}",
            "rms": fit.rms_total,
            "model": made.solution.model,
            "points": len(fit.ids),
        }

    def _output(self, station: Station) -> Path:
        """File of an image placed on the map."""
        project = self._workspace.project()
        if project is None or station.path not in project.images:
            raise InputError("there is no such image in the project", hint="load the page again")
        return Layout(project).georeferenced[project.images.index(station.path)]

    def _written(self, station: Station) -> str | None:
        """File of an image placed on the map, where there is one."""
        if not isinstance(station.model, str):
            return None
        output = self._output(station)
        return f"{output.parent.name}/{output.name}" if output.is_file() else None

    def _live(
        self, layer: str, model: str | None, area: Sequence[float] | None
    ) -> tuple[Station, tuple[TableRow, ...], LiveControl]:
        station = self._stations.find(layer, model)
        with self._workspace.history.lock:
            table = ControlText.of(text_of(station.table))
            control = points_of(station, table)
        live = live_control(control, station.size, station.model, _subscene(area), self._last.get(station.path))
        if live.solution is not None and not isinstance(station.model, str):
            self._last[station.path] = live.solution.fit.model.parameters.values
        return station, rows_of(table, station), live


def _subscene(area: Sequence[float] | None) -> Subscene | None:
    """Part of an image of its left, top, right and bottom."""
    return None if area is None else Subscene(*area)
