"""Virtual rasters (VRT) over files that lie side by side on one grid, and GDAL's index of such files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from geomosaic.geo.grid import Grid, Window
from geomosaic.raster.environment import environment
from geomosaic.raster.files import write_text
from geomosaic.raster.info import open_raster
from geomosaic.raster.vector import Layer, write_layers
from geomosaic.whole_files import relative_path

# Sample types as GDAL names them.
_TYPES = {
    "uint8": "Byte", "int8": "Int8", "uint16": "UInt16", "int16": "Int16", "uint32": "UInt32", "int32": "Int32",
    "float32": "Float32", "float64": "Float64",
}  # fmt: skip


def write_vrt(
    path: Path, grid: Grid, files: Mapping[Path, Window], *, overview: Path | None = None, overwrite: bool = False
) -> None:
    """VRT of files that lie side by side; where there is none nothing is valid.

    Parameters
    ----------
    path : Path
    grid : Grid
        Of the whole.
    files : mapping of Path to Window
        All of one form; the place of each in pixels of the grid.
    overview : Path, optional
        Raster of the whole in larger pixels, with the same bands, and alpha as the last where the files have masks.
    overwrite : bool

    Raises
    ------
    OutputExistsError, OutputError
    """
    with environment(), open_raster(next(iter(files))) as first:
        names, kinds, values = first.descriptions, first.dtypes, first.nodatavals
        colours = [colour.name.capitalize() for colour in first.colorinterp]
        tags, masked = first.tags(), first.nodata is None
    root = Element("VRTDataset", rasterXSize=str(grid.width), rasterYSize=str(grid.height))
    SubElement(root, "SRS").text = grid.crs.to_wkt()
    SubElement(root, "GeoTransform").text = ", ".join(repr(float(v)) for v in grid.transform.to_gdal())
    metadata = SubElement(root, "Metadata")
    for key, value in tags.items():
        SubElement(metadata, "MDI", key=key).text = value
    bands = []
    for number, (name, kind, nodata) in enumerate(zip(names, kinds, values, strict=True), start=1):
        band = SubElement(root, "VRTRasterBand", dataType=_TYPES[kind], band=str(number))
        if name:
            SubElement(band, "Description").text = name
        if nodata is not None:
            SubElement(band, "NoDataValue").text = repr(nodata)
        SubElement(band, "ColorInterp").text = {"Grey": "Gray"}.get(colours[number - 1], colours[number - 1])
        bands.append((band, str(number)))
    if masked:
        mask = SubElement(SubElement(root, "MaskBand"), "VRTRasterBand", dataType="Byte")
        bands.append((mask, "mask,1"))
    for band, source in bands:
        for file, window in files.items():
            _source(band, relative_path(file, path.parent), source, window)
        if overview is not None:
            own = SubElement(band, "Overview")
            name = relative_path(overview, path.parent)
            SubElement(own, "SourceFilename", relativeToVRT="1").text = name
            SubElement(own, "SourceBand").text = str(len(names) + 1) if source.startswith("mask") else source
    ElementTree.indent(root)
    write_text(path, ElementTree.tostring(root, encoding="unicode") + "\n", overwrite=overwrite)


def _source(band: Element, name: str, source: str, window: Window) -> None:
    """Pixels of one file in their place."""
    one = SubElement(band, "SimpleSource")
    SubElement(one, "SourceFilename", relativeToVRT="1").text = name
    SubElement(one, "SourceBand").text = source
    size = {"xSize": str(window.width), "ySize": str(window.height)}
    SubElement(one, "SrcRect", {"xOff": "0", "yOff": "0", **size})
    SubElement(one, "DstRect", {"xOff": str(window.col), "yOff": str(window.row), **size})


def write_tile_index(path: Path, grid: Grid, files: Mapping[Path, Window], *, overwrite: bool = False) -> None:
    """Index of files that lie side by side, as GDAL's driver GTI (3.9 and newer) opens it as one raster.

    Parameters
    ----------
    path : Path
        Ends in .gti.gpkg.
    grid, files, overwrite
        As for `write_vrt`.

    Raises
    ------
    OutputExistsError, OutputError
    """
    import shapely

    names = [relative_path(file, path.parent) for file in files]
    boxes = [shapely.box(*grid.crop(window).bounds) for window in files.values()]
    columns: dict[str, Sequence[str]] = {"location": names}
    write_layers(path, {"tiles": Layer(grid.crs, "Polygon", boxes, columns)}, overwrite=overwrite)
