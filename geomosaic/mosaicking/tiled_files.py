"""Virtual rasters, overviews and tile index of a mosaic that is written as many files."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

from geomosaic.geo.grid import Grid, Window
from geomosaic.mosaicking.outputs import MosaicFiles
from geomosaic.options.render import BLOCK_WIDTH
from geomosaic.raster.joined_overview import overview_factor, write_overview
from geomosaic.raster.virtual import write_tile_index, write_vrt


def write_virtual(files: MosaicFiles, grid: Grid, tiles: Mapping[Window, MosaicFiles]) -> None:
    """Virtual rasters of mosaic and labels with their overviews, and the tile index.

    Parameters
    ----------
    files : MosaicFiles
    grid : Grid
        Of the mosaic.
    tiles : mapping of Window to MosaicFiles
        Files of the tiles that show something, by their place. Those that stand there under their names are replaced.
    """
    mosaics = {own.mosaic: window for window, own in tiles.items()}
    labels = {own.labels: window for window, own in tiles.items() if own.labels is not None}
    # Tiles of an earlier mosaic of this name, of another size or extent, would seem to belong to this one; nor is
    # anyone left who could finish a tile that a worker, perhaps of another machine, has left half made.
    written = {*mosaics, *labels, *(own.item for own in tiles.values())}
    for file in files.folder.iterdir():
        if re.match(r"\.?" + re.escape(files.mosaic.stem) + r"-r\d{3,}-c\d{3,}[-.]", file.name) and file not in written:
            file.unlink()
    factor = overview_factor(grid, mosaics, BLOCK_WIDTH)
    if files.labels is not None:
        write_vrt(files.labels, grid, labels, overview=_overview(files.labels, grid, labels, factor), overwrite=True)
    write_tile_index(files.index, grid, mosaics, overwrite=True)
    overview = _overview(files.mosaic, grid, mosaics, factor)
    write_vrt(files.mosaic, grid, mosaics, overview=overview, overwrite=True)


def _overview(path: Path, grid: Grid, files: Mapping[Path, Window], factor: int) -> Path | None:
    """Overview of the rasters that a virtual one shows, in the folder of the tiles; None where they are small."""
    output = next(iter(files)).parent / f"{path.stem}-overview.tif"
    if factor == 1:
        output.unlink(missing_ok=True)
        return None
    write_overview(output, grid, files, factor, categorical=path.stem.endswith("-labels"))
    return output
