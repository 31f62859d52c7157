"""Provenance of pixels: facts of each source image, acquisition times, and relief displacement.

For a vertical photo that is the textbooks' d = r · h / H: r the distance of the image from the nadir point, h the
height above level ground, H the flying height above it. For a scanner it lies across the flight alone. Both, and
every other sensor's, are the difference of one map: image(x, y, z) − image(x, y, level).
"""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from geomosaic.digests import sha256
from geomosaic.geo.grid import Grid, Window
from geomosaic.geo.units import metres_per_unit
from geomosaic.options.render import RenderOptions
from geomosaic.raster.cog.codec import RasterMetadata, Samples
from geomosaic.raster.cog.tiles import WindowTiler, WindowTiles
from geomosaic.raster.image_metadata import acquisition_time
from geomosaic.raster.sink import RasterSink
from geomosaic.raster.source import Source
from geomosaic.render.photo import Photo
from geomosaic.render.photos import Photos
from geomosaic.render.regions import map_by_regions, map_images
from geomosaic.sensor.map_to_image import Views, views
from geomosaic.types import FloatArray

if TYPE_CHECKING:
    from geomosaic.mosaicking.reruns import Reuse


BANDS = ("view angle, degrees", "ground sampling distance, metres")
# Side in pixels of a unit of work: a tile of the raster.
TILE = 512
# Nodes of the view geometry along each side of a unit: every 16 pixels.
NODES = 33


def source_facts(
    photos: Photos, further: Mapping[str, Mapping[str, Any]], options: RenderOptions
) -> dict[str, list[Any]]:
    """Facts of each source image as columns: acquisition time, view direction, resolution, checksum, further facts.

    View angle, azimuth and ground sampling distance are those at the place that an image sees best.

    Parameters
    ----------
    photos : Photos
    further : mapping of str to mapping
        Further facts by name of the image.
    options : RenderOptions
        Threads.

    Returns
    -------
    dict of str to list
        `acquired` (ISO 8601), `view_angle` and `view_azimuth` (degrees), `gsd_metres`, `sha256`, and those given.
    """
    rows: list[dict[str, Any]] = []
    given = [further.get(scene.name, {}) for scene in photos.scenes]
    summed = frozenset(index for index, facts in enumerate(given) if "sha256" in facts)
    for index, (facts, checksum) in map_images(lambda some: partial(_facts_of_image, some, summed), photos, options):
        rows.append({**facts, **given[index], **({} if checksum is None else {"sha256": checksum})})
    names = dict.fromkeys(name for row in rows for name in row)
    return {name: [_without_none(row.get(name), [other.get(name) for other in rows]) for row in rows] for name in names}


def _facts_of_image(photos: Photos, summed: Collection[int], index: int) -> tuple[dict[str, Any], str | None]:
    """Acquisition and view of an image, and its checksum, where it is a file of this machine and that is not known."""
    scene = photos.scenes[index]
    with photos.using(index) as photo:
        geometry = _view_geometry(photo, photos, photos.grid, np.array([photos.outlines[index].centre]))
    facts = {
        "acquired": scene.acquired or acquisition_time(scene.path) or "",
        "view_angle": float(geometry.angle[0]),
        "view_azimuth": float(geometry.azimuth[0]),
        "gsd_metres": float(geometry.sampling[0]),
    }
    path = Path(scene.path)
    return facts, sha256(path) if index not in summed and path.is_file() else None


def _without_none(value: Any, others: Sequence[Any]) -> Any:
    """Value of a column; in place of None, NaN among numbers, else an empty text."""
    if value is not None:
        return value
    return "" if any(isinstance(other, str) for other in others) else float("nan")


def _view_geometry(photo: Photo, photos: Photos, grid: Grid, xy: FloatArray) -> Views:
    """View geometry of an image at places (N, 2) of the output map: angle and azimuth, degrees, sampling, metres."""
    surface = photos.surface
    z = np.zeros(len(xy)) if surface is None else surface.height(photo.mapper.surface_xy(xy))
    # Where there is no height the median is near enough: view angles change slowly with it.
    z = np.where(np.isfinite(z), z, np.nanmedian(z)) if np.isfinite(z).any() else np.zeros(len(xy))
    metres = metres_per_unit(grid.crs, xy.mean(axis=0))
    return views(photo.mapper, xy, z, metres, float(photos.grid.resolution[0] * metres[0]))


