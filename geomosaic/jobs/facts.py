"""What steps tell each other, as JSON files that are whole or absent."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

from geomosaic.project.atomic import write_atomic


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
