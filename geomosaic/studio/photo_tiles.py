"""Single images as tiles of the map: rectified as in the mosaic, for comparison before a seam is moved."""

from __future__ import annotations

import threading
from collections import OrderedDict
from typing import Any

import numpy as np

from geomosaic.block import footprint
from geomosaic.errors import InputError
from geomosaic.geo.crs import horizontal
from geomosaic.geo.grid import Grid, Window
from geomosaic.jobs.manifest import Layout, read_json
from geomosaic.jobs.steps.orient import restore_block
from geomosaic.mosaicking.colour.corrections import retouched
from geomosaic.project.load import Project
from geomosaic.raster.display import eight_bits
from geomosaic.raster.environment import environment
from geomosaic.raster.info import inspect
from geomosaic.render.photo import Photo, Rectifier
from geomosaic.resample.warp import Colour, Target
from geomosaic.sensor.map_to_image import Ground
from geomosaic.studio.raster_tiles import SIZE, level_count, webp
from geomosaic.studio.workspace import Workspace, version_of

# Images that are open at once, each at one level, and bytes of heights and of an image that are held.
_OPEN, _HEIGHTS, _HELD = 16, 64 << 20, 64 << 20
# Image pixels by which the geometry may be off: for the eye alone.
_TOLERANCE = 0.25


class PhotoTiles:
    """Tiles of single images in the pyramid of the mosaic; safe to use from any number of threads."""

    def __init__(self, workspace: Workspace) -> None:
        self._workspace = workspace
        self._lock = threading.Lock()
        self._open: OrderedDict[tuple[Any, ...], tuple[Photo, Ground]] = OrderedDict()
        self._block: tuple[object, Any] = (None, None)

    def tile(self, image: str, z: int, x: int, y: int) -> bytes:
        """Tile as WebP, in the gain and offset that the image has in the mosaic; transparent where it shows nothing.

        Parameters
        ----------
        image : str
            Layer of the image.
        z, x, y : int
            Level, column and row in the pyramid of the mosaic.

        Raises
        ------
        InputError
            No such image or tile, or no mosaic.
        """
        project = self._workspace.project()
        path = self._workspace.raster(image)
        if project is None or path is None or path not in project.images or not Layout(project).mosaic.is_file():
            raise InputError("there is no such image, or no mosaic", where=image, hint="load the page again")
        layout = Layout(project)
        info = inspect(layout.mosaic)
        levels = level_count(info.width, info.height)
        if info.crs is None or info.transform is None or not 0 <= z < levels:
            raise InputError(f"there is no level {z}", where=image, hint="load the page again")
        grid = Grid(horizontal(info.crs), info.transform, info.width, info.height).coarser(1 << (levels - 1 - z))
        window = Window(x * SIZE, y * SIZE, SIZE, SIZE).intersection(grid.window)
        if window.empty or x < 0 or y < 0:
            raise InputError(f"there is no tile {z}/{x}/{y}", where=image, hint="load the page again")
        facts = read_json(layout.facts("mosaic"))
        with environment():
            photo, ground = self._photo(project, path.name, grid, z)
            bands = photo.source.info.bands
            shape = window.height, window.width
            target = Target(np.zeros((*shape, bands), np.float32), np.zeros(shape, np.uint8))
            if photo.touches(grid.crop(window).bounds):
                rectifier = Rectifier(grid, "bilinear", _TOLERANCE)
                rectifier.fill(photo, ground.block(window), _colour(project, facts, path.name, bands), target)
        shown = target.values[..., : 3 if bands >= 3 else 1]
        return webp(eight_bits(shown, self._limits(layout, facts)), target.valid)

    def _limits(self, layout: Layout, facts: Any) -> tuple[float, float] | None:
        """Values of black and white: those of the mosaic."""
        stretch = facts.get("stretch")
        if stretch is not None:
            return stretch["low"], stretch["high"]
        mosaic = next((one.id for one in self._workspace.layers() if one.path == layout.mosaic), "")
        limits = self._workspace.tiles.facts(mosaic)["stretch"]
        return None if limits is None else tuple(limits)

    def _photo(self, project: Project, name: str, grid: Grid, level: int) -> tuple[Photo, Ground]:
        """Open image with the ground below the map, as they are now."""
        layout = Layout(project)
        stamp = (version_of(layout.facts("orient")), version_of(project.path))
        key = (stamp, name, grid, level)
        with self._lock:
            if self._block[0] != stamp:
                self._block = stamp, restore_block(project, _HEIGHTS)
            found = self._open.pop(key, None)
            if found is None:
                block = self._block[1]
                scene = next((one for one in block.scenes if one.name == name), None)
                if scene is None:
                    raise InputError("the image was set aside", where=name, hint="choose another one")
                outline = footprint(scene, block.surface, grid.crs)
                photo = Photo.open(scene, block.surface, grid, outline, _HELD)
                found = photo, Ground.under(grid, block.surface)
            self._open[key] = found
            closing = [self._open.popitem(last=False)[1] for _ in range(len(self._open) - _OPEN)]
        for photo, _ in closing:  # a thread may still read from it
            threading.Timer(5.0, photo.source.close).start()
        return found


def _colour(project: Project, facts: Any, name: str, bands: int) -> Colour:
    """Gain and offset of an image, those of the balance and the one that is set by hand."""
    own = next((one for one in facts["images"] if one["name"] == name), {"gain": 1.0, "offset": 0.0})
    gain, offset = (np.broadcast_to(np.asarray(own[part], dtype=np.float64), bands) for part in ("gain", "offset"))
    (colour,) = retouched(
        [Colour(gain, offset)],
        [name],
        {image: change for image, change in project.options.colours.retouch.items() if image == name},
    )
    assert isinstance(colour, Colour)
    return colour
