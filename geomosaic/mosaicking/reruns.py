"""Results and units of an earlier run of the same mosaic, reused where nothing they depend on has changed.

A unit of the output depends on the images near it, their models and corrections, the heights below, and the parts of
the seam polygons and footprints that lie within reach of its seams. All that goes into its key. Where the key is known
from the run that made the present files, the compressed tiles are taken from those, and the bytes of the new files are
the same as if they had been computed.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import geomosaic
from geomosaic.digests import digest_of, source_digest
from geomosaic.errors import GeomosaicError
from geomosaic.geo.grid import Window
from geomosaic.mosaicking.blending.block import Blender
from geomosaic.mosaicking.colour.corrections import Correction
from geomosaic.mosaicking.result_cache import EarlierRun, ResultCache
from geomosaic.mosaicking.seams.kept_subdomains import KeptSubdomains
from geomosaic.mosaicking.seams.seamlines import SeamQuality, Segment, measure_seams
from geomosaic.options.declaration import stage_values
from geomosaic.radiometry.corrections import CorrectionField, ToneCurve
from geomosaic.radiometry.gain_offset import Balance
from geomosaic.render.photos import Photos
from geomosaic.whole_files import write_atomic

if TYPE_CHECKING:
    from geomosaic.mosaicking.blending.rules import RuleBlender
    from geomosaic.mosaicking.colour.stretch import Stretch
    from geomosaic.options.mosaic import MosaicOptions


LOSSLESS = ("NONE", "DEFLATE", "ZSTD", "LZW", "PACKBITS", "LZMA")

Fact = tuple[float, float]


@dataclass(frozen=True)
class KeptUnit:
    """Unit whose pixels are those of the earlier run.

    Attributes
    ----------
    window : Window
    counts, facts
        As in `MosaicUnit`.
    """

    window: Window
    counts: Counter[int]
    facts: list[Fact]


class UnitKeys:
    """Digests of all that windows of a mosaic depend on.

    Parameters
    ----------
    earlier_run : EarlierRun
        Digests of images and ground.
    blender : Blender or RuleBlender
    options : MosaicOptions
        All of the stages 'geometry' and 'blending' go into the key; those of others show in seams and colours.
    water : str
        Fingerprint of water that is filled with a tone.
    """

    def __init__(
        self, earlier_run: EarlierRun, blender: Blender | RuleBlender, options: MosaicOptions, water: str = ""
    ) -> None:
        self._earlier_run, self._blender = earlier_run, blender
        info, grid = blender.info, blender.grid
        # The label of what no image sees comes after those of all images.
        hidden = len(blender.photos) if options.render.true_ortho else None
        self._base = "|".join(
            [
                geomosaic.__version__, deciding_code(), earlier_run.ground, blender.dtype, str(info.bands),
                grid.crs.to_wkt(),
                repr(tuple(grid.transform)), repr(grid.shape), repr(options.render.tile), blender.fingerprint,
                str(hidden), water, *(repr(stage_values(options, stage)) for stage in ("geometry", "blending")),
            ]
        )  # fmt: skip
        self._keys: dict[Window, str] = {}

    def key(self, window: Window) -> str:
        """Digest of all that a window depends on."""
        if window not in self._keys:
            self._keys[window] = self._key(window)
        return self._keys[window]

    def _key(self, window: Window) -> str:
        import shapely

        blender = self._blender
        reach, step = blender.reach, 1e-3 * blender.grid.resolution[0]
        around = window.grown(reach)
        frame = shapely.box(*blender.grid.crop(around).bounds)
        parts: list[Any] = [self._base, str(window)]
        for i in blender.photos.near(around if blender.uses_neighbours else window):
            outline = blender.photos.outlines[i]
            # Centres decide who fills gaps; their last digits may differ from run to run.
            centre = [round(v / step) for v in outline.centre]
            parts += [i, self._earlier_run.scenes[i], centre, blender.rank(i), _colour_bytes(blender.colours[i])]
            for shape in blender.shapes(i):
                part = shapely.intersection(shape, frame)
                # A border whose far end has changed is the same here but for rounding: thousandths of pixels count.
                part = shapely.transform(part, lambda xy: np.round(xy / step))
                parts.append(shapely.to_wkb(shapely.normalize(part)))
        return digest_of(*parts)


class Reuse:
    """Units of an earlier run by their keys.

    Parameters
    ----------
    earlier_run : EarlierRun
    keys : UnitKeys
    files : mapping of str to Path
        Rasters of the earlier run, which the new ones replace; `mosaic`, and perhaps `labels` and `views`.
    """

    def __init__(self, earlier_run: EarlierRun, keys: UnitKeys, files: dict[str, Path]) -> None:
        self._earlier_run, self._keys, self._files = earlier_run, keys, files
        self.views = False
        """Whether the earlier views are at hand."""
        self._known = self._load()
        self._kept: dict[str, Any] = {}
        self.taken: set[Window] = set()

    def _load(self) -> dict[str, Any]:
        """Units of the earlier run; none where the files are not those of that run."""
        try:
            kept = json.loads(self._earlier_run.file.read_text())
            # Files that were edited or replaced since that run hold other pixels than its keys say.
            same = {
                name: name in kept and path.is_file() and kept[name] == self._earlier_run.digest(path)
                for name, path in self._files.items()
            }
            if not all(same[name] for name in same if name != "views"):
                return {}
            self.views = same.get("views", False)
            return dict(kept["units"])
        except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError, GeomosaicError):
            return {}

    def forget(self) -> None:
        """Units of the earlier run dropped: all are computed anew."""
        self._known = {}

    def left(self, windows: Sequence[Window]) -> int:
        """Number of these units that have to be computed."""
        return sum(self._keys.key(window) not in self._known for window in windows)

    def kept(self, window: Window) -> KeptUnit | None:
        """Unit of the earlier run; None where it has to be computed."""
        key = self._keys.key(window)
        known = self._known.get(key)
        if known is None:
            return None
        self._kept[key] = known
        self.taken.add(window)
        counts = Counter({int(label): number for label, number in known["counts"].items()})
        return KeptUnit(window, counts, [(float(e), float(s)) for e, s in known["facts"]])

    def add(self, window: Window, counts: Counter[int], facts: list[Fact]) -> None:
        """Unit that was computed, for the next run."""
        shown = {str(label): number for label, number in sorted(counts.items())}  # JSON has text as keys only
        self._kept[self._keys.key(window)] = {"counts": shown, "facts": facts}

    def save(self) -> None:
        """Keys of this run written for the next."""
        kept: dict[str, Any] = {name: self._earlier_run.digest(path) for name, path in self._files.items()}
        kept["units"] = self._kept
        write_atomic(self._earlier_run.file, json.dumps(kept))


def deciding_code() -> str:
    """Digest of the source of all that makes a mosaic, for keys: pixels and what is found on the way to them."""
    return source_digest("geomosaic.mosaicking.mosaic")


def reuse_of(
    options: MosaicOptions, earlier_run: EarlierRun | None, keys: UnitKeys | None, files: dict[str, Path]
) -> Reuse | None:
    """Reuse of the units of an earlier run, where it is possible.

    Parameters
    ----------
    options : MosaicOptions
    earlier_run : EarlierRun or None
        Of the earlier run.
    keys : UnitKeys or None
    files : dict of str to Path
        Rasters of the earlier run, as in `Reuse`.

    Returns
    -------
    Reuse or None
        None without an earlier run, and where lossy compression has changed the values in the files.
    """
    compression = options.render.creation.get("COMPRESS", "DEFLATE").upper()
    if earlier_run is None or keys is None or compression not in LOSSLESS:
        return None
    return Reuse(earlier_run, keys, files)


def _colour_bytes(colour: Correction) -> bytes:
    """Bytes of all that decides what a correction does, for keys: equal where corrections are equal to the bit."""
    if isinstance(colour, ToneCurve):
        return b"".join(x.tobytes() + y.tobytes() for x, y in colour.knots) + repr(colour.slope).encode()
    if isinstance(colour, CorrectionField):
        return colour.digest()
    return bytes(colour.gain.tobytes() + colour.offset.tobytes())


class EarlierResults:
    """Results of an earlier run, each under the digest of all that it depends on.

    Parameters
    ----------
    photos : Photos
    options : MosaicOptions
    earlier_run : EarlierRun, optional
        Without it everything is computed.
    """

    def __init__(self, photos: Photos, options: MosaicOptions, earlier_run: EarlierRun | None = None) -> None:
        grid = photos.grid
        self._options, self._earlier_run = options, earlier_run
        self.recall = ResultCache(None if earlier_run is None else earlier_run.found)
        place = (grid.crs.to_wkt(), tuple(grid.transform), grid.shape)
        self._place = "" if earlier_run is None else digest_of(
            geomosaic.__version__, deciding_code(), earlier_run.ground, *place, photos.info.dtype
        )  # fmt: skip
        self._base = "" if earlier_run is None else digest_of(self._place, *earlier_run.scenes)

    def balance(self, compute: Callable[[], Balance]) -> Balance:
        """Balance of all photos, excluded or not, before any manual edit."""
        earlier_run, options = self._earlier_run, self._options
        settings = (options.balanced, options.colours.histogram, options.colours.master, options.colours.colour)
        key = "" if earlier_run is None else digest_of(self._base, earlier_run.colour, *settings)
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
        """Computed seam polygons of images with the valid outlines `shapes`.

        Parameters
        ----------
        shapes : sequence of object
        colours : sequence of Correction
        compute : callable
            Called where nothing earlier fits.
        """
        import shapely

        earlier_run = self._earlier_run
        if earlier_run is None:
            return compute()
        drawn = [shapely.to_wkb(shape) for shape in shapes]
        # Corrections count as well: seams of least cost compare images as they will be seen.
        key = digest_of(self._base, earlier_run.seams, *drawn, *(_colour_bytes(colour) for colour in colours))
        known = self.recall.get("seams", key, lambda: [shapely.to_wkb(share, hex=True) for share in compute()])
        return [shapely.from_wkb(bytes.fromhex(text)) for text in known]

    def subdomains(self, shapes: Sequence[Any], colours: Sequence[Correction]) -> KeptSubdomains | None:
        """Seams of the subdomains of a large block, each kept as soon as it is laid; None without an earlier run.

        Parameters
        ----------
        shapes : sequence of Polygon or MultiPolygon
            Outlines of the images between which seams are laid.
        colours : sequence of Correction
        """
        import shapely

        run = self._earlier_run
        if run is None:
            return None
        images = [
            digest_of(scene, shapely.to_wkb(shape), _colour_bytes(colour))
            for scene, shape, colour in zip(run.scenes, shapes, colours, strict=True)
        ]
        return KeptSubdomains(self.recall, digest_of(self._place, run.seams), images)

    def judged(self, blender: Blender, parts: Sequence[Segment]) -> list[SeamQuality]:
        """Quality of each seam segment; segments between unchanged images are not measured again."""
        earlier_run, render = self._earlier_run, self._options.render
        if earlier_run is None:
            return measure_seams(blender, parts, render)
        settings = (self._base, render.resampling, render.tolerance)
        keys = [_key(settings, blender, part) for part in parts]
        known = self.recall.table("seam-quality")
        new = [k for k, key in enumerate(keys) if key not in known]
        found = dict(zip(new, measure_seams(blender, [parts[k] for k in new], render), strict=True))
        if len(new) < len(parts):
            self.recall.from_cache.append(f"{len(parts) - len(new)} of {len(parts)} pieces of seams")
        quality = [found[k] if k in found else known[key] for k, key in enumerate(keys)]
        self.recall.keep("seam-quality", dict(zip(keys, quality, strict=True)))
        return quality


def _key(settings: tuple[Any, ...], blender: Blender, part: Segment) -> str:
    import shapely

    # Thousandths of pixels: an overlay far away may move vertices in their last digits.
    step = 1e-3 * blender.grid.resolution[0]
    line = shapely.to_wkb(shapely.transform(part.line, lambda xy: np.round(xy / step)))
    pair = (part.first, part.second)
    return digest_of(*settings, pair, line, *(_colour_bytes(blender.colours[i]) for i in pair))
