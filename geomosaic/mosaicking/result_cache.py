"""State of an earlier run: where its results are kept, and values as JSON.

One file for each kind: plain values, arrays to the bit, tuples, and the dataclasses of `CLASSES`.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, is_dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from geomosaic.digests import sha256
from geomosaic.whole_files import write_atomic

# Folder of results of parts of a stage, with which a run goes on that was stopped amid it.
PARTS = "parts"


@dataclass(frozen=True)
class EarlierRun:
    """Place of an earlier run's results, and digests of what they depend on.

    Attributes
    ----------
    file : Path
        JSON of the units; need not exist.
    scenes : sequence of str
        Digest of each image and its model.
    ground : str
        Digest of the surface, and of all else that every pixel depends on.
    colour, seams : str
        Digest of what else the balance depends on, and the computed seams.
    digest : callable
        SHA-256 of a file, perhaps cached.
    """

    file: Path
    scenes: Sequence[str]
    ground: str
    colour: str = ""
    seams: str = ""
    digest: Callable[[Path], str] = sha256

    @property
    def found(self) -> Path:
        """Folder of all other results."""
        return self.file.with_name("found")


# Dataclasses that may be kept, and where they are.
CLASSES = {
    "Footprint": "geomosaic.block",
    "Balance": "geomosaic.radiometry.gain_offset",
    "ToneCurve": "geomosaic.radiometry.corrections",
    "CorrectionField": "geomosaic.radiometry.corrections",
    "ColourModel": "geomosaic.radiometry.colour_model",
    "ColourSetting": "geomosaic.radiometry.normal_equations",
    "RadiometricChange": "geomosaic.radiometry.radiometric_change",
    "Trial": "geomosaic.radiometry.colour_model",
    "Stretch": "geomosaic.mosaicking.colour.stretch",
    "SeamQuality": "geomosaic.mosaicking.seams.seamlines",
}


Value = TypeVar("Value")


class ResultCache:
    """Results of an earlier run by kind and key.

    Parameters
    ----------
    folder : Path or None
        Made when needed; without it nothing is cached.
    """

    def __init__(self, folder: Path | None) -> None:
        self._folder = folder
        self.from_cache: list[str] = []

    def get(self, kind: str, key: str, compute: Callable[[], Value]) -> Value:
        """Result under a key, else what `compute` gives, which replaces it in the cache.

        Parameters
        ----------
        kind : str
        key : str
        compute : callable
            Called where the key is not known.
        """
        if self._folder is None:
            return compute()
        known: Value | None = self.table(kind).get(key)
        if known is not None:
            self.from_cache.append(kind)
            return known
        found = compute()
        self.keep(kind, {key: found})
        return found

    def table(self, kind: str) -> dict[str, Any]:
        """All results of a kind by key; empty where the file is missing or damaged."""
        if self._folder is None:
            return {}
        try:
            text = (self._folder / f"{kind}.json").read_text(encoding="utf-8")
            return {key: decode(value) for key, value in json.loads(text).items()}
        # A damaged file, or one of an older version, is no error: what it held is computed again.
        except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
            return {}

    def keep(self, kind: str, values: dict[str, Any]) -> None:
        """Results by key, kept in place of those before."""
        if self._folder is None:
            return
        values = {key: encode(value) for key, value in values.items()}
        write_atomic(self._folder / f"{kind}.json", json.dumps(values))


def encode(value: Any) -> Any:
    """JSON form of a value.

    Parameters
    ----------
    value : object
        None, number, text, array, list, tuple, frozenset, or a dataclass of `CLASSES`, nested in any way.

    Returns
    -------
    object
        Of what JSON knows: arrays as base64 of their bytes, so that they come back to the bit.

    Raises
    ------
    TypeError
        A value of a class that cannot be kept.
    """
    if value is None or (isinstance(value, (bool, int, float, str)) and not isinstance(value, np.generic)):
        return value
    if isinstance(value, np.generic):
        return encode(value.item())
    if isinstance(value, np.ndarray):
        data = base64.b64encode(np.ascontiguousarray(value).tobytes()).decode()
        return {"array": [value.dtype.str, list(value.shape), data]}
    if isinstance(value, list):
        return [encode(part) for part in value]
    if isinstance(value, tuple):
        return {"tuple": [encode(part) for part in value]}
    if isinstance(value, frozenset):
        # Sorted: equal sets make equal text.
        return {"set": sorted(value)}
    name = type(value).__name__
    if is_dataclass(value) and CLASSES.get(name) == type(value).__module__:
        return {"class": name, "fields": {part.name: encode(getattr(value, part.name)) for part in fields(value)}}
    raise TypeError(f"a {name} cannot be kept")


def decode(value: Any) -> Any:
    """Value of its JSON form, the inverse of `encode`.

    Parameters
    ----------
    value : object
        From `encode`.

    Returns
    -------
    object
        Arrays are copies that can be written to.

    Raises
    ------
    KeyError, TypeError, AttributeError
        The form of an older version, with classes or fields that are no more.
    """
    if isinstance(value, list):
        return [decode(part) for part in value]
    if not isinstance(value, dict):
        return value
    if "array" in value:
        kind, shape, data = value["array"]
        # Copied: arrays from a buffer cannot be written to.
        return np.frombuffer(base64.b64decode(data), dtype=kind).reshape(shape).copy()
    if "tuple" in value:
        return tuple(decode(part) for part in value["tuple"])
    if "set" in value:
        return frozenset(value["set"])
    # Only classes of the list above: a file must not choose what is imported.
    own = getattr(import_module(CLASSES[value["class"]]), value["class"])
    return own(**{name: decode(part) for name, part in value["fields"].items()})
