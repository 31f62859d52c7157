"""Images of a block: photos with their rows of the orientation table, and georeferenced rasters."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from affine import Affine
from pyproj import CRS

from geomosaic.block import OrientedImage
from geomosaic.errors import InputError, counted, listed, warn
from geomosaic.geo.crs import horizontal, is_local
from geomosaic.geo.grid import Grid
from geomosaic.geo.projection_domain import whole_turn
from geomosaic.image_names import file_of_image, find_by_name
from geomosaic.inputs.declarations import Block
from geomosaic.inputs.exterior_orientation import (
    RECONSTRUCTIONS,
    SELF_PLACED,
    ExteriorRow,
    ExteriorTable,
    check_units,
    read_exterior,
)
from geomosaic.inputs.tables import read_table
from geomosaic.inputs.vertical_datums import positions_crs
from geomosaic.raster.info import SourceInfo, control_point_count, inspect


@dataclass(frozen=True)
class Photo:
    """Image file with what is known of its orientation.

    Attributes
    ----------
    path : Path
    info : SourceInfo
        Size, bands, CRS and geotransform of the file.
    exterior : ExteriorRow or None
        Row of the orientation table.
    """

    path: Path
    info: SourceInfo
    exterior: ExteriorRow | None

    @property
    def name(self) -> str:
        """Name of the scene: the file's name."""
        return self.path.name


def _table(inputs: Block, path: Path | ExteriorTable) -> ExteriorTable:
    if isinstance(path, ExteriorTable):
        return path
    if inputs.angles != "printed":
        return read_exterior(path, inputs.angles, inputs.angle_unit)
    from geomosaic.inputs.orientation_listing import read_listing

    if inputs.printed is None:
        raise InputError(
            "the layout of the printed list is not declared",
            where=str(path),
            hint="declare it in a project, under [exterior.printed]: columns, axes, sequence, lines, skip",
        )
    return read_listing(path, inputs.printed, inputs.angle_unit, inputs.matrix)


def photos_of(inputs: Block) -> tuple[list[Photo], CRS | None]:
    """Images with their rows of the orientation table; no pixel is read.

    Parameters
    ----------
    inputs : Block

    Returns
    -------
    photos : list of Photo
        In the order of the images.
    crs : CRS or None
        3-D CRS of positions and control points, as declared.

    Raises
    ------
    InputError
        No images, positions without a CRS, an image without a row, or angles in an implausible unit.
    """
    if not inputs.images:
        raise InputError("no images are given", hint="name one or more image files")
    infos = [inspect(path, inputs.bands) for path in inputs.images]
    crs = positions_crs(inputs.crs, inputs.heights) if inputs.crs else None
    table = None
    if inputs.exterior is not None and inputs.angles not in RECONSTRUCTIONS:
        table = _table(inputs, inputs.exterior)
    # OpenSfM's reference is on the ellipsoid of WGS 84, by its own definition; files or inputs of the sensor declare
    # geocentric coordinates; all others need a named CRS.
    if inputs.exterior is not None and crs is None and inputs.angles not in SELF_PLACED:
        raise InputError(
            "the positions have no CRS",
            where=str(inputs.exterior),
            hint="name it with `crs`",
        )
    if table is None:
        return [Photo(path, info, None) for path, info in zip(inputs.images, infos, strict=True)], crs
    photos = [Photo(path, info, table.row(path.name)) for path, info in zip(inputs.images, infos, strict=True)]
    # The units are told by the direction of flight, which says nothing of photos taken around an object.
    if crs is None or not is_local(crs):
        check_units(table, inputs.angle_unit, crs)
    return photos, crs


_Ring = tuple[tuple[float, float], ...]
# In place of an image's name: all images that have no polygon of their own.
_EVERY = "*"


def with_declared(inputs: Block, scenes: Sequence[OrientedImage]) -> tuple[OrientedImage, ...]:
    """Images with what their block declares of them: usable areas, cloud masks, day of acquisition, share of cloud.

    Parameters
    ----------
    inputs : Block
    scenes : sequence of OrientedImage

    Raises
    ------
    InputError
        A usable area or a cloud mask does not fit its image.
    """
    if inputs.clouds is not None:
        from geomosaic.raster.cloud_mask import CloudMask

    found = []
    for scene in with_usable(inputs, scenes):
        clouds = None
        if inputs.clouds is not None:
            clouds = CloudMask(str(file_of_image(inputs.clouds, scene.name)), inputs.cloud_values)
            width, height = scene.model.size
            clouds.check((width, height), scene.name)
        found.append(replace(scene, acquired=inputs.acquired, cloud_cover=inputs.cloud_cover, clouds=clouds))
    return tuple(found)


def with_usable(inputs: Block, scenes: Sequence[OrientedImage]) -> tuple[OrientedImage, ...]:
    """Images restricted to their usable areas: an image's own polygon, else one for all images, else the margin.

    Parameters
    ----------
    inputs : Block
    scenes : sequence of OrientedImage

    Raises
    ------
    InputError
        A polygon crosses itself or lies outside its image; a margin leaves nothing.
    """
    rings = _read_usable(inputs.usable) if inputs.usable else {}
    found = []
    for scene in scenes:
        ring = find_by_name({name: ring for name, ring in rings.items() if name != _EVERY}, scene.name)
        ring = ring or rings.get(_EVERY) or _inner(inputs, scene)
        if ring is not None:
            _check(ring, scene, str(inputs.usable) if rings else "margin")
        found.append(replace(scene, usable=ring) if ring is not None else scene)
    bare = [scene.name for scene in found if scene.usable is None]
    if inputs.fiducials is not None and bare:
        warn(
            f"fiducial marks, instruments and borders of the film would appear in the output ({listed(bare, 3)}): "
            "leave them out with `margin` in pixels, or polygons in `usable`"
        )
    return tuple(found)


