"""Georeferencing of a drawing: vectors in coordinates of their own (CAD, a digitised map) fitted to control points."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from geomosaic.block import OrientedImage
from geomosaic.control.parsing import Reading
from geomosaic.control.points import ControlPoints
from geomosaic.control.read import read_control_file, recognise
from geomosaic.errors import InputError
from geomosaic.geo.crs import parse_map
from geomosaic.geo.grid import Bounds
from geomosaic.georeferencing.run import finish_fit, fit_control, placed_outline
from geomosaic.georeferencing.solution import Solution
from geomosaic.georeferencing.vectors import CarriedVectors, carry, vector_bounds
from geomosaic.options.control import ControlOptions, GeoreferenceOptions
from geomosaic.options.declaration import compose
from geomosaic.raster.files import check_output
from geomosaic.raster.pictures import line_picture
from geomosaic.raster.vector import VectorProduct, layer_names, plain_tables, read_layer
from geomosaic.raster.vector_copy import check_vector_output
from geomosaic.render.extent import output_grid
from geomosaic.report.figures import LONGEST
from geomosaic.sensor.registry import plane_sensor
from geomosaic.types import FloatArray, PathLike
from geomosaic.whole_files import path_of

# Pixels along the longer side of the frame of a drawing, at least; fits and their limits count in pixels.
LEAST_SIDE = 1000.0


@dataclass(frozen=True)
class DrawingFrame:
    """Frame of a drawing as that of an image: columns to the right, rows down from its upper left corner.

    Attributes
    ----------
    left, top : float
        Units of the drawing.
    unit : float
        Units of the drawing that a pixel stands for: a power of ten.
    size : tuple of int
        Width and height, pixels.
    """

    left: float
    top: float
    unit: float
    size: tuple[int, int]

    @classmethod
    def around(cls, bounds: Bounds) -> DrawingFrame:
        """Frame of 1000 to 10,000 pixels around left, bottom, right, top."""
        left, bottom, right, top = bounds
        side = max(right - left, top - bottom)
        unit = 10.0 ** math.floor(math.log10(side / LEAST_SIDE))
        width, height = (max(1, math.ceil(length / unit)) for length in (right - left, top - bottom))
        return cls(float(left), float(top), unit, (width, height))

    def colrow(self, xy: FloatArray) -> FloatArray:
        """Columns and rows (N, 2) of places of the drawing (N, 2)."""
        return np.column_stack([xy[:, 0] - self.left, self.top - xy[:, 1]]) / self.unit


@dataclass(frozen=True, eq=False, repr=False)
class GeoreferencedVectors(VectorProduct):
    """Drawing placed on the map, with the fit that placed it and its control report; `read` gives its layers.

    Attributes
    ----------
    carried : CarriedVectors
    solution : Solution
        Its pixels are those of `frame`.
    frame : DrawingFrame
    facts : dict
        Contents of the JSON report.
    report, page, vectors : Path, optional
        JSON, HTML and GeoPackage beside the product; None if not written.
    """

    path: Path
    carried: CarriedVectors
    solution: Solution
    frame: DrawingFrame
    facts: dict[str, Any]
    report: Path | None
    page: Path | None
    vectors: Path | None

    def __repr__(self) -> str:
        model, rms = self.solution.model, self.solution.fit.rms_total
        return f"GeoreferencedVectors('{self.path}', {self.carried.layers}, {model}, RMS {rms:.3g} px)"


def georeference_vectors(
    drawing: PathLike,
    output: PathLike,
    control: PathLike | ControlPoints | None = None,
    *,
    report: bool = True,
    **options: Any,
) -> GeoreferencedVectors:
    """Drawing placed on the map by control points.

    Parameters
    ----------
    drawing : path
        DXF, GeoPackage, GeoJSON, shapefile ... in any coordinates of its own; a CRS that it names does not count.
    output : path
        GeoPackage, GeoJSON, FlatGeobuf or shapefile; the control report goes beside it.
    control : path or ControlPoints
        A table with x, y and drawing_x, drawing_y, or .points of QGIS; values have x and y of the drawing as col, row.
    report : bool
        Write the control report.
    **options
        Of `ControlOptions`, `FitOptions`, `line_tolerance`, `dst_crs` and `overwrite`, flat.

    Returns
    -------
    GeoreferencedVectors

    Raises
    ------
    BadControlError, SolveError, InputError, OutputError
        See `georeference`.
    """
    own = control if isinstance(control, ControlPoints) or control is None else path_of(control, "control")
    request = compose(GeoreferenceOptions, options if own is None else {"control": own, **options})
    source, file = path_of(drawing, "drawing"), path_of(output, "output")
    _check_options(request, source)
    beside = {end: file.with_name(f"{file.stem}-control{end}") for end in (".json", ".html", ".gpkg")}
    overwrite = request.render.overwrite
    check_vector_output(file, overwrite=overwrite, inputs=(source,))
    for each in beside.values() if report else ():
        check_output(each, overwrite=overwrite, inputs=(source,))
    bounds = vector_bounds(source)
    if not max(bounds[2] - bounds[0], bounds[3] - bounds[1]) > 0.0:
        raise InputError("the drawing is a single place", where=str(source), hint="name another file")
    frame, reading = _control(source, request.source, bounds)
    target = None if request.area.dst_crs is None else parse_map(request.area.dst_crs, "`dst_crs`")
    solution, out_crs = fit_control(reading, source.name, frame.size, request, target)
    scene = OrientedImage(source.stem, str(source), plane_sensor(), solution.fit.model)
    where = reading.control.origins[0].path
    outline = placed_outline(scene, out_crs, solution.model, where)
    solution = finish_fit(solution, output_grid(out_crs, [outline]), where, insist=request.fit.insist)
    carried = carry(
        source, file, frame.colrow, scene, outline, out_crs, request.drawn.line_tolerance, overwrite=overwrite
    )
    from geomosaic.georeferencing.report import report_facts, write_control_report

    facts = report_facts(source, frame.size, reading, request.fit, solution, carried.facts)
    facts["image"]["unit"] = frame.unit
    if report:
        picture = line_picture(_lines(source, frame), frame.size, LONGEST)
        write_control_report(facts, picture, solution.crs, out_crs, beside, overwrite=overwrite)
    paths = [beside[end] if report else None for end in (".json", ".html", ".gpkg")]
    return GeoreferencedVectors(file, carried, solution, frame, facts, *paths)


def _check_options(request: GeoreferenceOptions, drawing: Path) -> None:
    """Check that control is given, and nothing that belongs to an image and its pixels."""
    if request.source.control is None:
        hint = "give a table of points with `control`: id,x,y,drawing_x,drawing_y"
        raise InputError("a drawing has no control points in it", where=str(drawing), hint=hint)
    of_pixels = {
        "like": request.area.like, "resolution": request.area.resolution, "bounds": request.area.bounds,
        "reference": request.source.reference, "vectors": request.drawn.vectors, "pixels": request.source.pixels,
        "rows": request.source.rows,
    }  # fmt: skip
    useless = next((name for name, value in of_pixels.items() if value is not None), None)
    if useless:
        what = f"a drawing has no pixels: `{useless}` would do nothing"
        raise InputError(what, where=str(drawing), hint="leave it out")


def _control(drawing: Path, given: ControlOptions, bounds: Bounds) -> tuple[DrawingFrame, Reading]:
    """Frame around a drawing and its control points, and these with their places in its pixels."""
    notes: tuple[str, ...] = ()
    if isinstance(given.control, ControlPoints):
        control, kind = given.control.without(given.without, "`control`"), "values"
    else:
        path = Path(given.control or "")
        kind = recognise(path)
        if kind not in ("csv", "qgis"):
            raise InputError(
                f"control of a drawing cannot come from this format ({kind})", where=str(path),
                hint="give a table with the columns id, x, y, drawing_x, drawing_y, or .points of QGIS",
            )  # fmt: skip
        reading = read_control_file(path, image=drawing.name, crs=given.crs, sign="up" if kind == "qgis" else None)
        control = reading.control.without(given.without, str(path))
        # QGIS counts upwards what its reader turns to rows.
        notes = tuple(note for note in reading.notes if not note.startswith("rows up"))
        if kind == "qgis":
            control = replace(control, colrow=control.colrow * (1.0, -1.0))
    left, bottom, right, top = bounds
    (west, south), (east, north) = control.colrow.min(axis=0), control.colrow.max(axis=0)
    if west > right or east < left or south > top or north < bottom:
        raise InputError(
            f"the control lies beside the drawing: x from {west:.6g} to {east:.6g}, y from {south:.6g} to {north:.6g}; "
            f"the drawing has {left:.6g} to {right:.6g} and {bottom:.6g} to {top:.6g}",
            where=control.origins[0].path,
            hint="give the coordinates of the drawing itself as drawing_x, drawing_y",
        )
    frame = DrawingFrame.around((min(left, west), min(bottom, south), max(right, east), max(top, north)))
    placed = replace(control, colrow=frame.colrow(control.colrow))
    return frame, Reading(placed, kind, (*notes, f"a pixel stands for {frame.unit:g} of the drawing's units"))


def _lines(path: Path, frame: DrawingFrame) -> list[FloatArray]:
    """Lines and points of a drawing in the pixels of its frame, for its picture."""
    import shapely

    tables = plain_tables(path)
    shapes = [g for name in layer_names(path) if name not in tables for g in read_layer(path, name).geometry.values]
    parts = shapely.get_parts(np.array([g for g in shapes if g is not None], dtype=object))
    parts = shapely.get_parts(parts)
    rings = np.concatenate([parts[shapely.get_dimensions(parts) < 2], shapely.get_rings(parts)])
    return [frame.colrow(shapely.get_coordinates(ring)) for ring in rings if not ring.is_empty]
