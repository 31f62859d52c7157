"""Georeferencing by control points, and the fiducial marks of scanned films."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pyproj import CRS

from geomosaic.api.orthos import render_options
from geomosaic.control import read
from geomosaic.control.points import ControlPoints
from geomosaic.fiducials import Search, find_marks, write_marks
from geomosaic.geo.grid import Bounds
from geomosaic.georeferencing.request import ControlInput, FitRequest
from geomosaic.georeferencing.run import Georeferenced
from geomosaic.georeferencing.run import georeference as georeference_image
from geomosaic.match import Mark
from geomosaic.options.inputs import Area
from geomosaic.products import refuse_existing
from geomosaic.types import PathLike
from geomosaic.whole_files import path_of


def read_control(
    path: PathLike,
    *,
    image: str | None = None,
    crs: CRS | str | None = None,
    size: tuple[int, int] | None = None,
) -> ControlPoints:
    """Control points of one image from a file: a table, QGIS .points, gcp_list.txt, tags of a raster, a world file.

    Parameters
    ----------
    path : path
    image : str, optional
        Name of the image, where the file has points of several.
    crs : CRS or str, optional
        Of the ground, where the file names none.
    size : tuple of int, optional
        Width and height of the image in pixels; needed for a world file.

    Returns
    -------
    ControlPoints

    Raises
    ------
    InputError
        Names file, line, point and column.
    """
    return read.read_control(path, image=image, crs=crs, size=size).control


def georeference(
    image: PathLike,
    output: PathLike,
    gcps: PathLike | ControlPoints | None = None,
    *,
    model: str = "auto",
    crs: str | None = None,
    dst_crs: str | None = None,
    resolution: float | None = None,
    bounds: Bounds | None = None,
    fit_crs: str | None = None,
    without: Sequence[str] = (),
    threshold: float | None = None,
    robust: bool = False,
    insist: bool = False,
    rows: str | None = None,
    pixels: str | None = None,
    near: tuple[float, float] | None = None,
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
    gcps : path or ControlPoints, optional
        Control points: a table, QGIS .points, gcp_list.txt, a raster or a world file; those in the image, or a world
        file beside it, unless given.
    model : str
        'conformal', 'affine', 'projective', 'poly1' to 'poly5', 'tps'; 'auto' takes the one of the smallest errors at
        points left out.
    crs : str, optional
        Of the control points, where the file does not name it.
    dst_crs : str, optional
        Of the output; that of the points where it is projected, else the UTM zone, unless given.
    resolution, bounds
        See `ortho`.
    fit_crs : str, optional
        CRS in which the fit is made.
    without : sequence of str
        Names of points that are left out.
    threshold : float, optional
        Total RMS in pixels down to which the worst points are deleted.
    robust : bool
        Leave out the points that data snooping and M-estimator reject.
    insist : bool
        Go on where the control looks wrong.
    rows, pixels : str, optional
        How the file counts rows ('up', 'down') and pixels ('corner', 'centre').
    near : tuple of float, optional
        Longitude and latitude near the image, degrees.
    bands : tuple of int, optional
        Counted from 1.
    report : bool
        Write the control report.
    **options
        Of `RenderOptions`.

    Returns
    -------
    Georeferenced
        The product, and the solution with residuals, leave-one-out errors and findings.

    Raises
    ------
    BadControlError
        The control would draw a wrong picture; lists the findings.
    SolveError
        The control does not determine the fit.
    InputError, OutputError
    """
    own = gcps if isinstance(gcps, ControlPoints) or gcps is None else path_of(gcps, "gcps")
    given = ControlInput(own, crs, rows, pixels, tuple(without), near)
    fit = FitRequest(model, fit_crs, threshold, robust, insist)
    place = Area(dst_crs, resolution, bounds)
    return georeference_image(
        path_of(image, "image"),
        path_of(output, "output"),
        given,
        fit,
        place,
        render_options(options),
        bands=bands,
        report=report,
    )


def find_fiducials(
    scans: Sequence[PathLike],
    camera: PathLike,
    template: PathLike,
    pixel_size: float,
    *,
    at: tuple[float, float] | None = None,
    side: float = 2.0,
    reach: float = 5.0,
    turned: float = 0.0,
    mirrored: bool = False,
    least: float = 0.6,
    output: PathLike | None = None,
    overwrite: bool = False,
) -> Mapping[str, Mapping[str, Mark]]:
    """Fiducial marks of scanned films, found by a picture of one of them.

    Parameters
    ----------
    scans : sequence of path
    camera : path
        Calibration certificate (TOML) with the marks in mm.
    template : path
        Picture of one mark; or a scan that shows one `at` a place.
    pixel_size : float
        Of the scans, µm.
    at : tuple of float, optional
        Column and row of a mark in `template`, pixels.
    side : float
        Side of the square that is cut out there, mm.
    reach : float
        How far marks may be off, mm.
    turned : float
        Turn of the film in the scan, degrees counter-clockwise.
    mirrored : bool
        The scan shows the film from its back.
    least : float
        Least correlation of a mark, 0 to 1.
    output : path, optional
        Table to write: image, id, col, row, sigma, correlation.
    overwrite : bool
        Replace an existing table.

    Returns
    -------
    mapping of str to mapping of str to Mark
        By scan and name of the mark; col and row in pixels.

    Raises
    ------
    InputError, OutputExistsError
    """
    if output is not None:
        refuse_existing(path_of(output, "output"), overwrite)
    search = Search(pixel_size, reach, turned, mirrored, least)
    found = find_marks(
        tuple(map(Path, scans)), path_of(camera, "camera"), path_of(template, "template"), search, at, side
    )
    if output is not None:
        write_marks(path_of(output, "output"), found)
    return found
