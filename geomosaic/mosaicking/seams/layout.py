"""Layout of seams on a coarse grid: seams of least cost and halved overlaps, whole or by subdomains."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import numpy as np

from geomosaic.errors import InputError
from geomosaic.geo.grid import Grid, Window
from geomosaic.geo.window_index import WindowIndex
from geomosaic.mosaicking.colour.corrections import Correction
from geomosaic.mosaicking.seams.cost import seam_cost
from geomosaic.mosaicking.seams.graph_cut import minimise, region_graph
from geomosaic.mosaicking.seams.partition import (
    MIN_ISLAND,
    extrapolated,
    partition,
    undivided,
    without_islands,
    without_spurs,
)
from geomosaic.mosaicking.seams.seam_layers import SeamLayers
from geomosaic.mosaicking.seams.subdomains import (
    LARGEST,
    OUTSIDE,
    KeptSeams,
    Subdomain,
    SubdomainSeams,
    rims_of,
    seams_in_turns,
)
from geomosaic.mosaicking.seams.voronoi import (
    MAX_CANDIDATES,
    farthest_inside,
    inner_edges,
    nearest_images,
    polygonal,
    voronoi_regions,
)
from geomosaic.options.mosaic import SeamWeights
from geomosaic.options.render import MEGABYTE, PROGRAM, RenderOptions
from geomosaic.raster.validity import polygons_of_labels, rasterized
from geomosaic.render.photos import MemoryBudget, Photos
from geomosaic.render.sparse import SparseSequence
from geomosaic.types import IntArray

# Cells across a median footprint: fine enough for seams around houses, coarse enough for blocks of thousands.
LAYOUT_CELLS = 400
# Simplification of seams, in cells: about the root of the area of the corners that are cut off.
SMOOTHING = 2.0
# Side in cells of the tiles in which candidates are found.
TILE = 256
# Bytes that the layout of a cell takes, as measured.
CELL_BYTES = 140


@dataclass(frozen=True, eq=False)
class SeamMethod(ABC):
    """Method that lays seams: images of cells.

    Attributes
    ----------
    photos : Photos
    outlines : sequence of Polygon or MultiPolygon
        What each image shows, in the output map; empty for images that are left out.
    grid : Grid
        Of the cells, see `seam_grid`.
    """

    photos: Photos
    outlines: Sequence[Any]
    grid: Grid

    @abstractmethod
    def labels(self, part: Subdomain, options: RenderOptions) -> IntArray:
        """Image of each cell (rows, cols) of the window of a subdomain, by number; -1 where there is none."""

    def only(self, near: Collection[int]) -> Self:
        """Method for subdomains at which these images are at hand."""
        return replace(self, photos=self.photos.only(near), outlines=SparseSequence(self.outlines, near))

    def tiles(self, part: Subdomain) -> Iterator[Any]:
        """Tiles of a subdomain: rows and columns, images at hand (K,), cells each shows (K, N), cell centres (N, 2)."""
        images = [i for i in part.images if not self.outlines[i].is_empty]
        windows = WindowIndex([self.grid.window_of(self.photos.outlines[i].bounds) for i in images])
        for tile in part.window.split(TILE, TILE):
            near = [images[k] for k in windows.meeting(tile)]
            if not near:
                continue
            own = self.grid.crop(tile)
            covers = np.stack([rasterized([(self.outlines[i], 1)], own).ravel() == 1 for i in near])
            c, r = np.meshgrid(np.arange(tile.width) + 0.5, np.arange(tile.height) + 0.5)
            xy = own.xy(np.column_stack([c.ravel(), r.ravel()]))
            yield tile.slices_in(part.window), np.array(near), covers, xy


@dataclass(frozen=True, eq=False)
class LeastCostSeams(SeamMethod):
    """Seams of least cost, by graph cuts over image differences, raised objects and given lines and areas.

    Attributes
    ----------
    photos, outlines, grid
        See `SeamMethod`.
    colours : sequence of Correction
        Of all images: they are compared as they will be seen.
    weights : SeamWeights
    layers : SeamLayers
    """

    colours: Sequence[Correction]
    weights: SeamWeights
    layers: SeamLayers

    def only(self, near: Collection[int]) -> Self:
        """Method for subdomains at which these images are at hand."""
        return replace(super().only(near), colours=SparseSequence(self.colours, near))

    def labels(self, part: Subdomain, options: RenderOptions) -> IntArray:
        """Image of each cell (rows, cols) of the window of a subdomain."""
        candidates, decided = self._candidates(part), part.decided
        candidates[:, decided == OUTSIDE] = -1
        cost = seam_cost(
            self.photos, self.grid, part.window, candidates, self.colours, self.weights, self.layers, options
        )
        known = decided > OUTSIDE
        candidates[:, known] = -1
        candidates[0, known] = decided[known]
        regions = region_graph(candidates, cost.unary, cost.pairwise, decided if known.any() else None)
        best = minimise(regions, regions.initial_labels(candidates[0]))
        shown = regions.region >= 0
        return np.where(shown, best[np.where(shown, regions.region, 0)] if len(best) else -1, -1)

    def _candidates(self, part: Subdomain) -> IntArray:
        """Candidate images (ranks, rows, cols) of each cell, the nearest first."""
        found: IntArray = np.full((MAX_CANDIDATES, part.window.height, part.window.width), -1, dtype=np.int32)
        centres = self._centres
        for place, near, covers, xy in self.tiles(part):
            ranked = nearest_images(centres[near], xy, covers, self.weights.reach)
            found[:, *place] = np.where(ranked >= 0, near[ranked], -1).reshape(found[:, *place].shape)
        return found

    @cached_property
    def _centres(self) -> Any:
        return np.array(self.photos.centres)


@dataclass(frozen=True, eq=False)
class HalvedSeams(SeamMethod):
    """Seams that halve overlaps: a place belongs to the image whose inner edge is farthest away.

    Attributes
    ----------
    photos, outlines, grid
        See `SeamMethod`.
    edges : sequence of geometry
        From `voronoi.inner_edges`, one per image.
    """

    edges: Sequence[Any]

    def only(self, near: Collection[int]) -> Self:
        """Method for subdomains at which these images are at hand."""
        return replace(super().only(near), edges=SparseSequence(self.edges, near))

    def labels(self, part: Subdomain, options: RenderOptions) -> IntArray:
        """Image of each cell (rows, cols) of the window of a subdomain."""
        label: IntArray = np.full((part.window.height, part.window.width), -1)
        for place, near, covers, xy in self.tiles(part):
            deepest = farthest_inside([self.edges[i] for i in near], xy, covers)
            label[place] = np.where(deepest >= 0, near[deepest], -1).reshape(label[place].shape)
        return label


def least_cost_regions(
    photos: Photos,
    outlines: Sequence[Any],
    colours: Sequence[Correction],
    options: RenderOptions,
    weights: SeamWeights | None = None,
    layers: SeamLayers | None = None,
    kept: KeptSeams | None = None,
) -> list[Any]:
    """Seam polygons of least cost, by graph cuts over image differences, raised objects and given lines and areas.

    Parameters
    ----------
    photos : Photos
    outlines : sequence of Polygon or MultiPolygon
        What each image shows, in the output map; empty for images that are left out.
    colours : sequence of Correction
        Of all images: they are compared as they will be seen.
    options : RenderOptions
        Threads, workers and progress.
    weights : SeamWeights, optional
    layers : SeamLayers, optional
    kept : KeptSeams, optional
        Seams of an earlier run.

    Returns
    -------
    list of Polygon or MultiPolygon
        One per image; they share no area, and their union is that of the outlines.
    """
    weights, layers = weights or SeamWeights(), layers or SeamLayers()
    method = LeastCostSeams(photos, outlines, seam_grid(photos), tuple(colours), weights, layers)
    return undivided(_laid_out(method, options, kept), outlines, layers.avoid)


def halved_regions(
    photos: Photos, outlines: Sequence[Any], options: RenderOptions, kept: KeptSeams | None = None
) -> list[Any]:
    """Seam polygons that halve overlaps: a place belongs to the image whose inner edge is farthest away.

    Parameters
    ----------
    photos : Photos
    outlines : sequence of Polygon or MultiPolygon
        What each image shows, in the output map; empty for images that are left out.
    options : RenderOptions
        Threads, workers and progress.
    kept : KeptSeams, optional
        Seams of an earlier run.

    Returns
    -------
    list of Polygon or MultiPolygon
        One per image; they share no area, and their union is that of the outlines.
    """
    return _laid_out(HalvedSeams(photos, outlines, seam_grid(photos), inner_edges(outlines)), options, kept)


def seam_grid(photos: Photos) -> Grid:
    """Coarse grid on which seams are laid: about `LAYOUT_CELLS` across a median footprint.

    Parameters
    ----------
    photos : Photos
    """
    areas = [np.prod(np.ptp(outline.ring, axis=0)) for outline in photos.outlines]
    pixel = photos.grid.resolution[0]
    return photos.grid.coarser(max(1, round(float(np.sqrt(np.median(areas))) / LAYOUT_CELLS / pixel)))


def _laid_out(method: SeamMethod, options: RenderOptions, kept: KeptSeams | None) -> list[Any]:
    """Polygons of all images, made to divide the footprints exactly."""
    import shapely

    photos, outlines, grid = method.photos, method.outlines, method.grid
    cells = grid.width * grid.height
    if options.memory_limit < (needed := PROGRAM + CELL_BYTES * min(cells, LARGEST)):
        raise InputError(
            f"{options.memory_limit // MEGABYTE}M is too little memory for seams of {cells / 1e6:.1f} million cells, "
            f"which take {-(-needed // MEGABYTE)}M",
            where="`memory_limit`",
            hint="allow more, or choose `seams` 'nearest', which takes none",
        )
    if cells <= LARGEST:
        whole = Subdomain(grid.window, grid.window, tuple(range(len(photos))))
        found: Any = _seams_of(method, whole, options).polygons
    else:
        windows = [Window(0, 0, 0, 0) if shape.is_empty else grid.window_of(shape.bounds) for shape in outlines]
        alone = replace(options, threads=1, workers=None, progress=None)
        unit = _SubdomainUnit(method, alone, MemoryBudget(options.spare_memory))
        found = seams_in_turns(grid, windows, unit.only, options, kept)
    of_image: dict[int, list[Any]] = {}
    for polygon, number in found:
        of_image.setdefault(number, []).append(polygon)
    shares = [shapely.Polygon() for _ in outlines]
    for number, own in of_image.items():
        # Joined in cells: there the edges of cores are whole numbers, and nothing gapes in grids that are turned.
        shares[number] = polygonal(shapely.transform(shapely.union_all(own), grid.xy))
    # Ground that no cell covers: cells are coarse, and footprints are not made of them.
    rest, cell = voronoi_regions(list(outlines), photos.centres), grid.resolution[0]
    return partition(shares, outlines, rest, cell, MIN_ISLAND * cell**2)


@dataclass(frozen=True, eq=False)
class _SubdomainUnit:
    """Seams of a subdomain, as a unit of work."""

    method: SeamMethod
    options: RenderOptions
    memory: MemoryBudget

    def only(self, near: Collection[int] | None) -> _SubdomainUnit:
        """The same for subdomains at which these images are at hand; any for None."""
        return self if near is None else replace(self, method=self.method.only(near))

    def __call__(self, part: Subdomain) -> SubdomainSeams:
        with self.memory.reserve(CELL_BYTES * part.window.width * part.window.height):
            return _seams_of(self.method, part, self.options)


def _seams_of(method: SeamMethod, part: Subdomain, options: RenderOptions) -> SubdomainSeams:
    """Seams of a subdomain, in which decided cells are as they were."""
    label, decided = method.labels(part, options), part.decided
    known, core = decided > OUTSIDE, part.core.slices_in(part.window)
    label[decided == OUTSIDE] = -1
    label[known] = decided[known]
    label = without_islands(without_spurs(label))
    label[known] = decided[known]
    rims = rims_of(part.core, label[core])
    return SubdomainSeams(_polygons(extrapolated(label, 2)[core], part.core, method.grid), rims)


def _polygons(label: IntArray, core: Window, grid: Grid) -> list[tuple[Any, int]]:
    """Polygons, in cells, of the labelled cells (rows, cols) of a core, each with its image."""
    import shapely

    found, whole = polygons_of_labels(label, grid.crop(core)), core == grid.window
    # The staircase of cells is simplified as a coverage: neighbours keep a common border, without gaps or overlaps. The
    # edge of a core stays, with vertices at the same places on both sides.
    smooth = shapely.coverage_simplify(
        np.array([polygon for polygon, _ in found], dtype=object),
        SMOOTHING * grid.resolution[0],
        simplify_boundary=whole,
    )
    smooth = shapely.transform(smooth, lambda xy: np.round(grid.colrow(xy)))
    return [(polygon, number) for polygon, (_, number) in zip(smooth, found, strict=True)]
