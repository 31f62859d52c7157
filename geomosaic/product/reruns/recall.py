"""What an earlier run has found, by the digest of all that it depends on.

Values are kept as JSON files, one per kind: plain values, arrays to the bit, tuples, and the dataclasses of `CLASSES`.
"""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Callable
from dataclasses import fields, is_dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

CLASSES = {
    "Footprint": "geomosaic.block.footprint",
    "Balance": "geomosaic.radiometry.gain_offset",
    "Curve": "geomosaic.radiometry.curve",
    "Shade": "geomosaic.radiometry.shade",
    "Fields": "geomosaic.radiometry.fields",
    "Setting": "geomosaic.radiometry.steps",
    "Trial": "geomosaic.radiometry.choose",
    "Stretch": "geomosaic.product.colour.stretch",
    "SeamQuality": "geomosaic.product.seams.quality",
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
        from geomosaic.raster.output import partial, remove

        path = self._folder / f"{kind}.json"
        self._folder.mkdir(parents=True, exist_ok=True)
        unfinished = partial(path)
        try:
            unfinished.write_text(json.dumps({key: encode(value) for key, value in values.items()}), encoding="utf-8")
            unfinished.replace(path)
        finally:
            remove(unfinished)


def digest_of(*parts: Any) -> str:
    """Digest of texts, bytes and arrays; of other things, their text."""
    digest = hashlib.sha256()
    for part in parts:
        data = (
            part if isinstance(part, bytes) else np.asarray(part).tobytes() if _is_array(part) else str(part).encode()
        )
        digest.update(len(data).to_bytes(8, "little") + data)
    return digest.hexdigest()


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
