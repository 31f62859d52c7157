"""Four photos of the sample, the flags that place them, and the command line in a process of its own."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

PHOTOS = ("strip1_02.jpg", "strip1_03.jpg", "strip2_02.jpg", "strip2_03.jpg")
PLACE = ("--res", "1", "--bounds", "399850", "5499850", "400250", "5500150")


def flags(block: Path, **change: object) -> list[str]:
    """Flags of the block, some of them changed or (None) left out."""
    given = {
        "sensor": "frame",
        "camera": block / "camera.toml",
        "exterior": block / "exterior.csv",
        "crs": "EPSG:32633",
        "heights": "egm96",
        "dem": block / "dem.tif",
    } | change
    return [
        word
        for name, value in given.items()
        if value is not None
        for word in (f"--{name.replace('_', '-')}", str(value))
    ]


def photos(block: Path) -> list[str]:
    return [str(block / "photos" / name) for name in PHOTOS]


def elsewhere(*words: object, **more: object) -> subprocess.CompletedProcess[str]:
    """Run the command line in a process of its own."""
    command = [sys.executable, "-m", "geomosaic.cli", *map(str, words)]
    return subprocess.run(command, check=False, capture_output=True, text=True, timeout=300, **more)
