"""Mosaic by rule, without seams: what `rio merge` does, for images of any CRS and pixel size."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from geomosaic.geo.grid import Grid, Window
from geomosaic.mosaicking.blending.block import Lattices, cells_of
from geomosaic.mosaicking.outputs import MosaicUnit
from geomosaic.options.mosaic import SINGLE_SOURCE_RULES
from geomosaic.options.render import CELL
from geomosaic.radiometry.corrections import CorrectionField, ToneCurve
from geomosaic.raster.info import SourceInfo
from geomosaic.render.photo import Rectifier
from geomosaic.render.photos import Photos
from geomosaic.render.sparse import SparseSequence
from geomosaic.resample.warp import Colour, Target, value_range
from geomosaic.sensor.lattice import Lattice
from geomosaic.sensor.map_to_image import BlockGround, Ground
from geomosaic.types import AnyArray, BoolArray, ByteArray

# Bytes of the stack of all images' values that a median holds at once, however many images overlap.
MEDIAN_MEMORY = 32 << 20

# Number of an image, its values (rows, cols, bands), and where they are valid (rows, cols).
Layer = tuple[int, AnyArray, BoolArray]


def output_info(info: SourceInfo, rule: str) -> SourceInfo:
    """Bands and sample type of the output of a rule.

    A count is one band of uint16. Sums of 8 and 16 bits are uint32 or int32, and others float64: nothing overflows.

    Parameters
    ----------
    info : SourceInfo
        Of the images.
    rule : str
        One of `RULES`.

    Returns
    -------
    SourceInfo
    """
    if rule == "count":
        return replace(info, bands=1, dtype="uint16", descriptions=("images",))
    if rule == "sum":
        kind = np.dtype(info.dtype)
        small = {"u": "uint32", "i": "int32"}.get(kind.kind) if kind.itemsize < 4 else None
        return replace(info, dtype=small or "float64")
    return info


@dataclass(frozen=True)
class RuleBlender:
    """Blender of blocks by a rule; a block depends on no other block.

    Attributes
    ----------
    photos : Photos
    ground : Ground
        Heights below the output.
    colours : sequence of Correction
        Correction of each image.
    rectifier : Rectifier
        Of photos onto the grid of the output.
    rule : str
        One of `RULES`.
    order : sequence of int
        All images, the uppermost first.
    info : SourceInfo
        Bands and sample type of the output.
    """

    photos: Photos
    ground: Ground
    colours: Sequence[Colour | ToneCurve | CorrectionField]
    rectifier: Rectifier
    rule: str
    order: Sequence[int]
    info: SourceInfo

    def only(self, near: Collection[int]) -> RuleBlender:
        """Blender of some images, under their numbers: those that a region depends on."""
        order = [i for i in self.order if i in near]
        return replace(self, photos=self.photos.only(near), colours=SparseSequence(self.colours, near), order=order)

    @property
    def grid(self) -> Grid:
        """Grid of the output."""
        return self.rectifier.grid

    @property
    def dtype(self) -> str:
        """Sample type of the output."""
        return self.info.dtype

    @property
    def reach(self) -> int:
        """Output pixels beyond a block that it depends on: none."""
        return 0

    @property
    def fingerprint(self) -> str:
        """Text of what pixels depend on in every block alike, besides the options."""
        return f"{self.rule} {list(self.order)}"

    @property
    def uses_neighbours(self) -> bool:
        """Whether images beside a block, not above it, can change it."""
        return False

    def rank(self, index: int) -> int:
        """Rank of an image: the order says it."""
        return 0

    def shapes(self, index: int) -> tuple[Any, ...]:
        """Shapes of an image that pixels depend on: there are no seams."""
        return ()

    def fill(self, window: Window, unit: MosaicUnit) -> None:
        """Block rendered into its place in a unit."""
        around = set(self.photos.near(window))
        near = [i for i in self.order if i in around]
        if not near:
            return
        lattices: Lattices = {}
        rows_at_once = self._rows(window, len(near)) if self.rule == "median" else window.height
        for part in window.split(window.width, rows_at_once):
            ground = self.ground.block(part)
            if ground.unknown:
                continue
            place = part.slices_in(unit.window)
            target = unit.values[place], unit.valid[place], unit.label[place]
            lattices = {}
            if self.rule in SINGLE_SOURCE_RULES:
                self._lay(ground, near, target, lattices)
            else:
                self._combine(ground, near, target, lattices)
            unit.count(target[2])
            unit.facts.extend((lattice.error, lattice.scale) for used in lattices.values() for lattice in used)

    def _rows(self, window: Window, images: int) -> int:
        """Rows of whole cells for which the values of so many images fit in `MEDIAN_MEMORY`."""
        # Doubles, as in the stack that is sorted.
        row = window.width * self.photos.info.bands * images * 8
        return min(window.height, max(CELL, MEDIAN_MEMORY // row // CELL * CELL))

    def _lay(
        self,
        ground: BlockGround,
        near: Sequence[int],
        target: tuple[AnyArray, ByteArray, AnyArray],
        lattices: Lattices,
    ) -> None:
        """Images below each other: pixels that have a value keep it."""
        values, valid, label = target
        for i in near:
            missing = valid == 0
            if not missing.any():
                break
            if missing.all():  # the first image needs no copy: there is nothing to overwrite
                lattices[i] = self._pull(i, ground, values, valid, None)
                label[valid > 0] = i + 1
                continue
            own, seen = np.zeros_like(values), np.zeros_like(valid)
            lattices[i] = self._pull(i, ground, own, seen, cells_of(missing).astype(np.uint8))
            new = missing & (seen > 0)
            np.copyto(values, own, where=new[..., None])
            valid[new], label[new] = 1, i + 1

    def _combine(
        self,
        ground: BlockGround,
        near: Sequence[int],
        target: tuple[AnyArray, ByteArray, AnyArray],
        lattices: Lattices,
    ) -> None:
        values, valid, label = target
        pulled = self._pulled(ground, near, valid, label, lattices)
        if self.rule == "count":
            for _, _, seen in pulled:
                values[..., 0] += seen
        elif self.rule in ("min", "max"):
            _extreme(np.minimum if self.rule == "min" else np.maximum, pulled, values, valid)
        elif self.rule == "median":
            _median(list(pulled), values)
        else:
            _sum(pulled, values, mean=self.rule == "mean")

    def _pulled(
        self, ground: BlockGround, near: Sequence[int], valid: ByteArray, label: AnyArray, lattices: Lattices
    ) -> Iterator[Layer]:
        """Images one after the other; label and validity follow after each was used: rules look at those before it."""
        info = self.photos.info
        for i in near:
            own, seen = np.zeros((*valid.shape, info.bands), dtype=info.dtype), np.zeros_like(valid)
            lattices[i] = self._pull(i, ground, own, seen, None)
            here = seen > 0
            if not here.any():
                continue
            yield i, own, here
            label[here & (valid == 0)] = i + 1
            valid |= seen

    def _pull(
        self, index: int, ground: BlockGround, out: AnyArray, seen: ByteArray, need: ByteArray | None
    ) -> list[Lattice]:
        with self.photos.using(index) as photo:
            return self.rectifier.fill(photo, ground, self.colours[index], Target(out, seen, need))


def _extreme(choose: np.ufunc, pulled: Iterator[Layer], values: AnyArray, valid: ByteArray) -> None:
    for _, own, seen in pulled:
        before = valid > 0
        np.copyto(values, own, where=(seen & ~before)[..., None])
        choose(values, own, out=values, where=(seen & before)[..., None])


def _sum(pulled: Iterator[Layer], values: AnyArray, *, mean: bool) -> None:
    """Sums in 64 bits: those of integers of up to 32 bits are exact."""
    total, count = np.zeros(values.shape), np.zeros(values.shape[:2])
    for _, own, seen in pulled:
        np.add(total, own, out=total, where=seen[..., None])
        count += seen
    if mean:
        total /= np.maximum(count, 1.0)[..., None]
    values[:] = _to_sample_type(total, values)


def _median(pulled: Sequence[Layer], values: AnyArray) -> None:
    """Median of the images that show a pixel; of an even number, the mean of the middle two."""
    if not pulled:
        return
    stack = np.full((len(pulled), *values.shape), np.inf)
    for layer, (_, own, seen) in zip(stack, pulled, strict=True):
        np.copyto(layer, own, where=seen[..., None])
    stack.sort(axis=0)  # missing values, infinite, come last
    count = np.sum([seen for _, _, seen in pulled], axis=0)
    low, high = np.maximum(count - 1, 0) // 2, np.minimum(count // 2, len(pulled) - 1)
    middle = [np.take_along_axis(stack, place[None, ..., None], axis=0)[0] for place in (low, high)]
    seen_by_any = (count > 0)[..., None]
    # Halved before they are added: the sum of two large numbers would overflow.
    mean = np.where(seen_by_any, middle[0], 0.0) / 2 + np.where(seen_by_any, middle[1], 0.0) / 2
    np.copyto(values, _to_sample_type(mean, values), where=seen_by_any)


def _to_sample_type(exact: AnyArray, values: AnyArray) -> AnyArray:
    """Values in the sample type of the output: integers rounded half up and clipped to the range."""
    low, high, whole = value_range(str(values.dtype))
    return (np.clip(np.floor(exact + 0.5), low, high) if whole else exact).astype(values.dtype)
