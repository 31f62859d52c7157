"""Vector layers: GeoPackages written, any format of GDAL's read."""

from __future__ import annotations

import os
import tempfile
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pyproj import CRS

from geomosaic.errors import InputError, OutputError
from geomosaic.raster.files import check_output
from geomosaic.stores.path import StorePath, to_path
from geomosaic.types import PathLike
from geomosaic.whole_files import MOST_ROWS, check_rows, under_construction

if TYPE_CHECKING:
    from geopandas import GeoDataFrame


class VectorProduct:
    """Result that is a vector file, a table (CSV) included; the counterpart of `RasterProduct`."""

    path: Path

    def read(self, layer: str | None = None) -> GeoDataFrame:
        """Features of the file, see `read_product`.

        Parameters
        ----------
        layer : str, optional
            Name; the first layer by default.

        Returns
        -------
        GeoDataFrame

        Raises
        ------
        InputError
            The file is gone, or has no such layer.
        """
        return read_product(self.path, layer)


def read_product(path: Path, layer: str | None = None) -> GeoDataFrame:
    """Features of a file of results: a layer, or the rows of a table (CSV), which have no geometry.

    Parameters
    ----------
    path : Path
    layer : str, optional
        Name; the first layer by default.

    Returns
    -------
    GeoDataFrame

    Raises
    ------
    InputError
        The file is missing, or has no such layer.
    """
    if path.suffix.lower() == ".csv":
        import geopandas
        import pandas

        return geopandas.GeoDataFrame(pandas.read_csv(path))
    return read_layer(path, layer)


@dataclass(frozen=True)
class Layer:
    """A vector layer.

    Attributes
    ----------
    crs : CRS
    kind : str, OGR name of the geometry type: 'Polygon', 'MultiPolygon', 'LineString' ... of all geometries.
    geometries : sequence of shapely geometry
    columns : mapping of str to sequence, one value per geometry
    """

    crs: CRS
    kind: str
    geometries: Sequence[Any]
    columns: Mapping[str, Sequence[Any]]


def write_layers(path: PathLike, layers: Mapping[str, Layer], *, overwrite: bool = False) -> Path:
    """GeoPackage with one layer per entry, whole under its final name or not at all.

    Parameters
    ----------
    path : path, ends in .gpkg
    layers : mapping of str to Layer, by layer name, in this order
    overwrite : bool, replace an existing file

    Raises
    ------
    OutputExistsError, InputError
        The name is taken, the folder does not exist, or there is no layer.
    OutputError
        Writing failed.
    """
    from pyogrio.errors import DataLayerError, DataSourceError, FeatureError, GeometryError

    final = to_path(path)
    check_output(final, overwrite=overwrite)
    if not layers:
        raise InputError("there is no layer to write", where=str(path), hint="give at least one layer")
    failures = DataSourceError, DataLayerError, FeatureError, GeometryError
    # Equal layers make equal bytes: the time in the file is fixed.
    with _dated(), under_construction(final, ".gpkg", failures) as unfinished:
        for name, layer in layers.items():
            _write(unfinished, name, layer)
    return final


def prepare() -> None:
    """Import what `write_layers` needs: half a second, better spent beside other work."""
    import pyogrio.raw  # noqa: F401


def _write(path: Path, name: str, layer: Layer) -> None:
    """Write one layer, without the detour over a data frame, whose libraries take a second to import."""
    import pyogrio.raw
    import shapely

    many = layer.kind.startswith("Multi")
    geometries = np.empty(len(layer.geometries), dtype=object)
    for i, geometry in enumerate(layer.geometries):
        geometries[i] = shapely.to_wkb(_many(geometry) if many else geometry)
    columns = [np.array(values) for values in layer.columns.values()]
    columns = [column.astype(object) if column.dtype.kind in "US" else column for column in columns]
    pyogrio.raw.write(
        path, geometries, columns, list(layer.columns), layer=name, driver="GPKG", geometry_type=layer.kind,
        crs=layer.crs.to_wkt(), append=path.exists(), promote_to_multi=False,
    )  # fmt: skip


