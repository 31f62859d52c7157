"""Mosaics by rule: each pixel the first, last, least, greatest, mean, median value or the number of images."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from geomosaic.geo.grid import Grid, Window
from geomosaic.mosaicking.blending.block import Lattices, cells_of
from geomosaic.mosaicking.unit import MosaicUnit
from geomosaic.radiometry.histogram_matching import Curve
from geomosaic.radiometry.local_gains import Shade
from geomosaic.raster.info import SourceInfo
from geomosaic.render.photo import pull
from geomosaic.render.photos import Photos
from geomosaic.resample.engine import Engine
from geomosaic.resample.warp import CELL, Colour, value_range
from geomosaic.sensor.lattice import Lattice
from geomosaic.sensor.map_to_image import BlockGround, Ground
from geomosaic.types import AnyArray, BoolArray, ByteArray

LABELLED = ("first", "last")
"""Rules under which every pixel has one source."""
MOST_BYTES = 32 << 20
"""Bytes of all images' values of the same ground, held at once for a median."""

Pulled = tuple[int, AnyArray, BoolArray]
"""Number of an image, its values (rows, cols, bands), and where they are valid (rows, cols)."""


def output_info(info: SourceInfo, rule: str) -> SourceInfo:
    """Bands and sample type that a rule gives.

    A count is one band of uint16. Sums of 8 and 16 bits are uint32 or int32, and others float64: nothing overflows.
    """
    if rule == "count":
        return replace(info, bands=1, dtype="uint16", descriptions=("images",))
    if rule == "sum":
        kind = np.dtype(info.dtype)
        small = {"u": "uint32", "i": "int32"}.get(kind.kind) if kind.itemsize < 4 else None
        return replace(info, dtype=small or "float64")
    return info


@dataclass(frozen=True)
class Ruler:
    """Renders blocks of a mosaic by rule; a block depends on nothing but itself.

    Attributes
    ----------
    photos : Photos
    grid : Grid
    below : Ground
    colours : sequence of Colour, Curve or Shade
    engine : Engine
    resampling : str
    tolerance : float
    rule : str
        One of `RULES`.
    order : sequence of int
        All images, the most wanted first.
    info : SourceInfo
        Bands and sample type of the output.
    """

    photos: Photos
    grid: Grid
    below: Ground
    colours: Sequence[Colour | Curve | Shade]
    engine: Engine
    resampling: str
    tolerance: float
    rule: str
    order: Sequence[int]
    info: SourceInfo

    @property
    def dtype(self) -> str:
        """Of the output."""
        return self.info.dtype

    def fill(self, window: Window, unit: MosaicUnit) -> None:
        """Render one block into its place in a unit."""
        around = set(self.photos.near(window))
        near = [i for i in self.order if i in around]
        if not near:
            return
        lattices: Lattices = {}
        rows_at_once = self._rows(window, len(near)) if self.rule == "median" else window.height
        for part in window.split(window.width, rows_at_once):
            ground = self.below.block(part)
            if ground.unknown:
                continue
            place = part.slices_in(unit.window)
            target = unit.values[place], unit.valid[place], unit.label[place]
            lattices = {}
            if self.rule in LABELLED:
                self._lay(ground, near if self.rule == "first" else near[::-1], target, lattices)
            else:
                self._combine(ground, near, target, lattices)
            unit.counts[:] += np.bincount(target[2].ravel(), minlength=len(unit.counts))
            unit.facts.extend((lattice.error, lattice.scale) for used in lattices.values() for lattice in used)

    def _rows(self, window: Window, images: int) -> int:
        """Rows of which the values of so many images may be held, in whole cells."""
        row = window.width * self.photos.info.bands * images * 8
        return min(window.height, max(CELL, MOST_BYTES // row // CELL * CELL))

    def _lay(
        self,
        ground: BlockGround,
        near: Sequence[int],
        target: tuple[AnyArray, ByteArray, AnyArray],
        lattices: Lattices,
    ) -> None:
        """Images one below the other: what is seen already stays."""
        values, valid, label = target
        for i in near:
            missing = valid == 0
            if not missing.any():
                break
            if missing.all():  # nothing to spoil
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
    ) -> Iterator[Pulled]:
        """Images one after the other; then, and not before, what each has seen is noted."""
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
            return pull(
                self.engine, photo, self.grid, ground, self.resampling, self.tolerance, self.colours[index], out, seen,
                need,
            )  # fmt: skip


def _extreme(choose: np.ufunc, pulled: Iterator[Pulled], values: AnyArray, valid: ByteArray) -> None:
    for _, own, seen in pulled:
        before = valid > 0
        np.copyto(values, own, where=(seen & ~before)[..., None])
        choose(values, own, out=values, where=(seen & before)[..., None])


def _sum(pulled: Iterator[Pulled], values: AnyArray, *, mean: bool) -> None:
    """Sums in 64 bits: those of whole numbers of up to 32 bits are exact."""
    total, count = np.zeros(values.shape), np.zeros(values.shape[:2])
    for _, own, seen in pulled:
        np.add(total, own, out=total, where=seen[..., None])
        count += seen
    if mean:
        total /= np.maximum(count, 1.0)[..., None]
    values[:] = _stored(total, values)


def _median(pulled: Sequence[Pulled], values: AnyArray) -> None:
    """Middle value, or the mean of the two in the middle, of the images that show a pixel."""
    if not pulled:
        return
    stack = np.full((len(pulled), *values.shape), np.inf)
    for layer, (_, own, seen) in zip(stack, pulled, strict=True):
        np.copyto(layer, own, where=seen[..., None])
    stack.sort(axis=0)  # what is not seen comes last
    count = np.sum([seen for _, _, seen in pulled], axis=0)
    low, high = np.maximum(count - 1, 0) // 2, np.minimum(count // 2, len(pulled) - 1)
    middle = [np.take_along_axis(stack, place[None, ..., None], axis=0)[0] for place in (low, high)]
    seen_by_any = (count > 0)[..., None]
    mean = np.where(seen_by_any, middle[0], 0.0) / 2 + np.where(seen_by_any, middle[1], 0.0) / 2
    np.copyto(values, _stored(mean, values), where=seen_by_any)


def _stored(exact: AnyArray, values: AnyArray) -> AnyArray:
    """As the output holds it: whole numbers rounded, halves up."""
    low, high, whole = value_range(str(values.dtype))
    return (np.clip(np.floor(exact + 0.5), low, high) if whole else exact).astype(values.dtype)