def write_views(path: Path, labels: Path, photos: Photos, options: RenderOptions, reuse: Reuse | None = None) -> None:
    """Raster of view angle and ground sampling distance in each pixel's main source; NaN where there is none.

    Parameters
    ----------
    path : Path
        Two bands of float32.
    labels : Path
        Raster of source images.
    photos : Photos
    options : RenderOptions
    reuse : Reuse, optional
        Says which units of the mosaic are unchanged; so are their views.
    """
    units = photos.grid.window.split(TILE, TILE)
    with Source(str(labels)) as source, _sink(path, BANDS, photos.grid, options) as sink:
        same = reuse is not None and reuse.views and sink.reuse_tiles_of(path)
        kept = {part for unit in reuse.taken for part in unit.split(TILE, TILE)} if same and reuse else set()
        work = _LabelledUnits(photos, source, sink.tiler, len(BANDS), _views_in)
        made = work.over([unit for unit in units if unit not in kept], options)
        for done, unit in enumerate(units):
            if unit in kept:
                sink.keep(unit)
            else:
                sink.add(next(made)[1])
            options.report(done + 1, len(units), "views")
        sink.finish()


def _sink(path: Path, bands: tuple[str, ...], grid: Grid, options: RenderOptions) -> RasterSink:
    return RasterSink(
        path, grid, Samples(len(bands), "float32", nodata=float("nan")), driver=options.driver,
        overwrite=options.overwrite, threads=options.threads, metadata=RasterMetadata(bands),
    )  # fmt: skip


# Values (rows, cols, bands) of a photo in a window of the output.
_ValuesOf = Callable[[Photos, Window], Callable[[Photo], FloatArray]]


@dataclass(frozen=True, eq=False)
class _LabelledUnits:
    """Values of each pixel's main source in the units of a raster, to its tiles; for any thread or process."""

    photos: Photos
    labels: Source
    tiler: WindowTiler
    bands: int
    values: _ValuesOf

    def over(self, units: Sequence[Window], options: RenderOptions) -> Iterator[tuple[Window, WindowTiles]]:
        """Tiles of units, computed wherever the options say."""
        photos = self.photos
        return map_by_regions(
            lambda near: replace(self, photos=photos.only(near)), units, photos.near, len(photos), options
        )

    def __call__(self, window: Window) -> WindowTiles:
        label = self.labels.read(window)[0][..., 0]
        found = np.full((*label.shape, self.bands), np.nan, dtype=np.float32)
        of_photo = self.values(self.photos, window)
        for number in np.unique(label[(label > 0) & (label <= len(self.photos))]).tolist():
            here = label == number
            with self.photos.using(number - 1) as photo:
                found[here] = of_photo(photo)[here]
        return self.tiler.tiles(window, found, np.isfinite(found[..., 0]).view(np.uint8))


def _views_in(photos: Photos, window: Window) -> Callable[[Photo], FloatArray]:
    return lambda photo: view_raster(photo, photos, photos.grid, window, NODES)


