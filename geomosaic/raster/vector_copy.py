"""Vector files written anew with each of their layers changed, whole or not at all."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from geomosaic.errors import InputError, warn
from geomosaic.raster.files import check_output
from geomosaic.raster.vector import append_layer, layer_names, plain_tables, read_layer, read_table
from geomosaic.whole_files import partial, put_in_place, remove

if TYPE_CHECKING:
    from geopandas import GeoDataFrame

# Formats that can be written, by suffix.
DRIVERS = {
    ".gpkg": "GPKG",
    ".geojson": "GeoJSON",
    ".json": "GeoJSON",
    ".fgb": "FlatGeobuf",
    ".shp": "ESRI Shapefile",
}
# Files of a shapefile that is written, in the order in which they get their names: with the last one it is there.
PARTS = (".shx", ".dbf", ".prj", ".cpg", ".shp")
# Spatial indexes of an older shapefile, which know nothing of a new one.
INDEXES = (".qix", ".sbn", ".sbx")
READ = (*DRIVERS, ".osm", ".pbf", ".kml", ".gml", ".gpx", ".tab", ".mif", ".dxf")
_SEVERAL = ("GPKG",)


def is_vector(path: Path) -> bool:
    """Whether a file's suffix is that of a vector file.

    Parameters
    ----------
    path : Path

    Returns
    -------
    bool
    """
    return path.suffix.lower() in READ


def rewrite_layers(
    path: Path,
    output: Path,
    change: Callable[[GeoDataFrame, str], GeoDataFrame],
    nothing: InputError,
    *,
    overwrite: bool = False,
) -> dict[str, int]:
    """Vector file with all its layers changed; attributes stay as they are.

    Parameters
    ----------
    path : Path
        GeoPackage, GeoJSON, FlatGeobuf, shapefile, DXF, OpenStreetMap, KML ... Layers without features stay so;
        tables without places are copied to a GeoPackage, and left out of other formats, with a note.
    output : Path
        Its suffix says the format.
    change : callable
        From the features of a layer and its name to those that are written.
    nothing : InputError
        Raised where no feature is left of those that there were.
    overwrite : bool
        Replace an existing output.

    Returns
    -------
    dict of str to int
        Number of features by layer.

    Raises
    ------
    InputError
        The input cannot be read; the output is the input, its suffix is not known, or it cannot take several layers, or
        several kinds of geometry.
    OutputError
        Writing failed.
    """
    driver = check_vector_output(output, overwrite=overwrite, inputs=(path,))
    tables = plain_tables(path) if (names := layer_names(path)) else []
    names = [name for name in names if name not in tables]
    if not names:
        raise InputError("the file has no layer with places", where=str(path), hint="name another file")
    if len(names) > 1 and driver not in _SEVERAL:
        raise InputError(
            f"the file has {len(names)} layers, of which {driver} takes one", where=str(path), hint="write a .gpkg"
        )
    layers: dict[str, int] = {}
    notes: list[str] = []
    read = 0
    unfinished = partial(output)
    # With the suffix of the output: GDAL names the parts of a shapefile after it.
    whole = unfinished.with_name(unfinished.name + output.suffix.lower())
    try:
        for name in names:
            frame = read_layer(path, name)
            found, read = change(frame, name), read + len(frame)
            if driver == "ESRI Shapefile":
                _check_one_kind(found, f"{path}, layer {name}")
            notes += append_layer(whole, found, output.stem if driver == "ESRI Shapefile" else name, driver)
            layers[name] = len(found)
        if read and not sum(layers.values()):
            raise nothing
        for name in tables if driver in _SEVERAL else ():
            notes += append_layer(whole, read_table(path, name), name, driver)
        _publish(whole, output, driver)
    finally:
        remove(unfinished)
    if tables and driver not in _SEVERAL:
        notes.append(f"tables without places are left out: {', '.join(tables)}")
    for text in dict.fromkeys(notes):
        warn(f"{output}: {text}")
    return layers


def check_vector_output(output: Path, *, overwrite: bool, inputs: tuple[Path, ...] = ()) -> str:
    """GDAL's name of the format that a suffix says, checked before any work.

    Parameters
    ----------
    output : Path
    overwrite : bool
    inputs : tuple of Path
        Files that are read.

    Raises
    ------
    InputError, OutputExistsError
        The suffix is not known, or the name is taken or an input's.
    """
    driver = DRIVERS.get(output.suffix.lower())
    if driver is None:
        raise InputError(
            f"'{output.suffix}' is no format of vectors that can be written",
            where=str(output),
            hint=f"end the name in {', '.join(DRIVERS)}",
        )
    for part in _files(output, driver):
        check_output(part, overwrite=overwrite, inputs=inputs)
    return driver


def _files(output: Path, driver: str) -> list[Path]:
    """All files that will be there under the name of the output, that one last."""
    return [output.with_suffix(end) for end in PARTS[:-1]] + [output] if driver == "ESRI Shapefile" else [output]


def _publish(whole: Path, output: Path, driver: str) -> None:
    """Give finished files their names; an older shapefile goes first, so that parts of two are never taken for one."""
    parts = _files(output, driver)
    if len(parts) > 1:
        for old in (output, *(output.with_suffix(end) for end in INDEXES)):
            old.unlink(missing_ok=True)
    for part in parts:
        made = whole.with_suffix(part.suffix.lower())
        if made.exists():
            put_in_place(made, part)


def _check_one_kind(frame: GeoDataFrame, where: str) -> None:
    kinds = {str(kind).removeprefix("Multi") if "Point" not in str(kind) else str(kind) for kind in frame.geom_type}
    kinds -= {"None", "nan"}
    if len(kinds) > 1:
        raise InputError(
            f"the layer holds {' and '.join(sorted(kinds))}, of which a shapefile takes one", where=where,
            hint="write a .gpkg",
        )  # fmt: skip
