"""Photos: image files with their rows of the orientation table."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from pyproj import CRS

from geomosaic.errors import InputError
from geomosaic.geo.local_frames import is_free
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
        Its row of the orientation table.
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
            "nothing says how the printed list is to be read",
            where=str(path),
            hint="say it in a project, under [exterior.printed]: columns, axes, sequence, lines, skip",
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
        3-D CRS of positions and control points, where one was named.

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
    # OpenSfM's reference is on the ellipsoid of WGS 84, by its own definition; geocentric coordinates are told by their
    # file or by the sensor's inputs; all others count from a named CRS.
    if inputs.exterior is not None and crs is None and inputs.angles not in SELF_PLACED:
        raise InputError(
            "the positions have no CRS",
            where=str(inputs.exterior),
            hint="name it with `crs`",
        )
    if table is None:
        return [Photo(path, info, None) for path, info in zip(inputs.images, infos, strict=True)], crs
    photos = [Photo(path, info, table.row(path.name)) for path, info in zip(inputs.images, infos, strict=True)]
    # The whole table: one image alone tells nothing of the unit, its neighbours do.
    if crs is None or not is_free(crs):  # who walks round a thing turns with it, not along his way
        check_units(table, inputs.angle_unit, list(table.rows.values()), crs)
    return photos, crs
