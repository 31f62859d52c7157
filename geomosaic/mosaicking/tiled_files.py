"""Virtual rasters and tile index of a mosaic that is written as many files."""

from __future__ import annotations

import re
from collections.abc import Mapping

from geomosaic.geo.grid import Grid, Window
from geomosaic.mosaicking.outputs import MosaicFiles
from geomosaic.raster.virtual import write_tile_index, write_vrt


def write_virtual(files: MosaicFiles, grid: Grid, tiles: Mapping[Window, MosaicFiles], *, overwrite: bool) -> None:
    """Virtual rasters of mosaic and labels, and the tile index.

    Parameters
    ----------
    files : MosaicFiles
    grid : Grid
        Of the mosaic.
    tiles : mapping of Window to MosaicFiles
        Files of the tiles that show something, by their place.
    overwrite : bool
    """
    mosaics = {own.mosaic: window for window, own in tiles.items()}
    labels = {own.labels: window for window, own in tiles.items() if own.labels is not None}
    # Tiles of an earlier mosaic of this name, of another size or extent, would seem to belong to this one.
    written = {*mosaics, *labels, *(own.item for own in tiles.values())}
    for file in files.folder.iterdir():
        if re.match(re.escape(files.mosaic.stem) + r"-r\d{3,}-c\d{3,}[-.]", file.name) and file not in written:
            file.unlink()
    if files.labels is not None:
        write_vrt(files.labels, grid, labels, overwrite=overwrite)
    write_tile_index(files.index, grid, mosaics, overwrite=overwrite)
    write_vrt(files.mosaic, grid, mosaics, overwrite=overwrite)
