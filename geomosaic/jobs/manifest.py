"""Manifest of the last run: what steps read, wrote, found and warned of, as whole JSON files."""

from __future__ import annotations

import json
import math
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from geomosaic.errors import GeomosaicWarning
from geomosaic.whole_files import write_atomic

FORMAT = 1


@dataclass(frozen=True)
class Record:
    """The last run of a step.

    Attributes
    ----------
    ingredients : mapping
        What the result depends on, with digests.
    outputs : mapping
        Name of each file and its SHA-256.
    facts : mapping
        What the step returned.
    seconds : float
    finished : str
        ISO 8601, UTC.
    """

    ingredients: Mapping[str, str]
    outputs: Mapping[str, str]
    facts: Mapping[str, Any]
    seconds: float
    finished: str


@dataclass
class Manifest:
    """Records by step, the outputs that are ours to replace, and the hashes of files."""

    path: Path
    records: dict[str, Record] = field(default_factory=dict)
    owned: set[str] = field(default_factory=set)
    hashes: dict[str, list[Any]] = field(default_factory=dict)

    @classmethod
    def load(cls, path: Path) -> Manifest:
        """Read the manifest; one that is absent, damaged or of another format is empty: everything is stale then."""
        try:
            values = json.loads(path.read_text(encoding="utf-8"))
            if values["format"] != FORMAT:
                return cls(path)
            records = {name: Record(**record) for name, record in values["records"].items()}
            return cls(path, records, set(values["owned"]), dict(values["hashes"]))
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            return cls(path)

    def save(self) -> None:
        """Write the manifest under a temporary name and rename it."""
        values = {
            "format": FORMAT,
            "records": {name: asdict(record) for name, record in self.records.items()},
            "owned": sorted(self.owned),
            "hashes": self.hashes,
        }
        write_atomic(self.path, json.dumps(values, indent=1, ensure_ascii=False))


def write_json(path: Path, values: Any) -> None:
    """Write JSON; NaN and infinity, which JSON does not know, become null."""
    write_atomic(path, json.dumps(plain(values), indent=1, ensure_ascii=False, allow_nan=False) + "\n")


def read_json(path: Path) -> Any:
    """Read JSON that a step has written."""
    return json.loads(path.read_text(encoding="utf-8"))


def plain(value: Any) -> Any:
    """Values that JSON knows."""
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, bool) or value is None or isinstance(value, int | str):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if hasattr(value, "tolist"):
        return plain(value.tolist())
    return str(value)


@contextmanager
def heard() -> Iterator[list[str]]:
    """List the texts of GeomosaicWarnings raised within, each once; all go on to whoever showed them before."""
    texts: list[str] = []
    before = warnings.showwarning

    def show(message: Warning | str, category: type[Warning], *where: Any, **how: Any) -> None:
        if issubclass(category, GeomosaicWarning) and str(message) not in texts:
            texts.append(str(message))
        before(message, category, *where, **how)

    warnings.showwarning = show
    try:
        yield texts
    finally:
        warnings.showwarning = before


def tell(text: str) -> None:
    """Show a note that is a result, not a doubt: filters that make errors of warnings leave it alone."""
    warnings.showwarning(GeomosaicWarning(text), GeomosaicWarning, __file__, 0)
