"""Monoplotting: places on the ground from pixels; measured pixels in, ground points and drawings out."""

from __future__ import annotations

import csv
import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pyproj import CRS
from pyproj.crs import CompoundCRS
from pyproj.exceptions import CRSError

from geomosaic.errors import HeightDatumError, InputError
from geomosaic.geo.crs import has_heights, horizontal, with_heights
from geomosaic.geo.pixel_axes import ROWS, PixelAxes
from geomosaic.geo.transform import Transform
from geomosaic.inputs.tables import read_table
from geomosaic.raster.files import check_output
from geomosaic.raster.vector import append_layer, read_layer
from geomosaic.raster.vector_copy import DRIVERS, READ
from geomosaic.sensor.error_propagation import Ellipses, InputUncertainty, ellipses
from geomosaic.sensor.plugin import SensorModel
from geomosaic.sensor.solve import image_to_ground
from geomosaic.surface.model import Surface
from geomosaic.types import BoolArray, FloatArray
from geomosaic.whole_files import under_construction

if TYPE_CHECKING:
    from geopandas import GeoDataFrame


@dataclass(frozen=True)
class Places:
    """Where image points lie on the ground.

    Attributes
    ----------
    crs : CRS
        Of `xyz`; its vertical part says what z counts from. 2-D where heights play no part.
    colrow : array (N, 2)
        Pixels.
    xyz : array (N, 3)
        NaN where the line of sight meets no known ground; z is 0 where heights play no part.
    ellipses : Ellipses
        NaN where no part of the error is known.
    """

    crs: CRS
    colrow: FloatArray
    xyz: FloatArray
    ellipses: Ellipses

    @property
    def seen(self) -> BoolArray:
        """Which points (N,) have a place."""
        return np.asarray(np.isfinite(self.xyz).all(axis=1), dtype=np.bool_)


def locate(
    model: SensorModel, surface: Surface | None, colrow: FloatArray, crs: CRS, uncertainty: InputUncertainty
) -> Places:
    """Places that image points show.

    Parameters
    ----------
    model : SensorModel
    surface : Surface or None
        None for models without heights.
    colrow : array (N, 2)
        Pixels; (0.5, 0.5) is the centre of the upper-left one.
    crs : CRS
        Of the result, see `ground_crs`.
    uncertainty : InputUncertainty
    """
    image = np.asarray(colrow, dtype=np.float64).reshape(-1, 2)
    ground = image_to_ground(model, image, surface)
    own = model.crs if surface is None else surface.crs
    if has_heights(crs) and has_heights(own):
        xyz = Transform(own, crs)(ground)
    else:
        xyz = np.column_stack([Transform(horizontal(own), horizontal(crs))(ground[:, :2]), ground[:, 2]])
    xyz[~np.isfinite(xyz).all(axis=1)] = np.nan
    found = ellipses(model, surface, crs, xyz, uncertainty)
    if not uncertainty.known:
        found = Ellipses(np.full((len(xyz), 3, 3), np.nan))
    return Places(crs, image, xyz, found)


def ground_crs(model: SensorModel, surface: Surface | None, crs: CRS | None, heights: str | None) -> CRS:
    """Choose the CRS of places: what is asked for, and the rest as the surface has it.

    Parameters
    ----------
    model : SensorModel
    surface : Surface or None
    crs : CRS, optional
        Asked for; a vertical part of its own holds.
    heights : str, optional
        Vertical datum asked for.

    Raises
    ------
    HeightDatumError
        A vertical datum is asked for where heights play no part.
    """
    own = model.crs if surface is None else surface.crs
    if not has_heights(own):
        if heights is not None:
            raise HeightDatumError(
                "heights play no part here, so they have no vertical datum", where="`dst_heights`", hint="leave it out"
            )
        return own if crs is None else horizontal(crs)
    chosen = own if crs is None else crs
    if heights is not None:
        return with_heights(chosen, heights, "`dst_heights`")
    if has_heights(chosen):
        return chosen
    if own.is_compound:
        vertical = own.sub_crs_list[1]
        return CompoundCRS(f"{chosen.name} + {vertical.name}", [chosen, vertical])
    return chosen.to_3d()


SUFFIXES = (*DRIVERS, ".csv")


