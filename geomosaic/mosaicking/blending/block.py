"""Blocks of a mosaic: geometry, values, colour and blending, in one step from the raw images."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from geomosaic.geo.grid import Grid, Window
from geomosaic.kernels.blend import accumulate, finish
from geomosaic.mosaicking.blending.weights import (
    ImageValues,
    ImageWeight,
    halo,
    image_weight,
    reduction,
    signed_distance,
    suppress_ghosts,
)
from geomosaic.mosaicking.outputs import MosaicUnit
from geomosaic.options.mosaic import BlendOptions
from geomosaic.options.render import CELL
from geomosaic.radiometry.corrections import CorrectionField, ToneCurve
from geomosaic.raster.info import SourceInfo
from geomosaic.raster.validity import rasterized
from geomosaic.render.occlusion import OcclusionMask, Visibility, hidden_label
from geomosaic.render.photo import Rectifier
from geomosaic.render.photos import Photos
from geomosaic.render.sparse import SparseSequence
from geomosaic.resample.warp import Colour, Target, value_range
from geomosaic.sensor.lattice import Lattice
from geomosaic.sensor.map_to_image import BlockGround, Ground
from geomosaic.types import AnyArray, BoolArray, ByteArray

# Interpolation lattices of one block, by image.
Lattices = dict[int, list[Lattice]]


@dataclass(frozen=True)
class Seams:
    """Seam polygons of a mosaic and the transition across them.

    Attributes
    ----------
    polygons : list of geometry
        Seam polygon of each image, in the output map.
    outlines : list of geometry
        Footprints.
    feather : float
        Width of the transition in output pixels.
    """

    polygons: Sequence[Any]
    outlines: Sequence[Any]
    feather: float

    def only(self, near: Collection[int]) -> Seams:
        """Seams of some images, under their numbers."""
        return Seams(SparseSequence(self.polygons, near), SparseSequence(self.outlines, near), self.feather)


@dataclass(frozen=True)
class Blender:
    """Blender of images across seams, block by block; a block depends on no other block.

    Attributes
    ----------
    photos : Photos
    ground : Ground
        Heights below the output.
    seams : Seams
    colours : sequence of Correction
        Correction of each image.
    rectifier : Rectifier
        Of photos onto the grid of the output.
    dtype : str
        Sample type of the output.
    blending : BlendOptions
    visibility : Visibility, optional
        Of a true ortho: what buildings and terrain hide is not taken.
    ranks : sequence of int
        Rank of each image: gaps are filled by images of the first rank that shows the ground, of those by the nearest.
        Empty where all are equals.
    """

    photos: Photos
    ground: Ground
    seams: Seams
    colours: Sequence[Colour | ToneCurve | CorrectionField]
    rectifier: Rectifier
    dtype: str
    blending: BlendOptions
    visibility: Visibility | None = None
    ranks: Sequence[int] = ()

    @property
    def info(self) -> SourceInfo:
        """Bands and sample type of the output."""
        return self.photos.info

    @property
    def grid(self) -> Grid:
        """Grid of the output."""
        return self.rectifier.grid

    def only(self, near: Collection[int]) -> Self:
        """Blender of some images, under their numbers: those that a region depends on."""
        photos, colours = self.photos.only(near), SparseSequence(self.colours, near)
        return replace(self, photos=photos, seams=self.seams.only(near), colours=colours)

    def rank(self, index: int) -> int:
        """Rank of an image."""
        return self.ranks[index] if self.ranks else 0

    def shapes(self, index: int) -> tuple[Any, ...]:
        """Shapes of an image that pixels depend on: its seam polygon and footprint."""
        return self.seams.polygons[index], self.seams.outlines[index]

    @property
    def reach(self) -> int:
        """Output pixels beyond a block that its weights depend on."""
        factor = reduction(self.seams.feather)
        return (halo(self.seams.feather, factor) + 1) * factor

    @property
    def anti_ghosting(self) -> bool:
        """Whether images are not blended where they differ by more than noise."""
        return self.blending.limits and self.seams.feather > 0

    @property
    def fingerprint(self) -> str:
        """Text of what pixels depend on in every block alike, besides the options."""
        return ""

    @property
    def uses_neighbours(self) -> bool:
        """Whether images beside a block, not above it, can change it."""
        return False

    def fill(self, window: Window, unit: MosaicUnit) -> None:
        """Block rendered into its place in a unit."""
        near = close = self.photos.near(window)
        if not near:
            return
        ground = self.ground.block(window)
        if ground.unknown:
            return
        place = window.slices_in(unit.window)
        values, valid, label = unit.values[place], unit.valid[place], unit.label[place]
        shares = self._shares(window, near)
        lattices: Lattices = {}
        shades = None if self.visibility is None else self.visibility.block(ground)
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
            unit.counts[shares[0].index + 1] += int(np.count_nonzero(valid.view(np.bool_)))
        else:
            for number in (*(i + 1 for i in close), hidden_label(len(self.photos))):
                unit.counts[number] += int(np.count_nonzero(label == number))
        unit.facts.extend((lattice.error, lattice.scale) for used in lattices.values() for lattice in used)

    def _mark_hidden(self, shades: OcclusionMask | None, valid: ByteArray, label: AnyArray) -> bool:
        """Pixels that images cover and the surface hides from all, labelled in place; whether there are any."""
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
        shades: OcclusionMask | None = None,
        only: BoolArray | None = None,
    ) -> None:
        with self.photos.using(index) as photo:
            lattices[index] = self.rectifier.fill(
                photo, ground, self.colours[index], Target(out, valid, need, only),
                lattices=lattices.get(index), shades=shades,
            )  # fmt: skip

    def _shares(self, window: Window, near: list[int]) -> list[ImageWeight]:
        """Weights of the images that have any in the block."""
        import shapely

        feather = self.seams.feather
        factor = reduction(feather)
        margin = halo(feather, factor)
        reduced = self._reduced(window, factor, margin)
        frame = shapely.box(*reduced.bounds)
        close = [i for i in near if self.seams.polygons[i].intersects(frame)]
        if len(close) == 1 and self.seams.polygons[close[0]].covers(frame):
            return [ImageWeight(close[0], None, factor, margin)]
        label = rasterized([(self.seams.polygons[i], i) for i in close], reduced)
        distance: dict[int, AnyArray] = {}
        # Of two images, the distance to the seam is that of the other with its sign turned: one transform saved.
        if feather > 0 and len(close) == 2 and label.min() >= 0:
            distance[close[0]] = signed_distance(label == close[0], feather / 2 / factor)
            distance[close[1]] = -distance[close[0]]
        weighted = []
        for i in close:
            footprint = None
            if feather > 0 and not self.seams.outlines[i].covers(frame):
                footprint = rasterized([(self.seams.outlines[i], 1)], reduced) == 1
            weight = image_weight(label, i, footprint, feather, factor, distance.get(i))
            if self.blending.ramp == "smooth":  # 3t² − 2t³: without a kink at its ends
                weight = weight * weight * (3 - 2 * weight)
            if weight.any():
                weighted.append(ImageWeight(i, weight, factor, margin))
        return weighted

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
        shares: list[ImageWeight],
        values: AnyArray,
        valid: ByteArray,
        label: AnyArray,
        lattices: Lattices,
        shades: OcclusionMask | None = None,
    ) -> None:
        shape, bands = valid.shape, values.shape[2]
        needs = [share.cells(shape) for share in shares]
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
        # Cells with weight of one image only are written at once; the others are summed up with their weights.
        # Sums of integers of 32 bits, and of doubles, need more digits than float32 holds.
        kind = np.float32 if values.dtype.itemsize < 4 or values.dtype == np.float32 else np.float64
        total, own = np.zeros((*shape, bands), dtype=kind), np.zeros((*shape, bands), dtype=kind)
        sums, best = np.zeros(shape, dtype=np.float32), np.zeros(shape, dtype=np.float32)
        kept: list[ImageValues] = []
        for share, need in zip(shares, needs, strict=True):
            shared = need & mixed
            if not shared.any():
                continue
            if self.anti_ghosting and kept:
                own, seen = np.zeros_like(own), np.zeros_like(seen)
            else:
                seen.fill(0)  # values of the last image in `own` are no longer valid
            self._pull(share.index, ground, own, seen, shared, lattices, shades)
            assert share.weight is not None  # only an image that has the block alone comes without
            accumulate(
                own, seen, share.weight, share.factor, share.margin, share.index + 1, shared, total, sums, best, label
            )
            if self.anti_ghosting:
                kept.append(ImageValues(share, own, seen, shared))
        suppress_ghosts(kept, str(values.dtype), label, total)
        low, high, whole = value_range(str(values.dtype))
        finish(total, sums, mixed, low, high, whole, values, valid)

    def _fill(
        self,
        ground: BlockGround,
        near: list[int],
        values: AnyArray,
        valid: ByteArray,
        label: AnyArray,
        lattices: Lattices,
        shades: OcclusionMask | None = None,
    ) -> bool:
        """Gaps filled where the seams' choice shows nothing (nodata, hidden, edges), by the nearest of first rank."""
        if valid.view(np.bool_).all():
            return False
        filled = False
        window = ground.window
        middle = self.grid.xy(np.array([[window.col + window.width / 2, window.row + window.height / 2]]))[0]
        distances = {i: np.hypot(*(np.array(self.photos.outlines[i].centre) - middle)) for i in near}
        own, seen, missing = np.empty_like(values), np.zeros_like(valid), np.empty(valid.shape, dtype=bool)
        for i in sorted(near, key=lambda i: (self.rank(i), distances[i], i)):
            # Footprints have a hundred points and cut corners in high relief: only the image itself knows its pixels.
            np.equal(valid, 0, out=missing)
            if not missing.any():
                break
            useful: AnyArray = missing
            if shades is not None:
                with self.photos.using(i) as photo:
                    useful = shades.worthwhile(photo.mapper, missing)
            need = cells_of(useful).astype(np.uint8)
            if not need.any():
                continue
            seen.fill(0)
            self._pull(i, ground, own, seen, need, lattices, shades, useful)
            new = np.flatnonzero(np.greater(seen, valid, out=missing))
            if not len(new):
                continue
            down, along = np.divmod(new, valid.shape[1])
            values[down, along], valid[down, along], label[down, along] = own[down, along], 1, i + 1
            filled = True
        return filled


def cells_of(mask: AnyArray) -> AnyArray:
    """Cells of 64 × 64 pixels that contain any pixel of a mask.

    Parameters
    ----------
    mask : bool array (rows, cols)

    Returns
    -------
    bool array (⌈rows / 64⌉, ⌈cols / 64⌉)
    """
    rows, cols = -(-mask.shape[0] // CELL), -(-mask.shape[1] // CELL)
    padded = mask
    if mask.shape != (rows * CELL, cols * CELL) or not mask.flags.c_contiguous:
        padded = np.zeros((rows * CELL, cols * CELL), dtype=bool)
        padded[: mask.shape[0], : mask.shape[1]] = mask
    words = np.bitwise_or.reduce(padded.view(np.uint64).reshape(rows, CELL, -1), axis=1)  # eight pixels at once
    return np.asarray(words.reshape(rows, cols, CELL // 8).any(axis=2))