def _many(geometry: Any) -> Any:
    import shapely

    plain = {"Polygon": shapely.MultiPolygon, "LineString": shapely.MultiLineString, "Point": shapely.MultiPoint}
    return plain[geometry.geom_type]([geometry]) if geometry.geom_type in plain else geometry


@contextmanager
def _dated() -> Iterator[str]:
    """The time that files carry: SOURCE_DATE_EPOCH, or 1970-01-01 where that is not set."""
    import pyogrio

    seconds = int(os.environ.get("SOURCE_DATE_EPOCH") or 0)
    date = datetime.fromtimestamp(seconds, UTC).strftime("%Y-%m-%dT%H:%M:%S.000Z")
    before = pyogrio.get_gdal_config_option("OGR_CURRENT_DATE")
    pyogrio.set_gdal_config_options({"OGR_CURRENT_DATE": date})
    try:
        yield date
    finally:
        pyogrio.set_gdal_config_options({"OGR_CURRENT_DATE": before})


def append_layer(path: Path, frame: Any, name: str, driver: str) -> list[str]:
    """Layer, or table without places, added behind the layers that a file has.

    Parameters
    ----------
    path : Path
    frame : GeoDataFrame or DataFrame
    name : str, of the layer
    driver : str, GDAL's name of the format

    Returns
    -------
    list of str, what the format could not keep, in GDAL's words

    Raises
    ------
    OutputError
        Writing failed.
    """
    import pyogrio
    from pyogrio.errors import DataLayerError, DataSourceError, FeatureError, FieldError, GeometryError

    # GeoJSON of today is in longitude and latitude only; the older form names another CRS.
    layer_options = {"RFC7946": "NO"} if driver == "GeoJSON" else {}
    try:
        with _dated() as date, warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            if driver == "ESRI Shapefile":
                layer_options = {"DBF_DATE_LAST_UPDATE": date[:10]}
            pyogrio.write_dataframe(
                frame, path, layer=name, driver=driver, append=path.exists(), layer_options=layer_options,
                use_arrow=False,
            )  # fmt: skip
        return list(dict.fromkeys(str(w.message) for w in caught if issubclass(w.category, RuntimeWarning)))
    except (DataSourceError, DataLayerError, FeatureError, FieldError, GeometryError, OSError) as error:
        raise OutputError(
            f"writing failed ({error})",
            where=str(path),
            hint="check the space on the disk and the rights of the folder",
        ) from error


def layer_names(path: PathLike) -> list[str]:
    """Names of the layers of a vector file, in its order.

    Parameters
    ----------
    path : path

    Raises
    ------
    InputError
        The file is missing or no vector file.
    """
    import pyogrio
    from pyogrio.errors import DataLayerError, DataSourceError

    if not to_path(path).exists():
        raise InputError("the file does not exist", where=str(path), hint="check the path")
    try:
        return [str(name) for name in pyogrio.list_layers(_readable(path))[:, 0]]
    except (DataSourceError, DataLayerError, IndexError, UnicodeError) as error:  # names of layers and columns
        raise _unreadable(path, error) from error


def plain_tables(path: PathLike) -> list[str]:
    """Names of the tables of a vector file that have no places, such as the styles that QGIS keeps in a GeoPackage.

    Parameters
    ----------
    path : path
    """
    import pyogrio

    return [str(name) for name, kind in pyogrio.list_layers(_readable(path)) if kind is None]


def read_table(path: PathLike, name: str) -> Any:
    """Table of a vector file that has no places.

    Parameters
    ----------
    path : path
    name : str, of the table
    """
    import pyogrio

    return pyogrio.read_dataframe(_readable(path), layer=name)


# Bytes of a file of vectors in a store, which is read as a whole.
_LARGEST = 1 << 30


def _readable(path: PathLike) -> PathLike:
    """Path that OGR reads a file of vectors from: its own, or a copy in the scratch folder of one in a store."""
    file = to_path(path)
    if not isinstance(file, StorePath):
        return path
    facts = file.stat()
    if facts.st_size > _LARGEST or file.suffix.lower() == ".shp":
        what = "a shapefile is several files" if facts.st_size <= _LARGEST else "the file is larger than 1 GB"
        raise InputError(
            f"{what}, and from a store vectors are read whole", where=str(path), hint="give a GeoPackage of it"
        )
    return _copy(str(file), facts.st_mtime_ns)