def view_raster(photo: Photo, photos: Photos, grid: Grid, window: Window, nodes: int) -> FloatArray:
    """View angle and ground sampling distance of one image over a window of a grid.

    Parameters
    ----------
    photo : Photo
    photos : Photos
    grid : Grid
    window : Window
        Of the grid.
    nodes : int
        Along each side of the window.

    Returns
    -------
    array (rows, cols, 2)
        Degrees and metres.
    """
    # Computed at nodes. Between them the slopes of the line of sight change nearly linearly, the angle does not: at the
    # nadir it has a cusp. So the slopes are interpolated.
    from scipy.ndimage import map_coordinates

    cols, rows = (np.linspace(0, size, nodes) for size in (window.width, window.height))
    c, r = np.meshgrid(window.col + cols, window.row + rows)
    geometry = _view_geometry(photo, photos, grid, grid.xy(np.column_stack([c.ravel(), r.ravel()])))
    slope, azimuth = np.tan(np.radians(geometry.angle)), np.radians(geometry.azimuth)
    layers = slope * np.sin(azimuth), slope * np.cos(azimuth), geometry.sampling
    at = [(np.arange(size) + 0.5) / size * (nodes - 1) for size in (window.height, window.width)]
    places = np.meshgrid(*at, indexing="ij")
    east, north, sampling = (
        map_coordinates(layer.reshape(nodes, nodes), places, order=1, mode="nearest") for layer in layers
    )
    return np.stack([np.degrees(np.arctan(np.hypot(east, north))), sampling], axis=-1)


# Year of the first photograph: the start of a span that nothing else limits.
FIRST_PHOTOGRAPH = datetime(1826, 1, 1, tzinfo=UTC)
# Largest offsets of time zones from UTC, to the west and to the east.
MAX_BEHIND_UTC, MAX_AHEAD_UTC = timedelta(hours=12), timedelta(hours=14)


def time_span(acquisition_time: Sequence[str], images: Sequence[Path]) -> tuple[datetime, datetime, str]:
    """Time span in which images can have been taken, and how it is known.

    The time of a file is not that of acquisition. It only ends the span where an image does not say when it was taken:
    that was before its file was written.

    Parameters
    ----------
    acquisition_time : sequence of str
        By image in ISO 8601, with or without zone; empty where not known.
    images : sequence of Path
        The files. SOURCE_DATE_EPOCH takes the place of their times.

    Returns
    -------
    first, last : datetime
        UTC.
    known : str
        "taken"; "taken, zone unknown", with the span of every zone; or "not known", from before the first photograph.
    """
    times = [datetime.fromisoformat(text) for text in acquisition_time if text]
    # A local time without zone was earliest in UTC if taken in the zone farthest ahead, latest in that farthest behind.
    first = [time if time.tzinfo else time.replace(tzinfo=UTC) - MAX_AHEAD_UTC for time in times]
    last = [time if time.tzinfo else time.replace(tzinfo=UTC) + MAX_BEHIND_UTC for time in times]
    # A day without a time lasts to its end.
    days = [len(text) == len("1985-07-12") for text in acquisition_time if text]
    last = [time + timedelta(days=1) if day else time for time, day in zip(last, days, strict=True)]
    if not times or len(times) < len(images):
        return (
            min([FIRST_PHOTOGRAPH, *first]).astimezone(UTC),
            max([_newest_file(images), *last]).astimezone(UTC),
            "not known",
        )
    known = "taken" if all(time.tzinfo for time in times) else "taken, zone unknown"
    return min(first).astimezone(UTC), max(last).astimezone(UTC), known


def _newest_file(images: Sequence[Path]) -> datetime:
    """Time of the newest file, in whole seconds."""
    # Set where equal runs must make equal bytes (reproducible-builds.org): times of copied files differ.
    epoch = os.environ.get("SOURCE_DATE_EPOCH")
    return datetime.fromtimestamp(int(epoch) if epoch else max(int(image.stat().st_mtime) for image in images), UTC)


DISPLACEMENT_BANDS = ("columns, pixels of the image", "rows, pixels of the image", "on level ground, metres")
# Chebyshev nodes of four heights, and the matrix from values there to the coefficients of a cubic.
_LEVELS = np.cos((2 * np.arange(4) + 1) * np.pi / 8)
_TO_CUBIC = np.linalg.inv(np.vander(_LEVELS, 4, increasing=True))


