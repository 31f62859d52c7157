"""What a mosaic takes from an earlier run besides its pixels: colour, stretch, seams, and the judgement of seams."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

import geomosaic
from geomosaic.product.blend.block import Blender
from geomosaic.product.colour.corrections import Correction
from geomosaic.product.photos import Photos
from geomosaic.product.reruns.recall import Recall, digest_of
from geomosaic.product.reruns.reuse import colour_bytes
from geomosaic.product.seams.quality import SeamQuality, judge_seams
from geomosaic.radiometry.gain_offset import Balance
from geomosaic.seam.lines import Segment

if TYPE_CHECKING:
    from geomosaic.product.colour.stretch import Stretch
    from geomosaic.product.mosaic_options import MosaicOptions

VERSION = 2
"""Raised when the code finds something else."""


class Earlier:
    """Everything has a key: the digest of all that it depends on.

    Parameters
    ----------
    photos : Photos
    options : MosaicOptions
        Without a memory nothing is recalled.
    """

    def __init__(self, photos: Photos, options: MosaicOptions) -> None:
        memory, grid = options.memory, photos.grid
        self._options, self._memory = options, memory
        self.recall = Recall(None if memory is None else memory.found)
        place = (grid.crs.to_wkt(), tuple(grid.transform), grid.shape)
        self._base = "" if memory is None else digest_of(
            geomosaic.__version__, VERSION, *memory.scenes, memory.ground, *place, photos.info.dtype
        )  # fmt: skip

    def balance(self, find: Callable[[], Balance]) -> Balance:
        """The balance: of all photos, left out or not, before any is touched up."""
        memory, wanted = self._memory, self._options
        said = (wanted.balance, wanted.histogram, wanted.master, wanted.colour)
        key = "" if memory is None else digest_of(self._base, memory.colour, *said)
        found = self.recall.get("balance", key, find)
        self._base = digest_of(self._base, key)
        return found

    def stretch(self, find: Callable[[], Stretch]) -> Stretch:
        """The stretch of the balanced photos."""
        return self.recall.get("stretch", digest_of(self._base, self._options.stretch), find)

    def shares(self, shapes: Sequence[Any], colours: Sequence[Correction], find: Callable[[], list[Any]]) -> list[Any]:
        """Shares as the program lays them among images that show `shapes`."""
        import shapely

        memory = self._memory
        if memory is None:
            return find()
        drawn = [shapely.to_wkb(shape) for shape in shapes]
        key = digest_of(self._base, memory.seams, *drawn, *(colour_bytes(colour) for colour in colours))
        known = self.recall.get("seams", key, lambda: [shapely.to_wkb(share, hex=True) for share in find()])
        return [shapely.from_wkb(bytes.fromhex(text)) for text in known]

    def judged(self, blender: Blender, parts: Sequence[Segment]) -> list[SeamQuality]:
        """The judgement of each piece of a seam; those that are as they were are not looked at again."""
        memory, render = self._memory, self._options.render
        if memory is None:
            return judge_seams(blender, parts, render)
        said = (self._base, render.resampling, render.tolerance)
        keys = [_key(said, blender, part) for part in parts]
        known = self.recall.table("seam-quality")
        new = [k for k, key in enumerate(keys) if key not in known]
        found = dict(zip(new, judge_seams(blender, [parts[k] for k in new], render), strict=True))
        if len(new) < len(parts):
            self.recall.recalled.append(f"{len(parts) - len(new)} of {len(parts)} pieces of seams")
        quality = [found[k] if k in found else known[key] for k, key in enumerate(keys)]
        self.recall.keep("seam-quality", dict(zip(keys, quality, strict=True)))
        return quality


def _key(said: tuple[Any, ...], blender: Blender, part: Segment) -> str:
    import shapely

    step = 1e-3 * blender.grid.resolution[0]
    line = shapely.to_wkb(shapely.transform(part.line, lambda xy: np.round(xy / step)))
    pair = (part.first, part.second)
    return digest_of(*said, pair, line, *(colour_bytes(blender.colours[i]) for i in pair))
