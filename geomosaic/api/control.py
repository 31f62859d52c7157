"""Georeferencing by control points, and the fiducial marks of scanned films."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from pyproj import CRS

from geomosaic.accuracy.check_points import MapCheck, check_map
from geomosaic.accuracy.product_check import judged
from geomosaic.control import read
from geomosaic.control.points import ControlPoints
from geomosaic.fiducials import find_marks, write_marks
from geomosaic.georeferencing.run import Georeferenced
from geomosaic.georeferencing.run import georeference as georeference_image
from geomosaic.inputs.declarations import image_paths
from geomosaic.match import Mark
from geomosaic.options.control import CheckOptions, GeoreferenceOptions, SearchOptions
from geomosaic.options.declaration import compose
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
    bands : tuple of int, optional
        Counted from 1.
    report : bool
        Write the control report.
    **options
        Of `ControlOptions` (`crs`, `without`, ...), `FitOptions` (`model`, `robust`, ...), the extent (`dst_crs`,
        `resolution`, `bounds`, `like`) and `RenderOptions`, flat.

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
    own = gcps if isinstance(gcps, ControlPoints) or gcps is None else path_of(gcps, "gcps")
    asked = compose(GeoreferenceOptions, options if own is None else {"gcps": own, **options})
    image, output = path_of(image, "image"), path_of(output, "output")
    return georeference_image(
        image, output, asked.control, asked.fit, asked.area, asked.render, bands=bands, report=report
    )


def check(raster: PathLike, points: PathLike, *, insist: bool = False, **options: Any) -> MapCheck:
    """Accuracy of a georeferenced raster at points whose places are known, and whether it keeps the limits given.

    Parameters
    ----------
    raster : path
    points : path
        True x and y, and where the raster has them: col and row, or measured_x and measured_y in its CRS. Any file of
        control will do; where some points have the role 'check', only those count.
    insist : bool
        Go on where coordinates look wrong.
    **options
        Of `CheckOptions`: `crs` of the true places, `pixels`, `rows`, `without`, `raster_crs`, `survey_rms`; the limits
        `max_rms` (pixels), `max_rms_map`, `map_scale` and `target`.

    Returns
    -------
    MapCheck
        `passed` says whether all limits are kept, `verdicts` each of them.

    Raises
    ------
    InputError
        The raster is not georeferenced, a file is wrong, or coordinates do not fit their CRS.
    """
    wanted = compose(CheckOptions, options)
    return judged(check_map(path_of(raster, "raster"), path_of(points, "points"), wanted, insist=insist), wanted)


def find_fiducials(
    scans: Sequence[PathLike],
    camera: PathLike,
    template: PathLike,
    pixel_size: float,
    *,
    at: tuple[float, float] | None = None,
    output: PathLike | None = None,
    overwrite: bool = False,
    **options: Any,
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
    output : path, optional
        Table to write: image, id, col, row, sigma, correlation.
    overwrite : bool
        Replace an existing table.
    **options
        Of `SearchOptions`: `side` of the square cut out there, `reach`, `turned`, `mirrored`, `least`.

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
    search = compose(SearchOptions, {"pixel_size": pixel_size, **options})
    found = find_marks(
        image_paths(scans, "scans"), path_of(camera, "camera"), path_of(template, "template"), search, at
    )
    if output is not None:
        write_marks(path_of(output, "output"), found)
    return found
