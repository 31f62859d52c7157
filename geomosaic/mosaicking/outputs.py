"""Files of a mosaic, and the units of pixels on their way to them."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from geomosaic.block import OrientedBlock
from geomosaic.errors import InputError, OutputExistsError, warn
from geomosaic.geo.grid import Grid, Window
from geomosaic.geo.units import metres_per_unit
from geomosaic.mosaicking.result_cache import PARTS
from geomosaic.options.render import BLOCK_WIDTH
from geomosaic.raster.files import check_output, check_output_size, companion
from geomosaic.raster.info import inspect
from geomosaic.stores.path import StorePath
from geomosaic.types import AnyArray, ByteArray, FloatArray
from geomosaic.whole_files import write_atomic

if TYPE_CHECKING:
    from geomosaic.options.mosaic import MosaicOptions, TileSize


def rasters_of_earlier_run(output: Path) -> dict[str, Path]:
    """Rasters that an earlier mosaic of the same name left: its STAC item stands beside it.

    Parameters
    ----------
    output : Path

    Returns
    -------
    dict
        Files by what they are; empty where no item says that it was a mosaic: what stands there may be a photo.
    """
    if isinstance(output, StorePath):
        output.check_writable()  # before another file there is asked for
    if not companion(output, "", ".stac.json").is_file():
        return {}
    names = {
        "": "",
        "-labels": "'s labels",
        "-views": "'s views",
        "-displacement": "'s displacements",
        "-accuracy": "'s accuracies",
    }
    files = {f"an earlier mosaic{what}": companion(output, mark, output.suffix) for mark, what in names.items()}
    return {what: file for what, file in files.items() if file.is_file()}


@dataclass(frozen=True)
class MosaicFiles:
    """Paths of a mosaic and of the files that go with it; None where a file is not asked for.

    Attributes
    ----------
    mosaic : Path
    labels : Path, optional
        Raster of source images.
    views : Path, optional
        Raster of view angles and ground sampling distances.
    displacement : Path, optional
        Raster of relief displacements.
    accuracy : Path, optional
        Raster of standard deviations of position.
    vectors : Path, optional
        GeoPackage of footprints, seam polygons and seamlines.
    item : Path, optional
        STAC item.
    tiled : bool
        Whether mosaic and labels are virtual rasters over files of `tiles`.
    """

    mosaic: Path
    labels: Path | None = None
    views: Path | None = None
    displacement: Path | None = None
    accuracy: Path | None = None
    vectors: Path | None = None
    item: Path | None = None
    tiled: bool = False

    @classmethod
    def of(cls, output: Path, options: MosaicOptions, grid: Grid | None = None) -> MosaicFiles:
        """Files that the options ask for; a grid without a place on the Earth has no STAC item.

        Parameters
        ----------
        output : Path
        options : MosaicOptions
        grid : Grid, optional
        """

        def path(wanted: bool, mark: str, suffix: str) -> Path | None:
            return companion(output, mark, suffix) if wanted else None

        return cls(
            output,
            path(options.writes_labels, "-labels", ".tif" if options.records.tiling is None else ".vrt"),
            path(options.records.views, "-views", ".tif"),
            path(options.records.displacement is not None, "-displacement", ".tif"),
            path(options.uncertainty.accuracy, "-accuracy", ".tif"),
            path(options.records.vectors, "", ".gpkg"),
            path(options.writes_item and not (grid is not None and grid.crs.is_engineering), "", ".stac.json"),
            options.records.tiling is not None,
        )

    # Folder beside the tiles of what a run keeps for another one.
    STATE = ".geomosaic"

    @property
    def state(self) -> Path:
        """Folder of what a run keeps for another one: records of the tiles, colours and seams."""
        return self.folder / self.STATE

    @property
    def _mark(self) -> Path:
        """File that is there while a mosaic in tiles is not finished."""
        return self.state / "unfinished"

    @property
    def token(self) -> str:
        """Text by which the run that writes the tiles knows their folder; empty where none is under way."""
        try:
            return self._mark.read_text(encoding="utf-8")
        except OSError:
            return ""

    @contextmanager
    def unfinished(self) -> Iterator[None]:
        """Context in which a mosaic in tiles is marked as unfinished: another run may go on, and replace what it finds.

        Raises
        ------
        OutputError
            The folder of the tiles cannot be made or written.
        """
        write_atomic(self._mark, os.urandom(16).hex())
        try:
            yield
        except BaseException:
            tiles = [path.name for path in self.folder.iterdir()] != [self.STATE]
            if not tiles and not any(self.state.rglob(f"{PARTS}/*.json")):  # there is nothing to go on with
                _remove_folder(self.folder)
            raise
        self._mark.unlink()

    def going_on(self, options: MosaicOptions) -> MosaicOptions:
        """Options of a run that goes on where another was stopped: it may replace what that has written.

        Parameters
        ----------
        options : MosaicOptions
        """
        if not (self.tiled and self.token):
            return options
        return replace(options, render=replace(options.render, overwrite=True))

    def remove_virtual(self) -> None:
        """Remove what would show old and new tiles side by side until the last one is written."""
        for path in (self.mosaic, self.labels, self.index, self.item):
            if path is not None:
                path.unlink(missing_ok=True)

    @property
    def index(self) -> Path:
        """Tile index of a mosaic in tiles, in the form of GDAL's driver GTI."""
        return companion(self.mosaic, "", ".gti.gpkg")

    @property
    def folder(self) -> Path:
        """Folder of the tiles."""
        return companion(self.mosaic, "-tiles", "")

    def tile(self, col: int, row: int) -> MosaicFiles:
        """Files of one tile, counted from the upper left.

        Parameters
        ----------
        col, row : int
        """
        name = f"{self.mosaic.stem}-r{row:03}-c{col:03}"
        label = None if self.labels is None else self.folder / f"{name}-labels.tif"
        item = None if self.item is None else self.folder / f"{name}.stac.json"
        return MosaicFiles(self.folder / f"{name}.tif", label, item=item)

    def rasters(self, grid: Grid, size: TileSize | None) -> dict[Window, MosaicFiles]:
        """Raster files by their place in the grid: those of all of it, or of each tile, row by row.

        Tiles begin at blocks of the whole, as whose windows they are rendered, to the bit: their sides are whole
        blocks, to which a size is rounded.

        Parameters
        ----------
        grid : Grid
        size : TileSize or None

        Warns
        -----
        GeomosaicWarning
            Tiles are larger or smaller than a size in pixels, or than half a block.
        """
        if size is None:
            return {grid.window: self}
        across, down = (
            size.value if size.unit == "px" else size.value / metres
            for metres in np.array(grid.resolution) * metres_per_unit(grid.crs, _middle(grid))
        )
        width, height = (max(1, round(pixels / BLOCK_WIDTH)) * BLOCK_WIDTH for pixels in (across, down))
        if (size.unit == "px" and width != size.value) or min(across, down) < BLOCK_WIDTH / 2:
            warn(f"the tiles have {width} x {height} pixels: their sides are multiples of {BLOCK_WIDTH}")
        return {part: self.tile(part.col // width, part.row // height) for part in grid.window.split(width, height)}

    @property
    def companions(self) -> list[Path]:
        """All files but the mosaic itself."""
        index = self.index if self.tiled else None
        paths = (self.labels, self.views, self.displacement, self.accuracy, self.vectors, self.item, index)
        return [path for path in paths if path is not None]

    def check_name(self, options: MosaicOptions, inputs: Iterable[Path] = ()) -> None:
        """Refuse a name of the mosaic that is taken, or promises another format.

        Parameters
        ----------
        options : MosaicOptions
        inputs : iterable of Path
            Files that are read.

        Raises
        ------
        OutputExistsError, InputError
        """
        if self.tiled and self.mosaic.suffix.lower() != ".vrt":
            raise InputError(
                "a mosaic in tiles is a virtual raster over them",
                where=str(self.mosaic),
                hint=f"call it {self.mosaic.stem}.vrt",
            )
        check_output(self.mosaic, overwrite=options.render.overwrite, inputs=inputs, geotiff=not self.tiled)
        if not (self.tiled and self.folder.exists()):
            return
        if not self.folder.is_dir():
            raise InputError(
                "the folder of the tiles is a file", where=str(self.folder), hint="move it away, or give another name"
            )
        if not options.render.overwrite and any(self.folder.iterdir()):
            raise OutputExistsError(
                "the folder of the tiles is not empty", where=str(self.folder), hint="give another name, or `overwrite`"
            )

    def check(self, block: OrientedBlock, grid: Grid, options: MosaicOptions) -> None:
        """Refuse names that are taken or cannot be written, and sizes: before an hour's work, not after it.

        Parameters
        ----------
        block : OrientedBlock
        grid : Grid
        options : MosaicOptions

        Raises
        ------
        OutputExistsError, OutputError
        InputError
            The rasters are larger than `options.render.max_output` or the disk.
        """
        self.check_name(options)
        for path in self.companions:
            check_output(path, overwrite=options.render.overwrite)
        first = block.scenes[0]
        pixel = inspect(first.path, first.bands).pixel_bytes
        pixel += 0 if self.labels is None else np.dtype(label_type(len(block.scenes))).itemsize
        # Two and three bands of 32 bits.
        pixel += 8 * (self.views is not None) + 12 * (self.displacement is not None)
        if self.accuracy is not None:  # three such bands of larger cells
            pixel += -(-12 // options.uncertainty.accuracy_step**2)
        check_output_size(self.mosaic, grid, pixel, options.render.max_output)


def _remove_folder(folder: Path) -> None:
    """Remove a folder of a disk or a store with all that is in it."""
    for path in folder.iterdir():
        if path.is_dir():
            _remove_folder(path)
        else:
            path.unlink()
    if not isinstance(folder, StorePath):
        folder.rmdir()


def _middle(grid: Grid) -> FloatArray:
    place: FloatArray = grid.xy(np.array([[grid.width / 2, grid.height / 2]]))[0]
    return place


def label_type(images: int) -> str:
    """Sample type of a label raster: the smallest that holds all its labels.

    Parameters
    ----------
    images : int
        They are labelled from 1; the label after the last one is that of ground hidden from all images.

    Returns
    -------
    str
        'uint8', 'uint16' or 'int32'.
    """
    return "uint8" if images < 255 else "uint16" if images < 65535 else "int32"


@dataclass(frozen=True)
class MosaicUnit:
    """Unit of work: pixels of one or more adjoining blocks, filled block by block.

    Attributes
    ----------
    window : Window
    values : array (rows, cols, bands)
        Zero where not valid.
    valid : uint8 array (rows, cols)
    label : array (rows, cols)
        Number of the image with the most weight, counted from 1; 0 where none; the number after the last image where
        the surface hides the ground from all images that cover it.
    counts : Counter of int
        Pixels by label, of those labels alone that occur: a unit shows few of thousands of images.
    facts : list of (error, scale)
        Of the lattices used: largest error in pixels, image pixels per output pixel.
    """

    window: Window
    values: AnyArray
    valid: ByteArray
    label: AnyArray
    counts: Counter[int]
    facts: list[tuple[float, float]]

    @classmethod
    def empty(cls, window: Window, bands: int, dtype: str, images: int) -> MosaicUnit:
        """Unit without any valid pixel.

        Parameters
        ----------
        window : Window
        bands : int
        dtype : str
        images : int
            Number of images of the mosaic.
        """
        shape = window.height, window.width
        values, valid = np.zeros((*shape, bands), dtype=dtype), np.zeros(shape, dtype=np.uint8)
        return cls(window, values, valid, np.zeros(shape, dtype=label_type(images)), Counter(), [])

    def count(self, label: AnyArray) -> None:
        """Pixels counted by label, of a part of the unit."""
        found = np.bincount(label.ravel())
        self.counts.update({int(number): int(found[number]) for number in np.flatnonzero(found)})
