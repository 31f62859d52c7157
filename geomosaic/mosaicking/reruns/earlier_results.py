"""Earlier results of a mosaic: colour, stretch, seams and their quality, by the digest of all they depend on.

Values are kept as JSON files, one per kind: plain values, arrays to the bit, tuples, and the dataclasses of `CLASSES`.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Callable, Sequence
from dataclasses import fields, is_dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

import geomosaic
from geomosaic.digests import digest_of
from geomosaic.mosaicking.blending.block import Blender
from geomosaic.mosaicking.colour.corrections import Correction
from geomosaic.mosaicking.reruns.reuse import Memory, colour_bytes
from geomosaic.mosaicking.seams.seamlines import SeamQuality, Segment, measure_seams
from geomosaic.radiometry.gain_offset import Balance
from geomosaic.render.photos import Photos
from geomosaic.whole_files import write_atomic

if TYPE_CHECKING:
    from geomosaic.mosaicking.colour.stretch import Stretch
    from geomosaic.options.mosaic import MosaicOptions


CLASSES = {
    "Footprint": "geomosaic.block.footprint",
    "Balance": "geomosaic.radiometry.gain_offset",
    "Curve": "geomosaic.radiometry.histogram_matching",
    "Shade": "geomosaic.radiometry.local_gains",
    "Fields": "geomosaic.radiometry.fields",
    "Setting": "geomosaic.radiometry.normal_equations",
    "Trial": "geomosaic.radiometry.model_selection",
    "Stretch": "geomosaic.mosaicking.colour.stretch",
    "SeamQuality": "geomosaic.mosaicking.seams.seamlines",
}
"""Dataclasses that may be kept, and where they are."""

Value = TypeVar("Value")


class Recall:
    """Values of an earlier run.

    Parameters
    ----------
    folder : Path or None
        Made when needed; without it nothing is recalled.
    """

    def __init__(self, folder: Path | None) -> None:
        self._folder = folder
        self.recalled: list[str] = []

    def get(self, kind: str, key: str, find: Callable[[], Value]) -> Value:
        """What was found under a key, else what `find` gives, which is kept in its place."""
        if self._folder is None:
            return find()
        known: Value | None = self.table(kind).get(key)
        if known is not None:
            self.recalled.append(kind)
            return known
        found = find()
        self.keep(kind, {key: found})
        return found

    def table(self, kind: str) -> dict[str, Any]:
        """All that is kept of a kind, by key; nothing where the file is not whole."""
        if self._folder is None:
            return {}
        try:
            text = (self._folder / f"{kind}.json").read_text(encoding="utf-8")
            return {key: decode(value) for key, value in json.loads(text).items()}
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            return {}

    def keep(self, kind: str, values: dict[str, Any]) -> None:
        """Keep values by key in place of those before."""
        if self._folder is None:
            return
        values = {key: encode(value) for key, value in values.items()}
        write_atomic(self._folder / f"{kind}.json", json.dumps(values))


def encode(value: Any) -> Any:
    """A value as JSON knows it.

    Raises
    ------
    TypeError
        Nothing that can be kept.
    """
    if value is None or (isinstance(value, (bool, int, float, str)) and not isinstance(value, np.generic)):
        return value
    if isinstance(value, np.generic):
        return encode(value.item())
    if _is_array(value):
        data = base64.b64encode(np.ascontiguousarray(value).tobytes()).decode()
        return {"array": [value.dtype.str, list(value.shape), data]}
    if isinstance(value, list):
        return [encode(part) for part in value]
    if isinstance(value, tuple):
        return {"tuple": [encode(part) for part in value]}
    if isinstance(value, frozenset):
        return {"set": sorted(value)}
    name = type(value).__name__
    if is_dataclass(value) and CLASSES.get(name) == type(value).__module__:
        return {"class": name, "fields": {part.name: encode(getattr(value, part.name)) for part in fields(value)}}
    raise TypeError(f"a {name} cannot be kept")


def decode(value: Any) -> Any:
    """The value that `encode` has made JSON of."""
    if isinstance(value, list):
        return [decode(part) for part in value]
    if not isinstance(value, dict):
        return value
    if "array" in value:
        kind, shape, data = value["array"]
        return np.frombuffer(base64.b64decode(data), dtype=kind).reshape(shape).copy()
    if "tuple" in value:
        return tuple(decode(part) for part in value["tuple"])
    if "set" in value:
        return frozenset(value["set"])
    own = getattr(import_module(CLASSES[value["class"]]), value["class"])
    return own(**{name: decode(part) for name, part in value["fields"].items()})


def _is_array(value: Any) -> bool:
    return isinstance(value, np.ndarray)


VERSION = 2
"""Raised when the code finds something else."""


class Earlier:
    """Everything has a key: the digest of all that it depends on.

    Parameters
    ----------
    photos : Photos
    options : MosaicOptions
    memory : Memory, optional
        Without it nothing is recalled.
    """

    def __init__(self, photos: Photos, options: MosaicOptions, memory: Memory | None = None) -> None:
        grid = photos.grid
        self._options, self._memory = options, memory
        self.recall = Recall(None if memory is None else memory.found)
        place = (grid.crs.to_wkt(), tuple(grid.transform), grid.shape)
        self._base = "" if memory is None else digest_of(
            geomosaic.__version__, VERSION, *memory.scenes, memory.ground, *place, photos.info.dtype
        )  # fmt: skip

    def balance(self, find: Callable[[], Balance]) -> Balance:
        """The balance: of all photos, left out or not, before any is touched up."""
        memory, wanted = self._memory, self._options
        said = (wanted.balanced, wanted.colours.histogram, wanted.colours.master, wanted.colours.colour)
        key = "" if memory is None else digest_of(self._base, memory.colour, *said)
        found = self.recall.get("balance", key, find)
        self._base = digest_of(self._base, key)
        return found

    def stretch(self, find: Callable[[], Stretch]) -> Stretch:
        """The stretch of the balanced photos."""
        return self.recall.get("stretch", digest_of(self._base, self._options.samples.stretch), find)

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
            return measure_seams(blender, parts, render)
        said = (self._base, render.resampling, render.tolerance)
        keys = [_key(said, blender, part) for part in parts]
        known = self.recall.table("seam-quality")
        new = [k for k, key in enumerate(keys) if key not in known]
        found = dict(zip(new, measure_seams(blender, [parts[k] for k in new], render), strict=True))
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
