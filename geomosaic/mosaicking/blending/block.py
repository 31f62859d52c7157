"""One block of a mosaic: geometry, value, colour, blend, in one go from the raw images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from geomosaic.geo.grid import Grid, Window
from geomosaic.mosaicking.blending.ghosting import Shown, limit
from geomosaic.mosaicking.blending.weights import Share, halo, reduction, signed_distance, weights
from geomosaic.mosaicking.unit import MosaicUnit
from geomosaic.radiometry.histogram_matching import Curve
from geomosaic.radiometry.local_gains import Shade
from geomosaic.raster.info import SourceInfo
from geomosaic.raster.validity import burn
from geomosaic.render.occlusion import Shades, Visibility, hidden_label
from geomosaic.render.photo import pull
from geomosaic.render.photos import Photos
from geomosaic.resample.engine import Engine
from geomosaic.resample.warp import CELL, Colour, value_range
from geomosaic.sensor.lattice import Lattice
from geomosaic.sensor.map_to_image import BlockGround, Ground
from geomosaic.types import AnyArray, BoolArray, ByteArray

Lattices = dict[int, list[Lattice]]
"""Of one block, by image."""


@dataclass(frozen=True)
class Seams:
    """Who shows what.

    Attributes
    ----------
    regions : list of geometry
        The share of each image, in the output map.
    outlines : list of geometry
        Footprints.
    feather : float
        Width of the transition in output pixels.
    smooth : bool
        3t² − 2t³ in place of t: ramps without a kink at their ends.
    """

    regions: list[Any]
    outlines: list[Any]
    feather: float
    smooth: bool = False


@dataclass(frozen=True)
class Blender:
    """Renders blocks of a mosaic; a block depends on nothing but itself."""

    photos: Photos
    grid: Grid
    below: Ground
    seams: Seams
    colours: Sequence[Colour | Curve | Shade]
    engine: Engine
    resampling: str
    tolerance: float
    dtype: str
    """Of the output."""
    sight: Visibility | None
    limited: bool
    """Whether what images show differently is not blended."""

    @property
    def info(self) -> SourceInfo:
        """Bands and sample type of the output."""
        return self.photos.info

    @property
    def reach(self) -> int:
        """Output pixels beyond a block that its weights depend on."""
        factor = reduction(self.seams.feather)
        return (halo(self.seams.feather, factor) + 1) * factor

    @property
    def said(self) -> str:
        """What else pixels depend on, the same for all blocks, as text."""
        return "".join(word for word, asked in (("limited", self.limited), (" smooth", self.seams.smooth)) if asked)

    @property
    def wide(self) -> bool:
        """Whether images beside a block can change it."""
        return False

    def by(self, engine: Engine) -> Self:
        """The same with another engine, which gives the same bytes."""
        return replace(self, engine=engine)

    def fill(self, window: Window, unit: MosaicUnit) -> None:
        """Render one block into its place in a unit."""
        near = close = self.photos.near(window)
        if not near:
            return
        ground = self.below.block(window)
        if ground.unknown:
            return
        place = window.slices_in(unit.window)
        values, valid, label = unit.values[place], unit.valid[place], unit.label[place]
        shares = self._shares(window, near)
        lattices: Lattices = {}
        shades = None if self.sight is None else self.sight.block(ground)
        if len(shares) == 1:
            index = shares[0].index
            self._pull(index, ground, values, valid, None, lattices, shades)
            np.multiply(valid, label.dtype.type(index + 1), out=label)
            near = [i for i in near if i != index]
        elif shares:
            self._blend(ground, shares, values, valid, label, lattices, shades)
        filled = self._fill(ground, near, values, valid, label, lattices, shades)
        filled = self._mark_hidden(shades, valid, label) or filled
        if len(shares) == 1 and not filled:
            unit.counts[shares[0].index + 1] += np.count_nonzero(valid.view(np.bool_))
        else:
            for number in (*(i + 1 for i in close), hidden_label(len(self.photos))):
                unit.counts[number] += np.count_nonzero(label == number)
        unit.facts.extend((lattice.error, lattice.scale) for used in lattices.values() for lattice in used)

    def _mark_hidden(self, shades: Shades | None, valid: ByteArray, label: AnyArray) -> bool:
        """Label what images cover and none shows; whether there is any."""
        if shades is None or not shades.mask.any():
            return False
        label[(shades.mask > 0) & (valid == 0)] = hidden_label(len(self.photos))
        return True

    def _pull(
        self,
        index: int,
        ground: BlockGround,
        out: AnyArray,
        valid: ByteArray,
        need: ByteArray | None,
        lattices: Lattices,
        shades: Shades | None = None,
        only: BoolArray | None = None,
    ) -> None:
        with self.photos.using(index) as photo:
            lattices[index] = pull(
                self.engine, photo, self.grid, ground, self.resampling, self.tolerance,
                self.colours[index], out, valid, need, lattices=lattices.get(index), shades=shades,
                only=only,
            )  # fmt: skip

    def _shares(self, window: Window, near: list[int]) -> list[Share]:
        """Weights of the images that have any in the block."""
        import shapely

        feather = self.seams.feather
        factor = reduction(feather)
        margin = halo(feather, factor)
        reduced = self._reduced(window, factor, margin)
        frame = shapely.box(*reduced.bounds)
        close = [i for i in near if self.seams.regions[i].intersects(frame)]
        if len(close) == 1 and self.seams.regions[close[0]].covers(frame):
            return [Share(close[0], None, factor, margin)]
        label = burn([(self.seams.regions[i], i) for i in close], reduced)
        distance: dict[int, AnyArray] = {}
        if feather > 0 and len(close) == 2 and label.min() >= 0:  # what is beyond the one's seam is within the other's
            distance[close[0]] = signed_distance(label == close[0], feather / 2 / factor)
            distance[close[1]] = -distance[close[0]]
        shares = []
        for i in close:
            footprint = None
            if feather > 0 and not self.seams.outlines[i].covers(frame):
                footprint = burn([(self.seams.outlines[i], 1)], reduced) == 1
            weight = weights(label, i, footprint, feather, factor, distance.get(i))
            if self.seams.smooth:
                weight = weight * weight * (3 - 2 * weight)
            if weight.any():
                shares.append(Share(i, weight, factor, margin))
        return shares

    def _reduced(self, window: Window, factor: int, margin: int) -> Grid:
        """Grid of the weights: the block in cells of `factor` pixels, with a margin."""
        cols, rows = -(-window.width // factor), -(-window.height // factor)
        corner = Window(
            window.col - margin * factor,
            window.row - margin * factor,
            (cols + 2 * margin) * factor,
            (rows + 2 * margin) * factor,
        )
        return self.grid.crop(corner).coarser(factor)

    def _blend(
        self,
        ground: BlockGround,
        shares: list[Share],
        values: AnyArray,
        valid: ByteArray,
        label: AnyArray,
        lattices: Lattices,
        shades: Shades | None = None,
    ) -> None:
        shape, bands = valid.shape, values.shape[2]
        needs = [share.need(shape) for share in shares]
        mixed = (np.sum(needs, axis=0) > 1).astype(np.uint8)
        seen = np.zeros(shape, dtype=np.uint8)
        for share, need in zip(shares, needs, strict=True):
            alone = need & ~mixed
            if alone.any():
                seen.fill(0)
                self._pull(share.index, ground, values, seen, alone, lattices, shades)
                valid |= seen
                label += seen * label.dtype.type(share.index + 1)
        if not mixed.any():
            return
        # Sums of numbers of 32 bits and more need more digits than those of photos.
        kind = np.float32 if values.dtype.itemsize < 4 or values.dtype == np.float32 else np.float64
        total, own = np.zeros((*shape, bands), dtype=kind), np.zeros((*shape, bands), dtype=kind)
        sums, best = np.zeros(shape, dtype=np.float32), np.zeros(shape, dtype=np.float32)
        kept: list[Shown] = []
        for share, need in zip(shares, needs, strict=True):
            shared = need & mixed
            if not shared.any():
                continue
            if self.limited and kept:
                own, seen = np.zeros_like(own), np.zeros_like(seen)
            else:
                seen.fill(0)  # and what the last image left in `own` counts no more
            self._pull(share.index, ground, own, seen, shared, lattices, shades)
            self.engine.accumulate(
                own, seen, share.weight, share.factor, share.margin, share.index + 1, shared, total, sums, best, label
            )
            if self.limited:
                kept.append(Shown(share, own, seen, shared))
        limit(kept, self.engine, str(values.dtype), label, total)
        low, high, whole = value_range(str(values.dtype))
        self.engine.finish(total, sums, mixed, low, high, whole, values, valid)

    def _fill(
        self,
        ground: BlockGround,
        near: list[int],
        values: AnyArray,
        valid: ByteArray,
        label: AnyArray,
        lattices: Lattices,
        shades: Shades | None = None,
    ) -> bool:
        """Where the seams' choice shows nothing (nodata, its edge, what is hidden), take the nearest that does."""
        if valid.view(np.bool_).all():
            return False
        filled = False
        window = ground.window
        middle = self.grid.xy(np.array([[window.col + window.width / 2, window.row + window.height / 2]]))[0]
        centres = {i: np.hypot(*(np.array(self.photos.outlines[i].centre) - middle)) for i in near}
        own, seen, missing = np.empty_like(values), np.zeros_like(valid), np.empty(valid.shape, dtype=bool)
        for i in sorted(near, key=lambda i: (centres[i], i)):
            # Outlines are drawn through a hundred points and cut corners of high relief: the image itself is asked.
            np.equal(valid, 0, out=missing)
            if not missing.any():
                break
            wanted: AnyArray = missing
            if shades is not None:
                with self.photos.using(i) as photo:
                    wanted = shades.worthwhile(photo.mapper, missing)
            need = cells_of(wanted).astype(np.uint8)
            if not need.any():
                continue
            seen.fill(0)
            self._pull(i, ground, own, seen, need, lattices, shades, wanted)
            new = np.flatnonzero(np.greater(seen, valid, out=missing))
            if not len(new):
                continue
            down, along = np.divmod(new, valid.shape[1])
            values[down, along], valid[down, along], label[down, along] = own[down, along], 1, i + 1
            filled = True
        return filled


def cells_of(mask: AnyArray) -> AnyArray:
    """Cells of 64 × 64 pixels with any pixel of a mask."""
    rows, cols = -(-mask.shape[0] // CELL), -(-mask.shape[1] // CELL)
    padded = mask
    if mask.shape != (rows * CELL, cols * CELL) or not mask.flags.c_contiguous:
        padded = np.zeros((rows * CELL, cols * CELL), dtype=bool)
        padded[: mask.shape[0], : mask.shape[1]] = mask
    words = np.bitwise_or.reduce(padded.view(np.uint64).reshape(rows, CELL, -1), axis=1)  # eight pixels at once
    return np.asarray(words.reshape(rows, cols, CELL // 8).any(axis=2))