def _read_usable(path: Path) -> dict[str, _Ring]:
    """Polygons of usable areas by image: a table with the columns image, col, row, one line per corner, in order."""
    table = read_table(path, "table of usable areas", "image,col,row")
    table.require("image", "col", "row", what="usable areas")
    rings: dict[str, list[tuple[float, float]]] = {}
    for row in table:
        rings.setdefault(row.text("image"), []).append((row.number("col"), row.number("row")))
    for name, ring in rings.items():
        if len(ring) < 3:
            what = f"the usable area of '{name}' has {counted(len(ring), 'corner')}"
            raise InputError(what, where=str(path), hint="give three")
    return {name: tuple(ring) for name, ring in rings.items()}


def _inner(inputs: Block, scene: OrientedImage) -> _Ring | None:
    if inputs.margin is None:
        return None
    left, top, right, bottom = inputs.margin
    width, height = scene.model.size
    if left + right >= width or top + bottom >= height:
        raise InputError(
            f"a margin of {left:g}, {top:g}, {right:g}, {bottom:g} pixels leaves nothing of {width} x {height}",
            where=scene.name,
            hint="give pixels of the image: left, top, right, bottom",
        )
    return (left, top), (width - right, top), (width - right, height - bottom), (left, height - bottom)


def _check(ring: _Ring, scene: OrientedImage, where: str) -> None:
    import shapely

    area, image = shapely.Polygon(ring), shapely.box(0, 0, *scene.model.size)
    if not area.is_valid:
        raise InputError(
            f"the usable area of '{scene.name}' crosses itself: {shapely.is_valid_reason(area)}",
            where=where,
            hint="list its corners in their order around it",
        )
    if not area.intersects(image):
        raise InputError(f"the usable area lies outside of '{scene.name}'", where=where, hint="count in image pixels")


def chosen_bands(inputs: Block, path: Path) -> tuple[int, ...] | None:
    """Bands of an image that are used: by number, or by name or wavelength.

    Parameters
    ----------
    inputs : Block
    path : Path
        The image.

    Returns
    -------
    tuple of int or None
        Counted from 1, in the order of the output; None for all but alpha.

    Raises
    ------
    InputError
        The image has no band of a name, or several.
    """
    if inputs.band_names is None:
        return inputs.bands
    from geomosaic.inputs.bands import bands_by_name

    return bands_by_name(inputs, path, inputs.band_names)


# Metres. In a projected CRS, coordinates within ±360 that step by less look like degrees; they are only warned of.
_TINY = 0.01
# Share of a quarter turn: the outer edge of a global grid's pixels may reach beyond the pole.
_HAIR = 0.01
# Sine of the angle between the sides of a pixel: a hundredth of a right angle is no shape that an image has.
_FLAT = 0.01


def _require_shape(transform: Affine, path: str) -> None:
    """Check that the sides of a pixel span an area: rotations of a world file are map units, as its sizes are."""
    a, b, _, d, e, _ = transform[:6]
    sides = math.hypot(a, d), math.hypot(b, e)
    if not abs(a * e - b * d) > _FLAT * sides[0] * sides[1]:
        raise InputError(
            f"a pixel is {sides[0]:.4g} by {sides[1]:.4g} map units, and its sides lie nearly on one line",
            where=path,
            hint="check the world file or the geotransform: its first four lines are x and y per column, then x and y "
            "per row, in map units and not in degrees of rotation",
        )


def check_placed(info: SourceInfo, given: CRS | None = None) -> CRS:
    """CRS of a georeferenced raster, checked against its coordinates.

    Parameters
    ----------
    info : SourceInfo
    given : CRS, optional
        CRS in place of the file's.

    Returns
    -------
    CRS
        Horizontal CRS.

    Raises
    ------
    InputError
        The raster has no geotransform or CRS, its pixels are flat, or its coordinates cannot belong to that CRS.
    """
    if info.transform is None:
        points = control_point_count(info.path)
        raise InputError(
            f"the raster has no geotransform{f', but {points} control points' if points else ' and no world file'}",
            where=info.path,
            hint="place it by control points first: geomosaic georeference",
        )
    _require_shape(info.transform, info.path)
    crs = given or info.crs
    grid = Grid(CRS("EPSG:4326"), info.transform, info.width, info.height)
    left, bottom, right, top = grid.bounds
    place = f"x {left:.8g} to {right:.8g}, y {bottom:.8g} to {top:.8g}"
    small = max(abs(left), abs(right)) <= 360.0 and max(abs(bottom), abs(top)) <= 90.0
    if crs is None:
        kind = "could be degrees" if small else "are no degrees, so they belong to a projected CRS"
        raise InputError(
            "the raster names no CRS", where=info.path,
            hint=f"give `src_crs`; its coordinates ({place}) {kind}",
        )  # fmt: skip
    crs = horizontal(crs)
    turn = whole_turn(crs)
    if turn is not None and max(abs(bottom), abs(top)) > turn / 4 * (1 + _HAIR):
        raise InputError(
            f"the coordinates ({place}) are no longitudes and latitudes, as the CRS '{crs.name}' has them",
            where=info.path,
            hint="give the CRS of the map that they belong to as `src_crs`, or exchange x and y",
        )
    if crs.is_projected and small and float(np.max(grid.resolution)) < _TINY:
        warn(
            f"{info.path}: the coordinates ({place}) look like degrees, and the CRS '{crs.name}' counts in "
            f"{crs.axis_info[0].unit_name}; if they are degrees, give `src_crs=EPSG:4326`"
        )
    return crs
