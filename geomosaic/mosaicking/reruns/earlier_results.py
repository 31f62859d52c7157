"""Results of an earlier run of the same mosaic: colour balance, stretch, seams and their quality."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

import geomosaic
from geomosaic.digests import digest_of
from geomosaic.mosaicking.blending.block import Blender
from geomosaic.mosaicking.colour.corrections import Correction
from geomosaic.mosaicking.reruns.memory import Memory, ResultCache
from geomosaic.mosaicking.reruns.reuse import colour_bytes
from geomosaic.mosaicking.seams.seamlines import SeamQuality, Segment, measure_seams
from geomosaic.radiometry.gain_offset import Balance
from geomosaic.render.photos import Photos

if TYPE_CHECKING:
    from geomosaic.mosaicking.colour.stretch import Stretch
    from geomosaic.options.mosaic import MosaicOptions


VERSION = 2
"""Raised when the code finds something else."""


class EarlierResults:
    """Results of an earlier run, each under the digest of all that it depends on.

    Parameters
    ----------
    photos : Photos
    options : MosaicOptions
    memory : Memory, optional
        Without it everything is computed.
    """

    def __init__(self, photos: Photos, options: MosaicOptions, memory: Memory | None = None) -> None:
        grid = photos.grid
        self._options, self._memory = options, memory
        self.recall = ResultCache(None if memory is None else memory.found)
        place = (grid.crs.to_wkt(), tuple(grid.transform), grid.shape)
        self._base = "" if memory is None else digest_of(
            geomosaic.__version__, VERSION, *memory.scenes, memory.ground, *place, photos.info.dtype
        )  # fmt: skip

    def balance(self, compute: Callable[[], Balance]) -> Balance:
        """Balance of all photos, excluded or not, before any manual edit."""
        memory, options = self._memory, self._options
        settings = (options.balanced, options.colours.histogram, options.colours.master, options.colours.colour)
        key = "" if memory is None else digest_of(self._base, memory.colour, *settings)
        found = self.recall.get("balance", key, compute)
        # Stretch, seams and their quality come after the balance, and depend on it.
        self._base = digest_of(self._base, key)
        return found

    def stretch(self, compute: Callable[[], Stretch]) -> Stretch:
        """Stretch of the balanced photos."""
        return self.recall.get("stretch", digest_of(self._base, self._options.samples.stretch), compute)

    def shares(
        self, shapes: Sequence[Any], colours: Sequence[Correction], compute: Callable[[], list[Any]]
    ) -> list[Any]:
        """Computed seam polygons of images with the valid outlines `shapes`."""
        import shapely

        memory = self._memory
        if memory is None:
            return compute()
        drawn = [shapely.to_wkb(shape) for shape in shapes]
        # Corrections count as well: seams of least cost compare images as they will be seen.
        key = digest_of(self._base, memory.seams, *drawn, *(colour_bytes(colour) for colour in colours))
        known = self.recall.get("seams", key, lambda: [shapely.to_wkb(share, hex=True) for share in compute()])
        return [shapely.from_wkb(bytes.fromhex(text)) for text in known]

    def judged(self, blender: Blender, parts: Sequence[Segment]) -> list[SeamQuality]:
        """Quality of each seam segment; segments between unchanged images are not measured again."""
        memory, render = self._memory, self._options.render
        if memory is None:
            return measure_seams(blender, parts, render)
        settings = (self._base, render.resampling, render.tolerance)
        keys = [_key(settings, blender, part) for part in parts]
        known = self.recall.table("seam-quality")
        new = [k for k, key in enumerate(keys) if key not in known]
        found = dict(zip(new, measure_seams(blender, [parts[k] for k in new], render), strict=True))
        if len(new) < len(parts):
            self.recall.recalled.append(f"{len(parts) - len(new)} of {len(parts)} pieces of seams")
        quality = [found[k] if k in found else known[key] for k, key in enumerate(keys)]
        self.recall.keep("seam-quality", dict(zip(keys, quality, strict=True)))
        return quality


def _key(settings: tuple[Any, ...], blender: Blender, part: Segment) -> str:
    import shapely

    # Thousandths of pixels: an overlay far away may move vertices in their last digits.
    step = 1e-3 * blender.grid.resolution[0]
    line = shapely.to_wkb(shapely.transform(part.line, lambda xy: np.round(xy / step)))
    pair = (part.first, part.second)
    return digest_of(*settings, pair, line, *(colour_bytes(blender.colours[i]) for i in pair))