@cache
def _scratch() -> tempfile.TemporaryDirectory[str]:
    """Folder of such copies, removed with the process."""
    return tempfile.TemporaryDirectory(prefix="geomosaic-")


@cache
def _copy(path: str, time: int) -> Path:
    """Copy of an object as it was at a time, under its own name, by whose ending formats are known."""
    file = to_path(path)
    folder = Path(_scratch().name) / f"{len(list(Path(_scratch().name).iterdir()))}"
    folder.mkdir()
    copy = folder / file.name
    copy.write_bytes(file.read_bytes())
    return copy


def layer_counts(path: PathLike) -> dict[str, int]:
    """Numbers of objects by layer.

    Parameters
    ----------
    path : path

    Returns
    -------
    dict of str to int, in the order of the file

    Raises
    ------
    InputError
        The file is missing or no vector file.
    """
    import pyogrio

    names = layer_names(path)
    return {
        name: int(pyogrio.read_info(_readable(path), layer=name, force_feature_count=True)["features"])
        for name in names
    }


def read_layer(path: PathLike, layer: str | None = None) -> GeoDataFrame:
    """Layer of a vector file (GeoPackage, GeoJSON, Shapefile, FlatGeobuf ...).

    Parameters
    ----------
    path : path
    layer : str, optional, name; the first layer by default

    Raises
    ------
    InputError
        The file is missing or no vector file, or has no such layer.
    """
    import geopandas
    import pyogrio
    import shapely
    from pyogrio.errors import DataLayerError, DataSourceError
    from shapely.errors import GEOSException

    names = layer_names(path)
    if layer is not None and layer not in names:
        raise InputError(
            f"there is no layer '{layer}'", where=str(path), hint=f"the file has: {', '.join(names) or 'none'}"
        )
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # of further layers: the first is what is documented
            warnings.simplefilter("ignore", RuntimeWarning)  # of outlines that do not close: an error of our own tells
            # A limit takes its room before the first row is read, 8 MB a column: only where the rows are not yet known.
            known = pyogrio.read_info(_readable(path), layer=layer or names[0])["features"]
            most = None if 0 <= known <= MOST_ROWS else MOST_ROWS + 1
            frame = pyogrio.read_dataframe(_readable(path), layer=layer or names[0], max_features=most)
    except GEOSException as error:
        raise _no_geometry(path, layer or names[0], str(error)) from error
    except (DataSourceError, DataLayerError, IndexError, UnicodeError) as error:  # names of layers and columns
        raise _unreadable(path, error) from error
    check_rows(len(frame), f"{path}, layer {layer or names[0]}")
    if not isinstance(frame, geopandas.GeoDataFrame):
        raise InputError("the layer has no geometry", where=str(path), hint="name a layer of points, lines or areas")
    coordinates, rows = shapely.get_coordinates(frame.geometry, return_index=True)
    lost = np.flatnonzero(~np.isfinite(coordinates).all(axis=1))
    if len(lost):
        raise InputError(
            f"row {rows[lost[0]] + 1} has a coordinate that is not finite",
            where=f"{path}, layer {layer or names[0]}",
            hint="draw the object anew or delete it, for example in QGIS",
        )
    return frame


def _unreadable(path: PathLike, error: Exception) -> InputError:
    return InputError(
        f"this is not a vector file that can be read ({error})", where=str(path), hint="convert it to GeoPackage"
    )


def _no_geometry(path: PathLike, layer: str, cause: str) -> InputError:
    """Error that names the first row whose outline does not close, or has too few points."""
    import pyogrio.raw
    import shapely

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        written = pyogrio.raw.read(_readable(path), layer=layer, columns=[])[2]
    read = shapely.from_wkb(written, on_invalid="ignore")
    row = next((i for i, (wkb, shape) in enumerate(zip(written, read, strict=True), 1) if wkb and shape is None), 0)
    return InputError(
        f"row {row} is no geometry: {cause.partition(': ')[2] or cause}",
        where=f"{path}, layer {layer}",
        hint="close the outline of each area, with three corners or more, for example by drawing it anew in QGIS",
    )