def write_displacement(path: Path, labels: Path, photos: Photos, level: float, options: RenderOptions) -> None:
    """Raster of the relief displacement of each pixel in its main source; NaN without source or height.

    Parameters
    ----------
    path : Path
        Three bands of float32: columns and rows in pixels of the source, and metres on level ground.
    labels : Path
        Raster of source images.
    photos : Photos
    level : float
        Height of level ground, metres in the surface's datum.
    options : RenderOptions
    """
    units = photos.grid.window.split(TILE, TILE)
    with Source(str(labels)) as source, _sink(path, DISPLACEMENT_BANDS, photos.grid, options) as sink:
        values = partial(_displacement_in, level)
        work = _LabelledUnits(photos, source, sink.tiler, len(DISPLACEMENT_BANDS), values)
        for done, (_, made) in enumerate(work.over(units, options)):
            sink.add(made)
            options.report(done + 1, len(units), "displacement")
        sink.finish()


def _displacement_in(level: float, photos: Photos, window: Window) -> Callable[[Photo], FloatArray]:
    z = _heights(photos, photos.grid, window)
    return lambda photo: displacement(photo, photos, photos.grid, window, z, level)


def displacement(
    photo: Photo, photos: Photos, grid: Grid, window: Window, z: FloatArray, level: float, nodes: int = NODES
) -> FloatArray:
    """Relief displacement of one image over a window of a grid.

    Parameters
    ----------
    photo : Photo
    photos : Photos
    grid : Grid
    window : Window
        Of the grid.
    z : array (rows, cols)
        Metres in the surface's datum; NaN where unknown.
    level : float
        Height of level ground, metres in the same datum.
    nodes : int
        Along each side of the window.

    Returns
    -------
    array (rows, cols, 3)
        Columns and rows in pixels of the image, and metres on level ground; 0 for a model without heights.
    """
    # At nodes the image position is a cubic in height, and between them its coefficients are interpolated. On the
    # ground it is the length of the line of sight between both heights in plan, |z − level| · tan(view angle).
    from scipy.ndimage import map_coordinates

    known = z[np.isfinite(z)]
    shape = window.height, window.width
    if not photo.mapper.uses_heights or not known.size:
        return np.zeros((*shape, 3)) if not photo.mapper.uses_heights else np.full((*shape, 3), np.nan)
    # The cubic must hold at both heights that are subtracted, so its range takes in the level as well.
    low, high = min(float(known.min()), level), max(float(known.max()), level)
    middle, half = (low + high) / 2, max((high - low) / 2, 1.0)
    cols, rows = (np.linspace(0, size, nodes) for size in (window.width, window.height))
    c, r = np.meshgrid(window.col + cols, window.row + rows)
    xy = photo.mapper.surface_xy(grid.xy(np.column_stack([c.ravel(), r.ravel()])))
    heights = np.repeat(middle + half * _LEVELS, len(xy))
    image = photo.mapper.image(np.concatenate([xy] * 4), heights).reshape(4, nodes, nodes, 2)
    cubic = np.einsum("pl,lrca->parc", _TO_CUBIC, image)
    places = np.meshgrid(*((np.arange(size) + 0.5) / size * (nodes - 1) for size in shape), indexing="ij")
    t, zero = (z - middle) / half, (level - middle) / half
    found = np.zeros((*shape, 3))
    for power in (1, 2, 3):
        change = t**power - zero**power
        for axis in (0, 1):
            found[..., axis] += change * map_coordinates(cubic[power, axis], places, order=1, mode="nearest")
    angle = view_raster(photo, photos, grid, window, nodes)[..., 0]
    found[..., 2] = np.abs(z - level) * np.tan(np.radians(angle))
    return found


def _heights(photos: Photos, grid: Grid, window: Window) -> FloatArray:
    """Heights (rows, cols) under a window of the output; 0 where there is no surface."""
    surface = photos.surface
    shape = window.height, window.width
    if surface is None:
        return np.zeros(shape)
    c, r = np.meshgrid(window.col + np.arange(shape[1]) + 0.5, window.row + np.arange(shape[0]) + 0.5)
    with photos.using(0) as photo:  # all images transform to the surface's map alike
        xy = photo.mapper.surface_xy(grid.xy(np.column_stack([c.ravel(), r.ravel()])))
    return surface.height(xy).reshape(shape)
