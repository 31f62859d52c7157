"""What every test shares: where the real data is, and the sample block."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="session")
def real_data() -> Callable[[str], Path]:
    """Folder of a real data set, or a skip that says why."""
    base = Path(os.environ.get("GEOMOSAIC_REAL_DATA") or ROOT.parent / "shared" / "data" / "real")

    def find(name: str) -> Path:
        folder = base / name
        if not folder.is_dir():
            pytest.skip(f"real data set '{name}' is not here ({base}); set GEOMOSAIC_REAL_DATA to its parent folder")
        return folder

    return find


@pytest.fixture(scope="session")
def sample() -> Path:
    """Folder of the sample block in the repository."""
    return ROOT / "data" / "sample"
