"""Blending of blocks by the differences of images: multiband, over overlaps, along edges and cut lines."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from geomosaic.geo.grid import Window
from geomosaic.mosaicking.blending.block import Blender, Lattices
from geomosaic.mosaicking.blending.feathering import cutline_weights, edge_distance, edge_weights, normalised
from geomosaic.mosaicking.outputs import MosaicUnit
from geomosaic.options.render import CELL
from geomosaic.raster.validity import rasterized
from geomosaic.render.occlusion import OcclusionMask
from geomosaic.render.photos import MemoryBudget
from geomosaic.render.sparse import SparseSequence
from geomosaic.resample.multiband import Part, View, by_weights, corrected, differences, in_bands, parts_of, spread
from geomosaic.sensor.map_to_image import BlockGround
from geomosaic.types import AnyArray, IntArray

MAX_LEVELS = 8


@dataclass(frozen=True, kw_only=True)
class MultibandBlender(Blender):
    """Blender of blocks in frequency bands, or by feathering; `seams.feather` is 0: hard seams are blended here.

    Attributes
    ----------
    width : float
        Of the transition in output pixels.
    noise : float, optional
        Standard deviation of the difference of images, where larger differences are not to be blended.
    budget : MemoryBudget
        For the values of all images of a block: where photos are small or overlap much, these are many.
    edges : sequence of geometry
        Of feathering along edges and cut lines: parts of each footprint's edge that lie within other images.
    lines : sequence of geometry
        Of feathering along cut lines: seams along each polygon.
    order : sequence of int
        Of feathering along edges: numbers of the images, the uppermost first.
    """

    width: float
    noise: float | None
    budget: MemoryBudget
    edges: Sequence[Any] = ()
    lines: Sequence[Any] = ()
    order: Sequence[int] = ()

    def only(self, near: Collection[int]) -> Self:
        """Blender of some images, under their numbers: those that a region depends on."""
        edges, lines = (SparseSequence(each, near) if each else () for each in (self.edges, self.lines))
        order = [i for i in self.order if i in near]
        return replace(super().only(near), edges=edges, lines=lines, order=order)

    @property
    def everywhere(self) -> bool:
        """Whether images are blended wherever they overlap, near a seam or not."""
        return self.blending.blend in ("overlap", "edge")

    @property
    def levels(self) -> int:
        """Coarser levels of the pyramid: the coarsest band is about `width` pixels wide."""
        return min(MAX_LEVELS, max(1, round(math.log2(max(self.width, 2.0)))))

    @property
    def cell(self) -> int:
        """Side in pixels of the cells that are blended, or not, as a whole."""
        return max(CELL, 1 << self.levels if self.blending.blend == "multiband" else CELL)

    @property
    def margin(self) -> int:
        """Pixels beyond a seam that its blending changes, in whole cells; as many more are read."""
        if self.blending.blend == "multiband":
            pixels = spread(self.levels)
        else:
            pixels = CELL + (math.ceil(self.width / 2) if self.blending.blend == "cutline" else 0)
        return self.cell * -(-pixels // self.cell)

    @property
    def reach(self) -> int:
        """Pixels beyond a block that it depends on."""
        ramp = math.ceil(self.width) if self.blending.blend in ("edge", "cutline") else 0
        return 2 * self.margin + self.cell + ramp

    @property
    def fingerprint(self) -> str:
        """Text of what pixels depend on in every block alike, besides the options."""
        return f"{self.noise!r} {list(self.order)}" if self.order else repr(self.noise)

    @property
    def uses_neighbours(self) -> bool:
        """Whether images beside a block, not above it, can change it."""
        return True

    def fill(self, window: Window, unit: MosaicUnit) -> None:
        """Block rendered into its place in a unit."""
        label, around = self._label(window)
        if self.everywhere and len(self.photos.near(around)) == 1:
            label = None
        zone = None if label is None else self._zone(window, label, around)
        ground = None if zone is None else self.ground.block(self._with_margin(zone))
        if label is None or zone is None or ground is None or ground.unknown:
            super().fill(window, unit)
            return
        place = window.slices_in(unit.window)
        values, valid, number = unit.values[place], unit.valid[place], unit.label[place]
        lattices: list[Lattices] = [{}, {}]
        block_ground = self.ground.block(window)
        block_shades, zone_shades = (
            (None, None)
            if self.visibility is None
            else (self.visibility.block(block_ground), self.visibility.block(ground))
        )
        if not block_ground.unknown:
            self._copy_single_images(window, zone, label, around, (values, valid, number), lattices[0], block_shades)
        with self.budget.reserve(self._bytes(label, around, ground.window)):
            self._blend_seams(window, ground, zone, label, around, (values, valid, number), lattices[1], zone_shades)
        if not block_ground.unknown:
            self._fill(block_ground, self.photos.near(window), values, valid, number, lattices[0], block_shades)
        self._mark_hidden(block_shades, valid, number)
        unit.count(number)
        unit.facts.extend((one.error, one.scale) for two in lattices for used in two.values() for one in used)

    def _bytes(self, label: IntArray, around: Window, wide: Window) -> int:
        """Estimated bytes that the images of a block hold at once: values, differences, sums and weights."""
        # Images that only fill gaps are not known yet.
        sample, whole = np.dtype(self.dtype).itemsize, wide.width * wide.height
        if self.everywhere:
            images = len(self.photos.near(wide))
            apart = images * whole
        else:
            parts = [part for part in self._parts(label[wide.slices_in(around)], len(self.photos)) if part is not None]
            images, apart = len(parts), sum(part.size for part in parts)
        return self.photos.info.bands * (whole * (images * sample + 24) + apart * max(4, sample))

    def _parts(self, label: IntArray, images: int) -> list[Part | None]:
        """Parts of the window in which differences of each image are needed."""
        if self.blending.blend != "multiband":
            return [Part.whole(label.shape)] * images
        return parts_of(label, images, spread(self.levels), self.levels)

    def _with_margin(self, zone: Window) -> Window:
        by = self.margin
        return zone.grown(by)

    def _label(self, window: Window) -> tuple[IntArray | None, Window]:
        """Image of each pixel by the seams, −1 where none, over the block in whole cells with a margin; None if one."""
        import shapely

        size = self.cell
        wide, tall = (-(-length // size) * size for length in (window.width, window.height))
        around = self._with_margin(Window(window.col, window.row, wide, tall))
        grid = self.grid.crop(around)
        frame = shapely.box(*grid.bounds)
        shapes = self.seams.polygons
        close = [i for i in self.photos.near(around) if shapes[i].intersects(frame)]
        if not close or (len(close) == 1 and not self.everywhere and shapes[close[0]].covers(frame)):
            return None, around
        return rasterized([(shapes[i], i) for i in close], grid).astype(np.int64), around

    def _zone(self, window: Window, label: IntArray, around: Window) -> Window | None:
        """Part of a block, in whole cells, that lies within the margin of seams."""
        size = self.cell
        if self.everywhere:
            return Window(window.col, window.row, around.width - 2 * self.margin, around.height - 2 * self.margin)
        rows, cols = label.shape[0] // size, label.shape[1] // size
        cells = label.reshape(rows, size, cols, size)
        least, most, far = cells.min(axis=(1, 3)), cells.max(axis=(1, 3)), self.margin // size
        mixed = np.zeros((rows - 2 * far, cols - 2 * far), dtype=bool)
        inner = least[far : rows - far, far : cols - far]
        for down in range(2 * far + 1):
            for right in range(2 * far + 1):
                there = slice(down, down + mixed.shape[0]), slice(right, right + mixed.shape[1])
                mixed |= (least[there] != inner) | (most[there] != inner)
        if not mixed.any():
            return None
        r, c = np.nonzero(mixed.any(axis=1))[0], np.nonzero(mixed.any(axis=0))[0]
        return Window(
            window.col + int(c[0]) * size, window.row + int(r[0]) * size,
            int(c[-1] - c[0] + 1) * size, int(r[-1] - r[0] + 1) * size,
        )  # fmt: skip

    def _copy_single_images(
        self,
        window: Window,
        zone: Window,
        label: IntArray,
        around: Window,
        target: tuple[AnyArray, AnyArray, AnyArray],
        lattices: Lattices,
        shades: OcclusionMask | None,
    ) -> None:
        """Cells of the block away from seams, of one image each."""
        values, valid, number = target
        rows, cols = -(-window.height // CELL), -(-window.width // CELL)
        top, left = window.row - around.row, window.col - around.col
        own = label[top : top + rows * CELL : CELL, left : left + cols * CELL : CELL].copy()
        first_row, first_col = (zone.row - window.row) // CELL, (zone.col - window.col) // CELL
        own[first_row : first_row + zone.height // CELL, first_col : first_col + zone.width // CELL] = -1
        ground = self.ground.block(window)
        for i in np.unique(own[own >= 0]).tolist():
            seen = np.zeros_like(valid)
            self._pull(i, ground, values, seen, (own == i).astype(np.uint8), lattices, shades)
            valid |= seen
            number += seen * number.dtype.type(i + 1)

    def _blend_seams(
        self,
        window: Window,
        ground: BlockGround,
        zone: Window,
        label: IntArray,
        around: Window,
        target: tuple[AnyArray, AnyArray, AnyArray],
        lattices: Lattices,
        shades: OcclusionMask | None,
    ) -> None:
        """Zone around seams, blended with its margin; what lies in the block is kept."""
        wide = self._with_margin(zone)
        label = label[wide.slices_in(around)].copy()
        images, views = self._views(ground, label, lattices, shades)
        if not images:
            return
        local = self._own(images, views, label)
        weights = self._weights(wide, images, views, local)
        part = zone.intersection(window)
        inside, block = part.slices_in(wide), part.slices_in(window)
        apart = differences(views, local, self.noise, self._parts(local, len(views)))
        if weights is None:
            blend = in_bands(apart, local, self.levels)
        else:
            blend = by_weights(apart, weights)
        corrected(views, apart, blend, local, inside, target[0][block])
        target[1][block] = local[inside] >= 0
        numbers = np.array([*(i + 1 for i in images), 0], dtype=target[2].dtype)  # −1 takes the last
        target[2][block] = numbers[local[inside]]

    def _views(
        self, ground: BlockGround, label: IntArray, lattices: Lattices, shades: OcclusionMask | None
    ) -> tuple[list[int], list[View]]:
        """Images that the seams choose in a window, with values; others where those leave gaps, or all are blended."""
        wide = ground.window
        info, shape = self.photos.info, label.shape
        bounds = np.array([[wide.col, wide.row], [wide.stop_col, wide.stop_row]], dtype=np.float64)
        middle = self.grid.xy(bounds.mean(axis=0)[None])[0]
        near = self.photos.near(wide)
        apart = {i: float(np.hypot(*(np.array(self.photos.outlines[i].centre) - middle))) for i in near}
        near.sort(key=lambda i: (self.rank(i), apart[i], i))
        chosen = set(np.flatnonzero(np.bincount(label.ravel() + 1)[1:]).tolist())
        images, views, gap = [], [], np.ones(shape, dtype=bool)
        # The images that the seams choose first, each group from near to far: sorts are stable.
        for i in sorted(near, key=lambda i: i not in chosen):
            wanted = i in chosen or self.everywhere
            if not wanted and not gap.any():
                break
            values, seen = np.zeros((*shape, info.bands), dtype=self.dtype), np.zeros(shape, dtype=np.uint8)
            self._pull(i, ground, values, seen, None, lattices, shades)
            # Beyond all images a gap stays, however many are tried: only those that show something of it are kept.
            if (seen if wanted else seen * gap).any():
                images.append(i)
                views.append(View(values, seen > 0))
                gap &= seen == 0
        return images, views

    def _own(self, images: Sequence[int], views: Sequence[View], label: IntArray) -> IntArray:
        """Position of each pixel's image among the views: the seams' choice, else the nearest that shows it; −1."""
        local = np.full(label.shape, -1, dtype=np.int64)
        for position, (image, view) in enumerate(zip(images, views, strict=True)):
            local[(label == image) & view.valid] = position
        for position, view in enumerate(views):
            local[(local < 0) & view.valid] = position
        return local

    def _weights(
        self, wide: Window, images: Sequence[int], views: Sequence[View], local: IntArray
    ) -> list[AnyArray] | None:
        """Weights of the images, with sum one; None for multiband, which has weights by level."""
        if self.blending.blend == "multiband":
            return None
        raw = self._ramps(wide, images, [view.valid for view in views])
        best = np.argmax(raw, axis=0)
        some = np.max(raw, axis=0) > 0
        local[some] = best[some]
        if self.blending.ramp == "smooth":
            raw = [weight**2 * (3 - 2 * weight) for weight in raw]
        return normalised(raw, local)

    def _ramps(self, wide: Window, images: Sequence[int], valid: Sequence[AnyArray]) -> list[AnyArray]:
        """Weights of the images (rows, cols) before they are divided by their sum, 0 where an image shows nothing."""
        outlines = [self.seams.outlines[i] for i in images]
        if self.blending.blend == "overlap":
            pixel = math.sqrt(self.grid.resolution[0] * self.grid.resolution[1])
            wides = [self.width if math.isfinite(self.width) else math.sqrt(one.area) / pixel for one in outlines]
            depths = [edge_distance(one, self.grid, wide, math.inf) for one in outlines]
            ramps = [np.clip(depth / most, 0.0, 1.0) for depth, most in zip(depths, wides, strict=True)]
            return [ramp * seen for ramp, seen in zip(ramps, valid, strict=True)]
        depths = [
            edge_distance(one, self.grid, wide, self.width, self.edges[i]) / self.width
            for i, one in zip(images, outlines, strict=True)
        ]
        if self.blending.blend == "edge":
            return edge_weights(depths, valid, [images.index(i) for i in self.order if i in images])
        sides = [
            edge_distance(self.seams.polygons[i], self.grid, wide, self.width, self.lines[i]) / self.width
            for i in images
        ]
        return [ramp * seen for ramp, seen in zip(cutline_weights(sides, depths), valid, strict=True)]
