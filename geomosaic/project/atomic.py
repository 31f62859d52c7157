"""Text files that are whole or absent, whatever happens."""

from __future__ import annotations

from pathlib import Path

from geomosaic.errors import OutputError
from geomosaic.raster.unfinished import under_construction


def write_atomic(path: Path, text: str) -> None:
    """Write a text file in place of one that may be there, and make its folder.

    Raises
    ------
    OutputError
        The folder cannot be made or written, or the disk is full.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(
            f"cannot be written: {error.strerror}", where=str(path), mend="check free space and permissions"
        ) from error
    with under_construction(path) as unfinished:
        unfinished.write_text(text, encoding="utf-8")
