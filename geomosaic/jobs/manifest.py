"""What the last run of each step read and wrote; a JSON file that is whole or absent."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from geomosaic.project.atomic import write_atomic

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
