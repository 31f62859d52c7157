"""Images drawn in memory on grids of one map, in one band: an image through its model beside its reference."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

import numpy as np
from pyproj import CRS

from geomosaic.block import Footprint, OrientedImage, footprint
from geomosaic.errors import InputError
from geomosaic.geo.crs import horizontal
from geomosaic.geo.grid import Grid
from geomosaic.matching.registration import Picture
from geomosaic.raster.info import inspect
from geomosaic.raster.source import Source
from geomosaic.render.photo import Photo, Rectifier, refuse_palette
from geomosaic.resample.warp import Colour, Target
from geomosaic.sensor.lattice import blocks
from geomosaic.sensor.map_to_image import Ground, MapToImage
from geomosaic.sensor.plugin import SensorModel, SensorRequest
from geomosaic.sensor.registry import build, plane_sensor
from geomosaic.surface.model import Surface
from geomosaic.types import FloatArray

# Error of the geometry, pixels of the image: places are measured to some hundredths.
TOLERANCE = 0.02
# Cubic weights shift what has much detail by up to 0.02 px towards whole pixels, Lanczos' by 0.002.
RESAMPLING = "lanczos"
# Bytes of a decoded file of a format without windows that are kept in memory.
HELD = 512 << 20


@dataclass(frozen=True, eq=False)
class Drawer:
    """Open image that is drawn on any grid of one map.

    Attributes
    ----------
    scene : OrientedImage
    surface : Surface or None
        None where the model uses no heights.
    source : Source
    outline : Footprint
        On the map.
    mapper : MapToImage
    """

    scene: OrientedImage
    surface: Surface | None
    source: Source
    outline: Footprint
    mapper: MapToImage

    @classmethod
    def open(cls, scene: OrientedImage, surface: Surface | None, crs: CRS) -> Self:
        """Image opened for drawing on a map (2-D CRS).

        Parameters
        ----------
        scene : OrientedImage
        surface : Surface or None
            None where heights play no part.
        crs : CRS
            Of the map, 2-D.
        """
        source = Source(
            scene.path, nodata=scene.nodata, bands=scene.bands, memory_limit=HELD, usable=scene.usable,
            clouds=scene.clouds,
        )  # fmt: skip
        try:
            refuse_palette(source.info, RESAMPLING)
            return cls(scene, surface, source, footprint(scene, surface, crs), _mapper(scene.model, surface, crs))
        except BaseException:
            source.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.source.close()

    def with_model(self, model: SensorModel, crs: CRS) -> Self:
        """The same file under another model."""
        scene = replace(self.scene, model=model)
        outline, mapper = footprint(scene, self.surface, crs), _mapper(model, self.surface, crs)
        return replace(self, scene=scene, outline=outline, mapper=mapper)

    def draw(self, grid: Grid) -> Picture:
        """Mean of the bands on a grid."""
        photo = Photo(self.scene, self.source, self.mapper, self.outline)
        ground, rectifier = Ground.under(grid, self.surface), Rectifier(grid, RESAMPLING, TOLERANCE)
        bands = len(self.source.bands)
        values = np.zeros((*grid.shape, bands), dtype=np.float32)
        valid = np.zeros(grid.shape, dtype=np.uint8)
        if photo.touches(grid.bounds):
            for block in blocks(grid.window):
                here = block.intersection(grid.window)
                rows, cols = slice(here.row, here.stop_row), slice(here.col, here.stop_col)
                target = Target(values[rows, cols], valid[rows, cols])
                rectifier.fill(photo, ground.block(here), Colour.identity(bands), target)
        return Picture(np.ascontiguousarray(values.mean(axis=2)), valid > 0)

    def ground(self, grid: Grid, colrow: FloatArray) -> FloatArray:
        """Ground (N, 3) under places (N, 2) of a grid, in the CRS of the surface, or of the model without heights."""
        xy = self.mapper.surface_xy(grid.xy(colrow))
        return np.column_stack([xy, np.zeros(len(xy)) if self.surface is None else self.surface.height(xy)])

    def places(self, grid: Grid, colrow: FloatArray) -> FloatArray:
        """Pixels (N, 2) of the file that lie at places (N, 2) of a grid."""
        xyz = self.ground(grid, colrow)
        return self.mapper.image(xyz[:, :2], xyz[:, 2])


def _mapper(model: SensorModel, surface: Surface | None, crs: CRS) -> MapToImage:
    return MapToImage.between(crs, None if surface is None else surface.crs, model)


def georeferenced(path: Path, role: str) -> tuple[OrientedImage, Grid]:
    """Georeferenced raster as an image with its model, and its own grid.

    Parameters
    ----------
    path : Path
    role : str
        What it is, for messages: 'the reference'.

    Raises
    ------
    InputError
        It cannot be read, or has no georeference.
    """
    info = inspect(path)
    if info.crs is None or info.transform is None:
        raise InputError(
            f"{role} is not georeferenced",
            where=str(path),
            hint="give a raster that has a CRS and a place: an ortho, a mosaic, a map saved as GeoTIFF",
        )
    crs = horizontal(info.crs)
    request = SensorRequest(path.name, info.size, {"transform": list(info.transform[:6])}, crs, path=str(path))
    sensor = plane_sensor()
    scene = OrientedImage(path.stem, str(path), sensor, build(sensor, request))
    return scene, Grid(crs, info.transform, *info.size)