def check_name(path: Path, *, overwrite: bool, inputs: Iterable[Path] = ()) -> None:
    """Check, before any work, that an output has a known suffix and may be written.

    Parameters
    ----------
    path : Path
    overwrite : bool
    inputs : iterable of Path
        Files that are read.

    Raises
    ------
    InputError
        The suffix is not known, or the name is taken or an input's.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(
            f"'{path.suffix}' is no format that can be written",
            where=str(path),
            hint=f"end the name in {', '.join(SUFFIXES)}",
        )
    check_output(path, overwrite=overwrite, inputs=inputs)


def write_csv(path: Path, columns: Sequence[str], rows: Iterable[Sequence[Any]], *, overwrite: bool) -> None:
    """CSV table in full precision; unknown values are empty.

    Parameters
    ----------
    path : Path
    columns : sequence of str
    rows : iterable of sequence
    overwrite : bool
    """
    check_output(path, overwrite=overwrite)
    with under_construction(path) as unfinished, unfinished.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows(["" if value is None else value for value in row] for row in rows)


def _writable(crs: CRS) -> bool:
    """Whether files can hold a 3-D CRS whole: no ellipsoidal heights of a projected CRS, no geoid from a file."""
    # GeoJSON names a CRS by its code only, which joined ones have not. A column says what heights count from then.
    try:
        crs.to_wkt("WKT1_GDAL")
    except CRSError:
        return False
    return "BOUNDCRS" not in crs.to_wkt()


def write_frame(path: Path, frame: GeoDataFrame, layer: str, *, overwrite: bool) -> None:
    """Write a data frame of features as one layer.

    Parameters
    ----------
    path : Path
        Its suffix says the format.
    frame : GeoDataFrame
        Without a CRS where its coordinates are pixels.
    layer : str
    overwrite : bool
        Replace an existing file.
    """
    check_output(path, overwrite=overwrite)
    driver = DRIVERS[path.suffix.lower()]
    if frame.crs is not None:
        crs = horizontal(frame.crs) if driver == "GeoJSON" or not _writable(frame.crs) else frame.crs
        frame = frame.set_crs(crs, allow_override=True)
    with under_construction(path, path.suffix) as unfinished, warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="'crs' was not provided", category=UserWarning)
        append_layer(unfinished, frame, layer, driver)


# Pixels beyond the border that still count as inside: the edge of an image, digitized by hand.
BORDER = 1.0
ROWS_HINT = "`rows=down` (rows count down from the top), negative (the same with a minus, as QGIS shows it) or up"


@dataclass(frozen=True)
class PixelPoints:
    """Names and image coordinates (N, 2), pixels."""

    names: tuple[str, ...]
    colrow: FloatArray


def read_pixels(path: Path, axes: PixelAxes, size: tuple[int, int]) -> PixelPoints:
    """Image points from a table with the columns col, row and optionally id.

    Parameters
    ----------
    path : Path
    axes : PixelAxes
    size : tuple of int
        Width and height of the image, pixels.

    Raises
    ------
    InputError
        Names file and line.
    """
    table = read_table(path, "table of pixels", "id,col,row")
    table.require("col", "row", what="pixels")
    names, places = [], []
    for number, row in enumerate(table, 1):
        names.append(row.values.get("id", "").strip() or str(number))
        places.append((row.number("col"), row.number("row")))
    colrow = axes.colrow(np.array(places))
    require_inside(colrow, size, str(path))
    return PixelPoints(tuple(names), colrow)


def read_digitized(path: Path, layer: str | None, axes: PixelAxes, size: tuple[int, int]) -> GeoDataFrame:
    """Vectors digitized on the raw photo, in (col, row); a CRS in their file is ignored.

    Parameters
    ----------
    path : Path
    layer : str or None
    axes : PixelAxes
    size : tuple of int
        Width and height of the image, pixels.

    Raises
    ------
    InputError
        The file cannot be read, is empty, or its coordinates are no pixels of this image.
    """
    import shapely

    frame = read_layer(path, layer)
    frame = frame[~(frame.geometry.isna() | frame.geometry.is_empty)]
    if not len(frame):
        raise InputError("the layer has no features", where=str(path), hint="draw or choose a layer that has some")
    pixels = shapely.transform(shapely.force_2d(np.asarray(frame.geometry.values)), axes.colrow)
    require_inside(shapely.get_coordinates(pixels), size, str(path))
    return frame.set_geometry(pixels).set_crs(None, allow_override=True)


def is_digitized(path: Path) -> bool:
    """Whether a file's suffix is that of vectors, not of a table.

    Parameters
    ----------
    path : Path
    """
    return path.suffix.lower() in READ


def outside_image(colrow: FloatArray, size: tuple[int, int]) -> BoolArray:
    """Mask (N,) of image points (N, 2) outside the image, where the model would only extrapolate.

    Parameters
    ----------
    colrow : array (N, 2)
    size : tuple of int
        Width and height of the image, pixels.
    """
    inside = ((colrow >= -BORDER) & (colrow <= np.array(size) + BORDER)).all(axis=1)
    return np.logical_not(np.atleast_1d(inside))


def require_inside(colrow: FloatArray, size: tuple[int, int], where: str) -> None:
    """Check that any point lies in the image; the error proposes another count of rows that fits.

    Parameters
    ----------
    colrow : array (N, 2)
    size : tuple of int
        Width and height of the image, pixels.
    where : str
        Named by errors.
    """
    if not outside_image(colrow, size).all():
        return
    (left, top), (right, bottom) = np.min(colrow, axis=0), np.max(colrow, axis=0)
    fits = [
        rows
        for rows, low, high in (("negative", -bottom, -top), ("up", size[1] - bottom, size[1] - top))
        if low >= -BORDER and high <= size[1] + BORDER and left >= -BORDER and right <= size[0] + BORDER
    ]
    hint = f"`rows={fits[0]}` would bring them into it; " if fits else ""
    raise InputError(
        f"columns {left:.6g} to {right:.6g} and rows {top:.6g} to {bottom:.6g} are no pixels of this image of "
        f"{size[0]} x {size[1]}",
        where=where,
        hint=f"{hint}say how rows are counted: {ROWS_HINT}; places on the map are drawn with `inverse`",
    )


def axes_of(rows: str | None, first: float, size: tuple[int, int], path: Path | None) -> PixelAxes:
    """Pixel axes of a file: declared for vectors, rows downwards by default for tables.

    Parameters
    ----------
    rows : str or None
    first : float
        Centre of the first pixel: 0.5, 0 or 1.
    size : tuple of int
        Width and height of the image, pixels.
    path : Path or None

    Raises
    ------
    InputError
        Vectors are read or written and nothing says where rows count to.
    """
    if rows is None and path is not None and is_digitized(path):
        raise InputError(
            "nothing says how the pixel coordinates of these vectors count rows", where=str(path), hint=ROWS_HINT
        )
    if rows is not None and rows not in ROWS:
        raise InputError(f"rows are counted '{rows}'", hint=ROWS_HINT)
    return PixelAxes(size[1], rows or "down", first)
