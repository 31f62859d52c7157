"""Units of an earlier run of the same mosaic, for those whose ingredients are the same.

A unit of the output depends on the images near it, their models and corrections, the heights below, and the parts of
the shares and footprints that lie within reach of its seams. All that goes into its key. Where the key is known from
the run that made the file at hand, the pixels are taken from that file, and the bytes of the new one are the same as if
they had been computed.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import geomosaic
from geomosaic.geo.grid import Window
from geomosaic.product.blend import Blender
from geomosaic.product.mosaic_unit import MosaicUnit
from geomosaic.radiometry.curve import Curve
from geomosaic.radiometry.shade import Shade
from geomosaic.raster.checksum import sha256
from geomosaic.raster.source import Source

VERSION = 2
"""Raised when the code gives other pixels."""
LOSSLESS = ("NONE", "DEFLATE", "ZSTD", "LZW", "PACKBITS", "LZMA")

Fact = tuple[float, float]


@dataclass(frozen=True)
class Memory:
    """Where the keys of a mosaic are kept, and what identifies its ingredients.

    Attributes
    ----------
    file : Path
        JSON; need not exist.
    scenes : sequence of str
        Digest of each image and its model.
    ground : str
        Digest of the surface.
    """

    file: Path
    scenes: Sequence[str]
    ground: str


class Reuse:
    """Keys of all units, those of the earlier run, and its pixels.

    Parameters
    ----------
    memory : Memory
    blender : Blender
    output, labels : Path
        Of the earlier run, which the new one replaces.
    said : str
        Everything that is the same for all units, as text.
    """

    def __init__(self, memory: Memory, blender: Blender, output: Path, labels: Path, said: str) -> None:
        self._memory, self._blender = memory, blender
        info, grid = blender.photos.info, blender.grid
        self._base = "|".join(
            [
                f"{geomosaic.__version__} {VERSION}", said, memory.ground, blender.dtype, str(info.bands),
                grid.crs.to_wkt(), repr(tuple(grid.transform)), repr(grid.shape),
            ]
        )  # fmt: skip
        self._known: dict[str, list[Fact]] = self._load(output, labels)
        self._sources = self._open(output, labels) if self._known else None
        self._facts: dict[str, list[Fact]] = {}
        self.taken = 0

    def _load(self, output: Path, labels: Path) -> dict[str, list[Fact]]:
        """Keys of the files at hand; none where they are not those that the keys were kept of."""
        try:
            kept = json.loads(self._memory.file.read_text())
            if kept["mosaic"] != sha256(output) or kept["labels"] != sha256(labels):
                return {}
            return {key: [(float(e), float(s)) for e, s in facts] for key, facts in kept["units"].items()}
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            return {}

    def _open(self, output: Path, labels: Path) -> tuple[Source, Source] | None:
        found, info = (Source(str(output)), Source(str(labels))), self._blender.photos.info
        if (found[0].info.bands, found[0].info.dtype) == (info.bands, self._blender.dtype):
            return found
        for source in found:
            source.close()
        return None

    def key(self, window: Window) -> str:
        """Digest of all that a unit depends on."""
        import shapely

        blender = self._blender
        reach, step = blender.reach, 1e-3 * blender.grid.resolution[0]
        around = Window(window.col - reach, window.row - reach, window.width + 2 * reach, window.height + 2 * reach)
        frame = shapely.box(*blender.grid.crop(around).bounds)
        digest = hashlib.sha256(f"{self._base}|{window}".encode())
        for i in blender.photos.near(around if blender.wide else window):
            outline = blender.photos.outlines[i]
            # Centres say who fills gaps; their last digits may differ from run to run.
            centre = [round(v / step) for v in outline.centre]
            digest.update(f"|{i} {self._memory.scenes[i]} {centre}".encode())
            digest.update(_colour(blender.colours[i]))
            for shape in (blender.seams.regions[i], blender.seams.outlines[i]):
                part = shapely.intersection(shape, frame)
                # A border that is cut elsewhere is the same here but for its last digits: thousandths of pixels count.
                part = shapely.transform(part, lambda xy: np.round(xy / step))
                digest.update(shapely.to_wkb(shapely.normalize(part)))
        return digest.hexdigest()

    def unit(self, key: str, window: Window) -> MosaicUnit | None:
        """Pixels of the earlier run, where it has them."""
        if key not in self._known or self._sources is None:
            return None
        (values, _), (labels, _) = (source.read(window) for source in self._sources)
        label = labels[..., 0]
        number = len(self._blender.photos)
        valid = ((label > 0) & (label <= number)).view(np.uint8)
        counts = np.bincount(label.ravel(), minlength=number + 2)
        return MosaicUnit(window, np.where(valid[..., None] > 0, values, 0), valid, label, counts, self._known[key])

    def made(self, key: str, facts: Sequence[Fact], *, taken: bool) -> None:
        """Note a unit of this run."""
        self._facts[key] = list(facts)
        self.taken += taken

    def close(self) -> None:
        """Close the earlier files."""
        for source in self._sources or ():
            source.close()
        self._sources = None

    def save(self, output: Path, labels: Path) -> None:
        """Keep the keys of this run for the next."""
        from geomosaic.raster.output import partial, remove

        kept: dict[str, Any] = {"mosaic": sha256(output), "labels": sha256(labels), "units": self._facts}
        self._memory.file.parent.mkdir(parents=True, exist_ok=True)
        unfinished = partial(self._memory.file)
        try:
            unfinished.write_text(json.dumps(kept))
            unfinished.replace(self._memory.file)
        finally:
            remove(unfinished)


def _colour(colour: Any) -> bytes:
    if isinstance(colour, Curve):
        return b"".join(x.tobytes() + y.tobytes() for x, y in colour.knots) + repr(colour.slope).encode()
    if isinstance(colour, Shade):
        return colour.digest()
    return bytes(colour.gain.tobytes() + colour.offset.tobytes())
