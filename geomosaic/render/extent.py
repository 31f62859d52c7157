"""Extent and resolution of the output."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from affine import Affine
from pyproj import CRS

from geomosaic.block import Footprint, OrientedImage, footprint
from geomosaic.errors import InputError, warn
from geomosaic.execution.units import map_units
from geomosaic.geo.crs import crs_name, geographic, horizontal, longitude_latitude_crs
from geomosaic.geo.engineering_crs import image_frame_crs
from geomosaic.geo.grid import Bounds, Grid
from geomosaic.geo.projection_domain import GREAT, area_of_use, beyond, domain, limits, longitude_latitude
from geomosaic.geo.transform import Transform
from geomosaic.options.render import RunningOptions
from geomosaic.raster.info import inspect
from geomosaic.surface.model import Surface

# Times that a metre on the ground may grow in the output, or be longer in one direction than in the other.
TORN = 100.0
# Degrees beyond the area of use of the output CRS, a zone's width, that are told.
FAR = 6.0


def output_crs(scenes: tuple[OrientedImage, ...], surface: Surface | None) -> CRS:
    """Map CRS of the output where none is given: the surface's or model's own, or the UTM zone it lies in.

    Parameters
    ----------
    scenes : tuple of OrientedImage
        The first one decides.
    surface : Surface or None

    Returns
    -------
    CRS
        Horizontal.

    Raises
    ------
    InputError
        The place lies outside all UTM zones.
    """
    model = scenes[0].model
    # A geocentric model has no map of its own.
    own = horizontal(model.crs if surface is None or not model.crs.is_geocentric else surface.crs)
    if own.is_projected or own.is_engineering:  # a map of its own, such as that of an uncontrolled mosaic
        return own
    lon, lat, _ = Transform(model.crs, geographic(model.crs))(np.array([model.seed]))[0]
    return utm_zone(float(lon), float(lat))


def utm_zone(lon: float, lat: float) -> CRS:
    """WGS 84 / UTM zone of a place.

    Parameters
    ----------
    lon, lat : float
        Degrees.

    Returns
    -------
    CRS

    Raises
    ------
    InputError
        The place lies outside all zones, near a pole.
    """
    if not -80.0 <= lat <= 84.0:
        raise InputError(f"no UTM zone at longitude {lon:.3f}, latitude {lat:.3f}", hint="give `dst_crs`")
    zone = int((lon + 180.0) % 360.0 // 6.0) + 1
    return CRS.from_epsg((32600 if lat >= 0.0 else 32700) + zone)


def footprints(
    scenes: tuple[OrientedImage, ...], surface: Surface | None, crs: CRS, running: RunningOptions | None = None
) -> list[Footprint]:
    """Footprints of all images in the output map.

    Parameters
    ----------
    scenes : tuple of OrientedImage
    surface : Surface or None
        None where no model uses heights.
    crs : CRS
        Of the output.
    running : RunningOptions, optional
        Workers, where they are to find them.

    Returns
    -------
    list of Footprint
        In the order of the scenes.

    Raises
    ------
    InputError
        An image sees no ground.
    """
    # One after the other where threads do: each of them would make its own transformations.
    running = RunningOptions(threads=1) if running is None else replace(running, threads=1)
    if running.workers is None:
        return [found for _, found in map_units(partial(_footprint, scenes, surface, crs), range(len(scenes)), running)]
    from geomosaic.render.regions import map_by_regions
    from geomosaic.render.sparse import SparseSequence

    made = map_by_regions(
        lambda near: partial(_footprint, scenes if near is None else SparseSequence(scenes, near), surface, crs),
        range(len(scenes)), lambda number: (number,), len(scenes), running,
    )  # fmt: skip
    return [found for _, found in made]


def _footprint(scenes: Sequence[OrientedImage], surface: Surface | None, crs: CRS, number: int) -> Footprint:
    return footprint(scenes[number], surface, crs)


def nice(resolution: float) -> float:
    """Pixel size rounded to two significant digits, so that it can be read and typed.

    Parameters
    ----------
    resolution : float
        Map units, positive.

    Returns
    -------
    float
    """
    digits = 1 - int(np.floor(np.log10(resolution)))
    return float(round(resolution, digits))


def output_grid(
    crs: CRS,
    outlines: list[Footprint],
    resolution: float | None = None,
    bounds: Bounds | None = None,
    *,
    snap: bool = False,
) -> Grid:
    """Grid of the output over all footprints, snapped to whole pixels.

    Parameters
    ----------
    crs : CRS
        Horizontal CRS of the output; `outlines` are in it.
    outlines : list of Footprint
    resolution : float, optional
        Map units; the median ground sampling distance of the images unless given, rounded to two digits.
    bounds : tuple of float, optional
        Left, bottom, right, top in `crs`, kept as they are given.
    snap : bool
        Widen the bounds to whole pixels.

    Returns
    -------
    Grid

    Raises
    ------
    InputError
        No image reaches the bounds.
    """
    each = np.array([outline.bounds for outline in outlines])
    everything = (each[:, 0].min(), each[:, 1].min(), each[:, 2].max(), each[:, 3].max())
    if resolution is None:
        # The median: a single oblique image, coarse at its centre, does not decide for the block.
        resolution = nice(float(np.median([outline.sampling for outline in outlines])))
    if bounds is None:
        return Grid.from_bounds(crs, _within_the_map(crs, everything, resolution), resolution)
    grid = Grid.from_bounds(crs, bounds, resolution, snap=snap)
    a, b = everything, grid.bounds
    if not (a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]):
        raise InputError(
            f"no image reaches the bounds {bounds}: the images cover {tuple(round(float(v), 2) for v in everything)}",
            hint=f"give `bounds` as left, bottom, right, top in {crs.name}",
        )
    return grid


def _within_the_map(crs: CRS, bounds: Bounds, resolution: float) -> Bounds:
    """Leave out what lies beyond the end of a map, where a pole is infinitely far."""
    if not crs.is_projected or max(bounds[2] - bounds[0], bounds[3] - bounds[1]) < GREAT:
        return bounds
    shown = domain(crs)
    if shown.reach == 180.0 and (shown.south, shown.north) == (-90.0, 90.0):
        return bounds
    most = limits(crs)
    left, bottom, right, top = (*map(max, bounds[:2], most[:2]), *map(min, bounds[2:], most[2:]))
    if left >= right or bottom >= top:
        return bounds
    if max(abs(a - b) for a, b in zip(bounds, (left, bottom, right, top), strict=True)) > resolution:
        reach = f"latitudes {shown.south:g} to {shown.north:g}"
        if shown.reach < 180.0 and shown.centre is not None:
            reach = f"{shown.reach:g} degrees on either side of longitude {shown.centre:g}"
        warn(f"the output ends where {crs.name} has no use ({reach}); `bounds` takes it further")
    return left, bottom, right, top


def note_far_crs(crs: CRS, outlines: list[Footprint]) -> None:
    """Warning where the output CRS is made for another part of the Earth.

    Parameters
    ----------
    crs : CRS
        Of the output.
    outlines : list of Footprint
        In it.
    """
    ring = np.vstack([outline.ring for outline in outlines])
    used = area_of_use(crs)
    if used is not None and (beyond(longitude_latitude(ring, crs), used) > FAR).any():
        west, south, east, north = used
        warn(
            f"the images lie far outside the area that {crs.name} is made for (longitude {west:g} to {east:g}, "
            f"latitude {south:g} to {north:g}): lengths and areas are distorted there"
        )


def refuse_torn_crs(crs: CRS, scenes: tuple[OrientedImage, ...]) -> None:
    """Check that the output CRS has a place for the images and does not tear them apart.

    Parameters
    ----------
    crs : CRS
        Of the output.
    scenes : tuple of OrientedImage
        The first one is looked at.

    Raises
    ------
    InputError
        Says what a metre becomes there, and proposes a CRS.
    """
    from pyproj import Proj
    from pyproj.exceptions import ProjError

    model = scenes[0].model
    if not crs.is_projected or model.crs.is_engineering or horizontal(crs).geodetic_crs is None:
        return
    level = geographic(model.crs) if model.crs.is_geocentric else model.crs
    place = Transform(model.crs, level)(np.array([model.seed])) if model.crs.is_geocentric else np.array([model.seed])
    xy = Transform(horizontal(level), horizontal(crs))(place[:, :2])
    lon, lat = Transform(horizontal(level), longitude_latitude_crs(horizontal(level)))(place[:, :2])[0]
    if not np.isfinite([lon, lat]).all():
        return
    what = "" if np.isfinite(xy).all() else "has no place for it"
    try:
        scales = Proj(crs).get_factors(lon, lat)
        most, least = float(scales.tissot_semimajor), float(scales.tissot_semiminor)
    except ProjError:
        most, least = 1.0, 1.0
    if not what and max(most, most / max(least, 1e-300)) > TORN:
        long = f"{least:.3g} to {most:.3g} m" if np.isfinite([least, most]).all() else "endlessly"
        what = f"draws a metre of the ground {long} long"
    if what:
        raise InputError(
            f"the image lies at longitude {lon:.4f}, latitude {lat:.4f}, and the output CRS, "
            f"{crs_name(crs)}, {what}: it is made for another side of the Earth",
            where=scenes[0].name,
            hint=f"give the `dst_crs` of that place, such as EPSG:{utm_zone(lon, lat).to_epsg()}",
        )


def grid_of(path: Path | Grid, *, framed: bool = False) -> Grid:
    """Grid of a georeferenced raster.

    Parameters
    ----------
    path : Path or Grid
        A grid is returned as it is.
    framed : bool
        Whether a raster without CRS has a frame of its own: that of its geotransform, or of its pixels, x = column and
        y = -row.

    Returns
    -------
    Grid
        With the horizontal part of the raster's CRS.

    Raises
    ------
    InputError
        The raster has no CRS or no geotransform.
    RasterReadError
        The file is missing or no raster.
    """
    if isinstance(path, Grid):
        return path
    info = inspect(path)
    if framed and (info.crs is None or info.transform is None):
        # A geotransform without a CRS is kept; without one rows count downwards from 0, as a GIS shows raw images.
        frame = image_frame_crs("pixel" if info.transform is None else "unit")
        return Grid(frame, info.transform or Affine(1.0, 0.0, 0.0, 0.0, -1.0, 0.0), info.width, info.height)
    if info.crs is None or info.transform is None:
        raise InputError("the raster is not georeferenced", where=str(path), hint="name one that is")
    return Grid(horizontal(info.crs), info.transform, info.width, info.height)
