"""Images of a block: photos with their rows of the orientation table, and georeferenced rasters."""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from affine import Affine
from pyproj import CRS

from geomosaic.block import OrientedImage
from geomosaic.errors import GeomosaicWarning, InputError, counted, did_you_mean, listed
from geomosaic.geo.crs import horizontal, is_local
from geomosaic.geo.grid import Grid
from geomosaic.geo.projection_domain import whole_turn
from geomosaic.inputs.declarations import Block
from geomosaic.inputs.exterior_orientation import (
    RECONSTRUCTIONS,
    SELF_PLACED,
    ExteriorRow,
    ExteriorTable,
    check_units,
    read_exterior,
)
from geomosaic.inputs.frames import positions_crs
from geomosaic.inputs.tables import find_by_name, read_table
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


def with_usable(inputs: Block, scenes: Sequence[OrientedImage]) -> tuple[OrientedImage, ...]:
    """Images restricted to their usable areas: an image's own polygon, else one for all images, else the margin.

    Parameters
    ----------
    inputs : Block
    scenes : sequence of OrientedImage

    Returns
    -------
    tuple of OrientedImage

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
        warnings.warn(
            f"fiducial marks, instruments and borders of the film would appear in the output ({listed(bare, 3)}): "
            "leave them out with `margin` in pixels, or polygons in `usable`",
            GeomosaicWarning,
            stacklevel=2,
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


_COLOURS = ("red", "green", "blue")


def chosen_bands(inputs: Block, photo: Photo) -> tuple[int, ...] | None:
    """Bands of an image that are used: by number, or by name whatever their order in each file.

    Parameters
    ----------
    inputs : Block
    photo : Photo

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
    return tuple(_number(photo.info, str(photo.path), name) for name in inputs.band_names)


def check_same_bands(scenes: Sequence[OrientedImage]) -> None:
    """Check that images have the same bands: number, order of names, scale and offset of values.

    Parameters
    ----------
    scenes : sequence of OrientedImage

    Raises
    ------
    InputError
        Names an image that differs from the first one.
    """
    infos = [inspect(scene.path, scene.bands) for scene in scenes]
    first = infos[0]
    for scene, info in zip(scenes, infos, strict=True):
        if info.bands != first.bands:
            alpha = " besides alpha" if info.alpha or first.alpha else ""
            raise InputError(
                f"the image has {_bands(info)}{alpha}, '{scenes[0].name}' has {_bands(first)}",
                where=scene.path,
                hint="choose the same bands of all images: `bands=1,2,3`, or by name `band_names=red,green,blue`",
            )
        mine, other = _names(info), _names(first)
        if mine != other and sorted(mine) == sorted(other):
            raise InputError(
                f"the bands are {', '.join(mine)}, those of '{scenes[0].name}' are {', '.join(other)}",
                where=scene.path,
                hint=f"`band_names={','.join(other)}` brings them into one order",
            )
        if (info.scales, info.offsets) != (first.scales, first.offsets):
            raise InputError(
                f"stored numbers stand for other values (scale {info.scales[0]:g}, offset {info.offsets[0]:g}) than "
                f"those of '{scenes[0].name}' (scale {first.scales[0]:g}, offset {first.offsets[0]:g})",
                where=scene.path,
                hint="bring them to one scale first, for example with gdal_translate -unscale",
            )


def _number(info: SourceInfo, path: str, name: str) -> int:
    plain = [i for i in range(1, info.bands + (info.alpha is not None) + 1) if i != info.alpha]
    wanted = name.strip().casefold()
    for known in (_descriptions(info), list(info.colors)):
        found = [number for number, own in zip(plain, known, strict=True) if own.casefold() == wanted]
        if len(found) == 1:
            return found[0]
        if found:
            raise InputError(f"several bands are called '{name}'", where=path, hint="choose by number: `bands`")
    have = [text for text in (*_descriptions(info), *(c for c in info.colors if c in _COLOURS)) if text]
    raise InputError(
        f"no band is called '{name}'",
        where=path,
        hint=did_you_mean(name, have) or (f"it has {', '.join(have)}" if have else "choose by number: `bands`"),
    )


def _descriptions(info: SourceInfo) -> list[str]:
    return [(text or "").strip() for text in info.descriptions]


def _names(info: SourceInfo) -> list[str]:
    """Names of bands: descriptions where all bands have one, else colour interpretations."""
    described = [text.casefold() for text in _descriptions(info)]
    if all(described) and len(set(described)) == len(described):
        return described
    return list(info.colors) if set(info.colors) >= set(_COLOURS) else []


def _bands(info: SourceInfo) -> str:
    return counted(info.bands, "band")


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
        warnings.warn(
            f"{info.path}: the coordinates ({place}) look like degrees, and the CRS '{crs.name}' counts in "
            f"{crs.axis_info[0].unit_name}; if they are degrees, give `src_crs=EPSG:4326`",
            GeomosaicWarning,
            stacklevel=2,
        )
    return crs
