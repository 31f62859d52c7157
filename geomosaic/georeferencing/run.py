"""Georeferencing of an image by control points: fit, ortho and control report."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pyproj import CRS

from geomosaic.block import Footprint, OrientedImage, footprint
from geomosaic.control.coordinate_diagnostics import SEVERITIES, Diagnostic
from geomosaic.control.parsing import Reading
from geomosaic.control.points import ControlPoints, Origin
from geomosaic.control.read import read_control_file
from geomosaic.errors import InputError
from geomosaic.geo.crs import horizontal, parse_map
from geomosaic.geo.grid import Grid, Window
from geomosaic.geo.units import short_unit
from geomosaic.georeferencing.fit_diagnostics import BadControlError, fold_diagnostics, stop_on_errors
from geomosaic.georeferencing.solution import Solution, check_control, solve
from geomosaic.options.control import ControlOptions, GeoreferenceOptions
from geomosaic.options.declaration import compose
from geomosaic.raster.files import check_output, check_output_size
from geomosaic.raster.info import SourceInfo, control_point_count, inspect
from geomosaic.render.extent import grid_of, note_far_crs, output_grid, utm_zone
from geomosaic.render.ortho import OrthoResult, ortho
from geomosaic.sensor.registry import plane_sensor
from geomosaic.stores.path import to_path
from geomosaic.types import PathLike
from geomosaic.whole_files import path_of

if TYPE_CHECKING:
    from geomosaic.georeferencing.vectors import CarriedVectors

# Cells along the longer side of an image from which points found in a reference are taken in turn, and their number.
CELLS, MOST_FOUND = 10, 120


@dataclass(frozen=True, eq=False, repr=False)
class Georeferenced:
    """Image placed on the map, with the fit that placed it and its control report.

    Attributes
    ----------
    product : OrthoResult
    solution : Solution
    facts : dict
        Contents of the JSON report.
    report, page, vectors : Path, optional
        JSON, HTML and GeoPackage beside the product; None if not written.
    carried : CarriedVectors, optional
        The vectors that the fit carried to the map, NAME-vectors.gpkg.
    """

    product: OrthoResult
    solution: Solution
    facts: dict[str, Any]
    report: Path | None
    page: Path | None
    vectors: Path | None
    carried: CarriedVectors | None = None

    @property
    def path(self) -> Path:
        """The file of the product."""
        return self.product.path

    @property
    def grid(self) -> Grid:
        """Its CRS, affine transform and shape."""
        return self.product.grid

    def read(self, window: Window | None = None, bands: Sequence[int] | None = None) -> np.ma.MaskedArray[Any, Any]:
        """Pixels (bands, rows, cols) of the product, see `RasterProduct.read`.

        Parameters
        ----------
        window : Window, optional
            Of the product, all of it unless given.
        bands : sequence of int, optional
            Counted from 1, all unless given.
        """
        return self.product.read(window, bands)

    def __repr__(self) -> str:
        fit = self.solution.fit
        return f"Georeferenced({self.product}, {self.solution.model}, RMS {fit.rms_total:.3g} px)"


def georeference(
    image: PathLike,
    output: PathLike,
    control: PathLike | ControlPoints | None = None,
    *,
    bands: tuple[int, ...] | None = None,
    report: bool = True,
    **options: Any,
) -> Georeferenced:
    """Image placed on the map by control points.

    Parameters
    ----------
    image : path
    output : path
        GeoTIFF to write; the control report goes beside it.
    control : path or ControlPoints, optional
        Control points: a table, QGIS .points, gcp_list.txt, a raster or a world file; those in the image, or a world
        file beside it, unless given, or found in a `reference`.
    bands : tuple of int, optional
        Counted from 1.
    report : bool
        Write the control report.
    **options
        Of `ControlOptions` (`crs`, `reference`, `without`, ...), `FitOptions` (`model`, `robust`, ...), vectors drawn
        over the image (`vectors`, `vector_rows`, `line_tolerance`), the extent
        (`dst_crs`, `resolution`, `bounds`, `like`) and `RenderOptions`, flat.

    Returns
    -------
    Georeferenced
        The product, and the solution with residuals, leave-one-out errors and diagnostics.

    Raises
    ------
    BadControlError
        The control would place the image wrongly; lists the diagnostics.
    SolveError
        The control does not determine the fit.
    InputError, OutputError
    """
    own = control if isinstance(control, ControlPoints) or control is None else path_of(control, "control")
    settings = compose(GeoreferenceOptions, options if own is None else {"control": own, **options})
    given, place, render = settings.source, settings.area, settings.render
    image, output = path_of(image, "image"), path_of(output, "output")
    files = {end: output.with_name(f"{output.stem}-control{end}") for end in (".json", ".html", ".gpkg")}
    drawn = output.with_name(f"{output.stem}-vectors.gpkg")
    beside = [*(files.values() if report else ()), *([drawn] if settings.drawn.vectors else [])]
    for file in (output, *beside):
        named = (given.control, given.reference, settings.drawn.vectors)
        read = (image, *(each for each in named if isinstance(each, Path)))
        check_output(file, overwrite=render.overwrite, inputs=read, geotiff=file == output)
    info = inspect(image, bands)
    like = None if place.like is None else grid_of(place.like, framed=True)
    axes = None
    if settings.drawn.vectors is not None:
        from geomosaic.georeferencing.vectors import carry, image_axes

        axes = image_axes(settings.drawn, info.size)
    reading = _control(info, given, bands, like)
    if reading.format == "world" and settings.fit.model == "auto":
        settings = replace(settings, fit=replace(settings.fit, model="affine"))
    target = like.crs if like else None if place.dst_crs is None else parse_map(place.dst_crs, "`dst_crs`")
    solution, out_crs = fit_control(reading, image.name, info.size, settings, target)
    scene = OrientedImage(image.stem, str(image), plane_sensor(), solution.fit.model, bands=bands)
    where = reading.control.origins[0].path
    outline = placed_outline(scene, out_crs, solution.model, where)
    note_far_crs(out_crs, [outline])
    grid = like or output_grid(out_crs, [outline], place.resolution, place.bounds, snap=place.snap)
    check_output_size(output, grid, info.pixel_bytes, render.max_output)
    solution = finish_fit(solution, grid, where, insist=settings.fit.insist)
    product = ortho(scene, None, grid, outline, output, render)
    carried = None
    if axes is not None and settings.drawn.vectors is not None:
        carried = carry(
            settings.drawn.vectors, drawn, axes.colrow, scene, outline, out_crs, settings.drawn.line_tolerance,
            overwrite=render.overwrite,
        )  # fmt: skip
    from geomosaic.georeferencing.report import ortho_facts, report_facts, write_control_report

    made = ortho_facts(product, render.resampling)
    facts = report_facts(image, info.size, reading, settings.fit, solution, made)
    if carried is not None:
        facts["vectors"] = carried.facts
    if report:
        from geomosaic.raster.pictures import preview
        from geomosaic.report.figures import LONGEST

        picture = preview(image, LONGEST)
        write_control_report(facts, picture, solution.crs, out_crs, files, overwrite=render.overwrite)
    page, twin, residuals = (files[end] if report else None for end in (".html", ".json", ".gpkg"))
    return Georeferenced(product, solution, facts, twin, page, residuals, carried)


def fit_control(
    reading: Reading, name: str, size: tuple[int, int], settings: GeoreferenceOptions, target: CRS | None
) -> tuple[Solution, CRS]:
    """Fit of an image, or of a drawing, to its control, and the CRS of the output.

    Parameters
    ----------
    reading : Reading
    name : str
        Of the image.
    size : tuple of int
        Its width and height, pixels.
    settings : GeoreferenceOptions
    target : CRS, optional
        Of the output; that of the fit, or a UTM zone, unless given.

    Raises
    ------
    BadControlError, SolveError, InputError
        See `solution.solve`.
    """
    request, near = settings.fit, settings.source.near
    check_control(reading.control, size, request, near)
    crs = fit_crs(reading.control, request.fit_crs, target)
    solution = solve(reading, name, size, crs, request, near, short_unit(crs), settings.render.spare_memory)
    out_crs = target if target is not None else crs if not crs.is_geographic else _zone_of(reading.control)
    return solution, out_crs


def finish_fit(solution: Solution, grid: Grid, where: str, *, insist: bool) -> Solution:
    """Solution with the findings on folds over the area of the output.

    Parameters
    ----------
    solution : Solution
    grid : Grid
        Of the output.
    where : str
        File of the control, for messages.
    insist : bool
        Go on in spite of errors.

    Raises
    ------
    BadControlError
        The fit folds the image over.
    """
    folds = fold_diagnostics(solution.fit.model, solution.fit.xyz, grid)
    stop_on_errors(folds, where, insist=insist)
    found = sorted((*solution.diagnostics, *folds), key=lambda each: SEVERITIES.index(each.severity))
    return replace(solution, diagnostics=tuple(found))


def _control(info: SourceInfo, given: ControlOptions, bands: tuple[int, ...] | None, like: Grid | None) -> Reading:
    """Control points: those given, found in a reference or in the image itself, or the world file beside it."""
    image = to_path(info.path)
    if isinstance(given.control, ControlPoints):
        return Reading(given.control.without(given.without, "`control`"), "values")
    if given.reference is not None:
        return _found_control(info, given, given.reference, bands)
    path = given.control if given.control is not None else _control_of_image(info)
    reading = read_control_file(
        path, image=image.name, crs=given.crs, size=info.size, sign=given.rows, count=given.pixels, reference=like
    )
    notes = list(reading.notes)
    if given.control is not None and info.transform is not None:
        notes.append("the georeference that the image has already is not used")
    control = reading.control.without(given.without, str(path))
    return replace(reading, control=control, notes=tuple(notes))


def _found_control(info: SourceInfo, given: ControlOptions, reference: Path, bands: tuple[int, ...] | None) -> Reading:
    """Control points found in a reference, evenly spread."""
    from geomosaic.matching.features import spread
    from geomosaic.reference_matching.drawing import georeferenced
    from geomosaic.reference_matching.match import Reference
    from geomosaic.reference_matching.search import SearchedReference, match_anywhere

    scene, grid = georeferenced(reference, "the reference")
    with (opened := Reference.open(scene, grid)).drawer:
        found = match_anywhere(to_path(info.path), bands, SearchedReference(opened))
    sigma = np.sqrt(np.trace(found.covariance, axis1=1, axis2=2) / 2.0)
    # The search for blunders compares every point with all: more than these tell no more of one plane fit.
    kept = np.sort(spread(found.colrow, -sigma, max(info.size) / CELLS, MOST_FOUND))
    control = ControlPoints.from_arrays(
        found.colrow[kept], found.xy[kept], grid.crs, names=[f"ref{number + 1}" for number in range(len(kept))],
        sigma=sigma[kept],
    )  # fmt: skip
    origins = tuple(Origin(str(reference), number + 1, "place") for number in range(len(kept)))
    note = (
        f"found in {reference.name}: {len(found)} places of {found.tried}, of which {len(kept)}, evenly spread, count"
    )
    return Reading(replace(control, origins=origins).without(given.without, "`reference`"), "reference", (note,))


def _control_of_image(info: SourceInfo) -> Path:
    image = to_path(info.path)
    if control_point_count(image):
        return image
    beside = _world_file(image)
    if beside is not None:
        return beside
    if info.transform is not None:
        raise InputError(
            "the image has a georeference already and no control points",
            where=info.path,
            hint="`geomosaic ortho` draws it where it lies; to place it anew, give `control`",
        )
    raise InputError(
        "no control: the image has no control points in it, and there is no world file beside it",
        where=info.path,
        hint="give a table of points with `control`: id,x,y,col,row",
    )


def _world_file(image: Path) -> Path | None:
    """World file of an image: photo.tfw, photo.tifw or photo.wld for photo.tif, in capitals or not."""
    ending = image.suffix[1:].casefold()
    if not ending:
        return None
    names = {f"{image.stem}.{end}".casefold() for end in (ending[0] + ending[-1] + "w", ending + "w", "wld")}
    found = [file for file in sorted(image.absolute().parent.iterdir()) if file.name.casefold() in names]
    return image.with_name(found[0].name) if found else None


def placed_outline(scene: OrientedImage, crs: CRS, model: str, where: str) -> Footprint:
    """Outline of a fitted image on the map.

    Parameters
    ----------
    scene : OrientedImage
    crs : CRS
        Of the output.
    model : str
        Name of the fit, for messages.
    where : str
        File of the control, for messages.

    Raises
    ------
    InputError, BadControlError
        The image has no place in the CRS, or the fit has no ground for its middle.
    """
    try:
        return footprint(scene, None, crs)
    except InputError as error:
        if not crs.equals(scene.model.crs) and placed_outline(scene, scene.model.crs, model, where):
            what = f"the image has no place in '{crs.name}'"
            raise InputError(what, where="`dst_crs`", hint="give a CRS that is made for its area") from error
        what = f"the fit ({model}) has no ground for the middle of the image: its horizon runs through it"
        hint = "look for wrong points, give more of them, or choose a fit of fewer parameters"
        raise BadControlError([Diagnostic("nowhere", "error", what, (), hint)], where, final=True) from error


def fit_crs(control: ControlPoints, given: str | None, target: CRS | None) -> CRS:
    """CRS of the fit.

    Parameters
    ----------
    control : ControlPoints
    given : str or None
    target : CRS or None
    """
    # It is that of the control if projected, since a scanned map is undistorted in its own projection. For control in
    # longitude and latitude it is that of the output if projected, else the UTM zone: in degrees a conformal
    # transformation would not be conformal, and residuals would not be lengths.
    if given is not None:
        return parse_map(given, "`fit_crs`")
    own = horizontal(control.crs)
    if own.is_geocentric:
        raise InputError(
            f"control in '{own.name}' has no x and y of a map",
            where=control.origins[0].path,
            hint="give longitude and latitude, or map coordinates",
        )
    if not own.is_geographic:
        return own
    return target if target is not None and target.is_projected else _zone_of(control)


def _zone_of(control: ControlPoints) -> CRS:
    from geomosaic.geo.projection_domain import longitude_latitude

    degrees = longitude_latitude(control.xy, control.crs)
    good = np.isfinite(degrees).all(axis=1)
    if not good.any():
        raise InputError("the control lies nowhere on the Earth", where=control.origins[0].path, hint="check its CRS")
    longitude, latitude = np.median(degrees[good], axis=0)
    return utm_zone(float(longitude), float(latitude))
