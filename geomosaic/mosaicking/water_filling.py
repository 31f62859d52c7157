"""Water in a mosaic: taken from the image with the least glint, or filled with a continuous tone from its shores.

On coarse cells each place of a water body has the values of the image that is darkest there: glint is bright. The
values of the cells along the shore are kept, smoothed over a few cells, and between them lies the harmonic surface that
passes through them: the smoothest there is, and never brighter or darker than the shore.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from geomosaic.digests import digest_of
from geomosaic.execution.units import map_units
from geomosaic.geo.grid import Grid
from geomosaic.mosaicking.colour.balance import ThumbnailOfImage, comparison_grid, thumbnail
from geomosaic.mosaicking.colour.corrections import Correction, corrected
from geomosaic.mosaicking.outputs import MosaicUnit
from geomosaic.mosaicking.seams.voronoi import polygonal
from geomosaic.options.render import RenderOptions
from geomosaic.raster.validity import rasterized
from geomosaic.render.areas import read_areas
from geomosaic.render.photos import Photos
from geomosaic.resample.warp import value_range
from geomosaic.types import BoolArray, FloatArray

LAYER = "water"
# Cells across a footprint on which glint is measured.
CELLS = 256
# Percentile of brightness in a water body by which images are compared: glint is bright, and not everywhere.
GLINT_PERCENTILE = 90.0


def read_water(path: Path, grid: Grid) -> list[Any]:
    """Water bodies in the map of a grid, each a polygon; areas that touch are one body.

    Parameters
    ----------
    path : Path
        Vector file with a layer `water`, or with one layer.
    grid : Grid
        Of the output.

    Returns
    -------
    list of Polygon

    Raises
    ------
    InputError
        No such layer, no CRS, a geometry that is no area, an area that crosses itself.
    """
    import shapely

    joined = shapely.union_all(np.array(read_areas(path, grid, LAYER), dtype=object))
    return [part for part in getattr(joined, "geoms", [joined]) if part.area > 0]


def least_glint(
    photos: Photos, water: Sequence[Any], outlines: Sequence[Any], colours: Sequence[Correction], options: RenderOptions
) -> dict[int, Any]:
    """Seam polygons in water: each body from the image with the least glint that shows it, the rest from the next.

    An image's glint is the 90th percentile of its corrected brightness (mean over bands) in the body. An image that
    shows less than half of what another shows of a body comes after all those that show more.

    Parameters
    ----------
    photos : Photos
    water : sequence of Polygon
        In the output map.
    outlines : sequence of Polygon or MultiPolygon
        What each image shows.
    colours : sequence of Correction
    options : RenderOptions
        Threads.

    Returns
    -------
    dict of int to Polygon or MultiPolygon
        By number of the image.
    """
    import shapely

    met: dict[int, list[int]] = {}
    polygons = np.array(list(water), dtype=object)  # of objects where there are none, too
    for body, i in shapely.STRtree(list(outlines)).query(polygons, predicate="intersects").T.tolist():
        met.setdefault(i, []).append(body)
    glints = partial(_glints, ThumbnailOfImage(photos, comparison_grid(photos, CELLS)), tuple(water), tuple(colours))
    seen: list[list[tuple[float, float, int]]] = [[] for _ in water]
    for (i, bodies), found in map_units(glints, sorted(met.items()), options, ahead=1):
        for body, glint in zip(bodies, found, strict=True):
            seen[body].append((shapely.intersection(water[body], outlines[i]).area, glint, i))
    shares: dict[int, list[Any]] = {}
    for piece, ranked in zip(water, seen, strict=True):
        # An image that shows a corner of the body may be dark there by chance.
        most = max((shown for shown, _, _ in ranked), default=0.0)
        ranked.sort(key=lambda entry: (entry[0] < most / 2, entry[1], entry[2]))
        left = piece
        for _, _, i in ranked:
            own = polygonal(shapely.intersection(left, outlines[i]))
            if not own.is_empty:
                shares.setdefault(i, []).append(own)
                left = polygonal(shapely.difference(left, outlines[i]))
    return {i: shapely.union_all(np.array(parts, dtype=object)) for i, parts in shares.items()}


def _glints(
    thumbnails: ThumbnailOfImage, water: Sequence[Any], colours: Sequence[Correction], met: tuple[int, Sequence[int]]
) -> list[float]:
    """Glint of an image in each of the water bodies that it meets; infinite where it shows no cell of one."""
    (index, bodies), grid = met, thumbnails.grid
    seen = thumbnails(index)
    if seen.window.empty:
        return [np.inf] * len(bodies)
    bright = corrected(colours[index], seen.values, seen.window, grid, thumbnails.photos.grid).mean(axis=2)
    part, found = grid.crop(seen.window), []
    for body in bodies:
        here = (rasterized([(water[body], 1)], part) == 1) & (seen.valid > 0)
        found.append(float(np.percentile(bright[here], GLINT_PERCENTILE)) if here.any() else np.inf)
    return found


# Standard deviation in cells of the Gaussian that smooths the tone of the shore.
SMOOTHING = 2.0


@dataclass(frozen=True)
class WaterBody:
    """Water body with the tone that fills it.

    Attributes
    ----------
    shape : Polygon
        In the output map.
    grid : Grid
        Coarse grid around it.
    tone : array (rows, cols, bands)
        Corrected values at the cells of the grid.
    """

    shape: Any
    grid: Grid
    tone: FloatArray

    def paint(self, unit: MosaicUnit, grid: Grid) -> None:
        """Tone put into the valid pixels of a unit of the output that lie in the water, in place."""
        from scipy.ndimage import map_coordinates

        window = unit.window.intersection(grid.window_of(self.shape.bounds))
        if window.empty:
            return
        place = window.slices_in(unit.window)
        here = (rasterized([(self.shape, 1)], grid.crop(window)) == 1) & (unit.valid[place] > 0)
        if not here.any():
            return
        r, c = np.nonzero(here)
        at = self.grid.colrow(grid.xy(np.column_stack([c + window.col + 0.5, r + window.row + 0.5]))) - 0.5
        low, high, whole = value_range(str(unit.values.dtype))
        for band in range(self.tone.shape[2]):
            tone = map_coordinates(self.tone[..., band], [at[:, 1], at[:, 0]], order=1, mode="nearest")
            stored = np.clip(np.floor(tone + 0.5), low, high) if whole else tone
            unit.values[place][..., band][here] = stored


def water_bodies(
    photos: Photos, water: Sequence[Any], outlines: Sequence[Any], colours: Sequence[Correction], options: RenderOptions
) -> list[WaterBody]:
    """Water bodies with their tones; bodies that no image shows are left out.

    Parameters
    ----------
    photos : Photos
    water : sequence of Polygon
        In the output map.
    outlines : sequence of Polygon or MultiPolygon
        What each image shows.
    colours : sequence of Correction
    options : RenderOptions
        Threads.

    Returns
    -------
    list of WaterBody
    """
    import shapely

    met: list[list[int]] = [[] for _ in water]
    polygons = np.array(list(water), dtype=object)  # of objects where there are none, too
    for body, i in shapely.STRtree(list(outlines)).query(polygons, predicate="intersects").T.tolist():
        met[body].append(i)
    toned = partial(_toned, photos, comparison_grid(photos, CELLS), tuple(colours))
    items = [(piece, sorted(images)) for piece, images in zip(water, met, strict=True)]
    return [body for _, body in map_units(toned, items, options, ahead=1) if body is not None]


def _toned(
    photos: Photos, coarse: Grid, colours: Sequence[Correction], shown: tuple[Any, Sequence[int]]
) -> WaterBody | None:
    """Water body with the tone of its shores, from the images that meet it."""
    piece, images = shown
    window = coarse.window_of(piece.buffer(coarse.resolution[0]).bounds)
    if window.empty:
        return None
    darkest: FloatArray = np.full((window.height, window.width, photos.info.bands), np.inf)
    for i in images:
        with photos.using(i) as photo:
            seen = thumbnail(photo, photos.surface, coarse, window, "average", "float32")
        values = corrected(colours[i], seen.values, window, coarse, photos.grid)
        darker = (seen.valid > 0) & (values.mean(axis=2) < darkest.mean(axis=2))
        darkest[darker] = values[darker]
    known = np.isfinite(darkest[..., 0])
    grid = coarse.crop(window)
    inside = rasterized([(piece, 1)], grid) == 1
    return WaterBody(piece, grid, _harmonic_tone(darkest, inside & known)) if (inside & known).any() else None


def _harmonic_tone(values: FloatArray, inside: BoolArray) -> FloatArray:
    """Tone (rows, cols, bands) of the cells of a water body: harmonic between its outermost cells, constant beyond."""
    from scipy.ndimage import binary_erosion, distance_transform_edt, gaussian_filter
    from scipy.sparse import csr_array
    from scipy.sparse.linalg import splu

    inner = binary_erosion(inside)
    shore = inside & ~inner
    weight = gaussian_filter(shore.astype(float), SMOOTHING)
    tone = np.zeros(values.shape)
    for band in range(values.shape[2]):
        # Normalised convolution: only cells of the shore count, whatever lies beside them.
        even = gaussian_filter(np.where(shore, values[..., band], 0.0), SMOOTHING)
        tone[shore, band] = (even / np.maximum(weight, 1e-12))[shore]
    number = np.full(inside.shape, -1)
    number[inner] = np.arange(int(inner.sum()))
    if inner.any():
        r, c = np.nonzero(inner)
        around = [(r - 1, c), (r + 1, c), (r, c - 1), (r, c + 1)]
        # Discrete Laplace equation: four times a cell minus its neighbours is 0, with the shore as boundary values.
        right, links = np.zeros((len(r), values.shape[2])), [(number[r, c], number[r, c], np.full(len(r), 4.0))]
        for place in around:
            free = number[place] >= 0
            links.append((number[r, c][free], number[place][free], np.full(int(free.sum()), -1.0)))
            right += np.where(free[:, None], 0.0, tone[place])
        row, col, factor = (np.concatenate(part) for part in zip(*links, strict=True))
        tone[inner] = splu(csr_array((factor, (row, col))).tocsc()).solve(right)
    nearest = distance_transform_edt(~inside, return_distances=False, return_indices=True)
    return np.asarray(tone[tuple(nearest)])


def fingerprint(found: Sequence[WaterBody]) -> str:
    """Digest of the water that pixels depend on.

    Parameters
    ----------
    found : sequence of WaterBody

    Returns
    -------
    str
        Empty without water.
    """
    return digest_of(*(part for pool in found for part in (pool.shape.wkb, pool.tone))) if found else ""
