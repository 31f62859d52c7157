"""Units of an earlier run of the same mosaic, for those whose ingredients are the same.

A unit of the output depends on the images near it, their models and corrections, the heights below, and the parts of
the shares and footprints that lie within reach of its seams. All that goes into its key. Where the key is known from
the run that made the files at hand, the compressed tiles are taken from those, and the bytes of the new ones are the
same as if they had been computed.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import geomosaic
from geomosaic.digests import digest_of, sha256
from geomosaic.errors import GeomosaicError
from geomosaic.geo.grid import Window
from geomosaic.mosaicking.blending.block import Blender
from geomosaic.mosaicking.colour.corrections import Correction
from geomosaic.mosaicking.unit import MosaicUnit
from geomosaic.options.render import RenderOptions
from geomosaic.radiometry.histogram_matching import Curve
from geomosaic.radiometry.local_gains import Shade
from geomosaic.types import IntArray
from geomosaic.whole_files import write_atomic

if TYPE_CHECKING:
    from geomosaic.options.mosaic import MosaicOptions


VERSION = 5
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
        Digest of the surface, and of all else that every pixel depends on.
    colour, seams : str
        Digest of what the balance depends on besides, and what the program's own seams do.
    digest : callable
        SHA-256 of a file, perhaps remembered.
    """

    file: Path
    scenes: Sequence[str]
    ground: str
    colour: str = ""
    seams: str = ""
    digest: Callable[[Path], str] = sha256

    @property
    def found(self) -> Path:
        """Folder of what else was found."""
        return self.file.with_name("found")


@dataclass(frozen=True)
class KeptUnit:
    """A unit that is as it was.

    Attributes
    ----------
    window : Window
    counts, facts
        As in `MosaicUnit`.
    """

    window: Window
    counts: IntArray
    facts: list[Fact]


class Reuse:
    """Keys of all units, and those of the earlier run.

    Parameters
    ----------
    memory : Memory
    blender : Blender
    files : mapping of str to Path
        Rasters of the earlier run, which the new ones replace; `mosaic`, and perhaps `labels` and `views`.
    render : RenderOptions
    said : str
        What else all pixels depend on.
    """

    def __init__(
        self, memory: Memory, blender: Blender, files: dict[str, Path], render: RenderOptions, said: str = ""
    ) -> None:
        self._memory, self._blender, self._files = memory, blender, files
        info, grid = blender.photos.info, blender.grid
        hidden = len(blender.photos) if render.true_ortho else None  # their label comes after those of all images
        self._base = "|".join(
            [
                f"{geomosaic.__version__} {VERSION}", memory.ground, blender.dtype, str(info.bands), grid.crs.to_wkt(),
                repr(tuple(grid.transform)), repr(grid.shape), render.resampling, repr(render.tolerance),
                repr(render.tile), repr(blender.seams.feather), str(render.true_ortho), blender.said, render.driver,
                repr(render.nodata), str(hidden), json.dumps(dict(render.creation), sort_keys=True),
                said,
            ]
        )  # fmt: skip
        self.views = False
        """Whether the earlier views are at hand."""
        self._known = self._load()
        self._keys: dict[Window, str] = {}
        self._kept: dict[str, Any] = {}
        self.taken: set[Window] = set()

    def _load(self) -> dict[str, Any]:
        """What was kept of the files at hand; nothing where they are not those that it was kept of."""
        try:
            kept = json.loads(self._memory.file.read_text())
            same = {
                name: name in kept and path.is_file() and kept[name] == self._memory.digest(path)
                for name, path in self._files.items()
            }
            if not all(same[name] for name in same if name != "views"):
                return {}
            self.views = same.get("views", False)
            return dict(kept["units"])
        except (OSError, ValueError, KeyError, TypeError, AttributeError, GeomosaicError):
            return {}

    def forget(self) -> None:
        """Take nothing over."""
        self._known = {}

    def left(self, windows: Sequence[Window]) -> int:
        """How many of these units are not known."""
        return sum(self.key(window) not in self._known for window in windows)

    def key(self, window: Window) -> str:
        """Digest of all that a unit depends on."""
        if window not in self._keys:
            self._keys[window] = self._key(window)
        return self._keys[window]

    def _key(self, window: Window) -> str:
        import shapely

        blender = self._blender
        reach, step = blender.reach, 1e-3 * blender.grid.resolution[0]
        around = Window(window.col - reach, window.row - reach, window.width + 2 * reach, window.height + 2 * reach)
        frame = shapely.box(*blender.grid.crop(around).bounds)
        parts: list[Any] = [self._base, str(window)]
        for i in blender.photos.near(around if blender.wide else window):
            outline = blender.photos.outlines[i]
            # Centres say who fills gaps; their last digits may differ from run to run.
            centre = [round(v / step) for v in outline.centre]
            parts += [i, self._memory.scenes[i], centre, colour_bytes(blender.colours[i])]
            for shape in (blender.seams.regions[i], blender.seams.outlines[i]):
                part = shapely.intersection(shape, frame)
                # A border that is cut elsewhere is the same here but for its last digits: thousandths of pixels count.
                part = shapely.transform(part, lambda xy: np.round(xy / step))
                parts.append(shapely.to_wkb(shapely.normalize(part)))
        return digest_of(*parts)

    def unit(self, window: Window, compute: Callable[[Window], MosaicUnit]) -> KeptUnit | MosaicUnit:
        """A unit, as it was where it is known."""
        key = self.key(window)
        known = self._known.get(key)
        if known is None:
            made = compute(window)
            counts = {str(i): int(made.counts[i]) for i in np.flatnonzero(made.counts)}
            self._kept[key] = {"counts": counts, "facts": made.facts}
            return made
        self._kept[key] = known
        self.taken.add(window)
        counted = np.zeros(len(self._blender.photos) + 2, dtype=np.int64)
        for i, number in known["counts"].items():
            counted[int(i)] = number
        return KeptUnit(window, counted, [(float(e), float(s)) for e, s in known["facts"]])

    def save(self) -> None:
        """Keep the keys of this run for the next."""
        kept: dict[str, Any] = {name: self._memory.digest(path) for name, path in self._files.items()}
        kept["units"] = self._kept
        write_atomic(self._memory.file, json.dumps(kept))


def reuse_of(
    options: MosaicOptions, memory: Memory | None, blender: Blender, files: dict[str, Path], said: str = ""
) -> Reuse | None:
    """Units of the earlier run, where there is a memory and files hold what was computed."""
    compression = options.render.creation.get("COMPRESS", "DEFLATE").upper()
    if memory is None or compression not in LOSSLESS:
        return None
    return Reuse(memory, blender, files, options.render, said)


def colour_bytes(colour: Correction) -> bytes:
    """All that decides what a correction does."""
    if isinstance(colour, Curve):
        return b"".join(x.tobytes() + y.tobytes() for x, y in colour.knots) + repr(colour.slope).encode()
    if isinstance(colour, Shade):
        return colour.digest()
    return bytes(colour.gain.tobytes() + colour.offset.tobytes())
