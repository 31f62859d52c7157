"""Photos: image files with their rows of the orientation table, and the part of each that may be used."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from pyproj import CRS

from geomosaic.block.block import OrientedImage
from geomosaic.errors import GeomosaicWarning, InputError
from geomosaic.geo.crs import is_local
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
from geomosaic.raster.info import SourceInfo, inspect


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
        return read_exterior(path, inputs.angles)
    from geomosaic.inputs.printed_orientation import read_printed

    if inputs.printed is None:
        raise InputError(
            "the layout of the printed list is not declared",
            where=str(path),
            hint="declare it in a project, under [exterior.printed]: columns, axes, sequence, lines, skip",
        )
    return read_printed(path, inputs.printed, inputs.angle_unit, inputs.matrix)


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
        names = ", ".join(bare[:3]) + (f" and {len(bare) - 3} more" if len(bare) > 3 else "")
        warnings.warn(
            f"fiducial marks, instruments and borders of the film would appear in the output ({names}): leave them out "
            "with `margin` in pixels, or polygons in `usable`",
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
            raise InputError(f"the usable area of '{name}' has {len(ring)} corners", where=str(path), hint="give three")
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
