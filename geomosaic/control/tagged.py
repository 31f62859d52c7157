"""Control points inside a raster: GeoTIFF tags, VRT and what else GDAL reads them from."""

from __future__ import annotations

from pyproj import CRS

from geomosaic.control.points import Origin
from geomosaic.control.reading import Measured, Reading, control_of, ground_crs
from geomosaic.errors import InputError
from geomosaic.raster.environment import environment
from geomosaic.raster.info import open_raster
from geomosaic.types import PathLike


def read_tagged(path: PathLike, *, crs: str | CRS | None = None) -> Reading:
    """Read the control points of a raster; its col and row are corner-based as ours.

    Parameters
    ----------
    path : path
    crs : str or CRS, optional
        Needed where the raster does not say it.

    Raises
    ------
    RasterReadError
        This is no raster.
    InputError
        It has no control points.
    """
    where = str(path)
    with environment(), open_raster(path) as dataset:
        gcps, stated = dataset.gcps
        wkt = stated.to_wkt() if stated else None
    if not gcps:
        raise InputError(
            "the raster has no control points in it",
            where=where,
            mend="give a table of them; an image that has a georeference already needs none",
        )
    names = [str(gcp.id or "") for gcp in gcps]
    own = len(set(names)) == len(names) and all(names)
    points = [
        Measured(
            names[i] if own else str(i + 1),
            (float(gcp.col), float(gcp.row)),
            (float(gcp.x), float(gcp.y), float("nan") if gcp.z is None else float(gcp.z)),
            Origin(where, i + 1, "GCP"),
        )
        for i, gcp in enumerate(gcps)
    ]
    notes = () if own else ("points called by their number, since their names are missing or doubled",)
    return Reading(control_of(points, ground_crs(wkt, crs, where), where), "raster", notes)
