"""Tables and vector files of places and drawings, whole under their final name or not at all."""

from __future__ import annotations

import csv
import warnings
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pyproj import CRS
from pyproj.exceptions import CRSError

from geomosaic.errors import InputError
from geomosaic.geo.crs import horizontal
from geomosaic.product.vectors import DRIVERS
from geomosaic.raster.output import check_output
from geomosaic.raster.unfinished import under_construction
from geomosaic.raster.vector import append_layer

if TYPE_CHECKING:
    from geopandas import GeoDataFrame

SUFFIXES = (*DRIVERS, ".csv")


def check_name(path: Path, *, overwrite: bool) -> None:
    """Refuse a name that cannot be written, before any work.

    Raises
    ------
    InputError
        The suffix is not known, or the name is taken.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(
            f"'{path.suffix}' is no format that can be written",
            where=str(path),
            mend=f"end the name in {', '.join(SUFFIXES)}",
        )
    check_output(path, overwrite=overwrite)


def write_csv(path: Path, columns: Sequence[str], rows: Iterable[Sequence[Any]], *, overwrite: bool) -> None:
    """Write a table; numbers in full precision, what is unknown is empty."""
    check_output(path, overwrite=overwrite)
    with under_construction(path) as unfinished, unfinished.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows(["" if value is None else value for value in row] for row in rows)


def _writable(crs: CRS) -> bool:
    """Whether a file can hold a 3-D CRS whole: not ellipsoidal heights of a map, and no geoid of someone's own.

    GeoJSON names a CRS by its code only, which joined ones have not. A column says what heights count from then.
    """
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
