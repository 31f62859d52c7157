"""An image made ready to be pulled into an output grid, block by block."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geomosaic.block.footprint import Footprint
from geomosaic.block.scene import Scene
from geomosaic.errors import InputError
from geomosaic.geo.crs import horizontal
from geomosaic.geo.grid import Bounds, Grid, Window
from geomosaic.geo.transform import Transform
from geomosaic.raster.source import Source
from geomosaic.resample.warp import Colour, Engine, warp
from geomosaic.sensor.lattice import Lattice, build
from geomosaic.sensor.mapper import MapToImage
from geomosaic.surface.model import HeightPatch, Surface
from geomosaic.types import AnyArray, ByteArray


@dataclass(frozen=True)
class Photo:
    """A scene with its open image, its way from the map to the image, and its footprint."""

    scene: Scene
    source: Source
    mapper: MapToImage
    footprint: Footprint

    @classmethod
    def open(
        cls, scene: Scene, surface: Surface | None, grid: Grid, footprint: Footprint, memory: int, threads: int = 1
    ) -> Photo:
        """Open the image and check that it is the one the model was made for."""
        source = Source(scene.path, nodata=scene.nodata, bands=scene.bands, memory_limit=memory)
        info = source.info
        if (info.width, info.height) != tuple(scene.model.size):
            raise InputError(
                f"the image has {info.width} x {info.height} pixels, its model {scene.model.size[0]} x "
                f"{scene.model.size[1]}",
                where=scene.path,
                mend="give the camera and orientation that belong to this image",
            )
        crs = None if surface is None else surface.crs
        return cls(scene, source, MapToImage.between(grid.crs, crs, scene.model), footprint)

    def touches(self, bounds: Bounds) -> bool:
        """Whether the footprint's bounds meet these."""
        a, b = self.footprint.bounds, bounds
        return a[0] <= b[2] and b[0] <= a[2] and a[1] <= b[3] and b[1] <= a[3]


@dataclass(frozen=True)
class BlockGround:
    """Heights over one block of output pixels."""

    window: Window
    patch: HeightPatch | None
    heights: tuple[float, float]

    @property
    def unknown(self) -> bool:
        """Whether no height is known here."""
        return bool(np.isnan(self.heights[0]))


def block_ground(surface: Surface | None, grid: Grid, window: Window) -> BlockGround:
    """Read the heights of one block."""
    if surface is None:
        return BlockGround(window, None, (0.0, 0.0))
    cols = np.linspace(window.col, window.stop_col, 5)
    rows = np.linspace(window.row, window.stop_row, 5)
    c, r = np.meshgrid(cols, rows)
    xy = Transform(horizontal(grid.crs), horizontal(surface.crs))(grid.xy(np.column_stack([c.ravel(), r.ravel()])))
    xy = xy[np.isfinite(xy).all(axis=1)]
    if not len(xy):
        return BlockGround(window, None, (float("nan"), float("nan")))
    (left, bottom), (right, top) = xy.min(axis=0), xy.max(axis=0)
    margin = 0.01 * max(right - left, top - bottom)
    patch = surface.patch((left - margin, bottom - margin, right + margin, top + margin))
    return BlockGround(window, patch, patch.range)


def pull(
    engine: Engine,
    photo: Photo,
    grid: Grid,
    ground: BlockGround,
    resampling: str,
    tolerance: float,
    colour: Colour,
    out: AnyArray,
    out_valid: ByteArray,
    need: ByteArray | None = None,
    most_samples: int | None = None,
) -> Lattice | None:
    """Fill one block from one photo; None where the photo does not see it."""
    if ground.unknown:
        return None
    lattice = build(photo.mapper, grid, ground.window, ground.heights, tolerance)
    if lattice is None:
        return None
    patch = ground.patch if photo.mapper.uses_heights else None
    size = photo.scene.model.size
    warp(engine, photo.source, size, lattice, patch, resampling, colour, out, out_valid, need, most_samples)
    return lattice
