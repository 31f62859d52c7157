"""Text files that are whole or absent, whatever happens."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

from geomosaic.errors import OutputError


def write_atomic(path: Path, text: str) -> None:
    """Write a text file under a temporary name, flush it to the disk and rename it.

    Raises
    ------
    OutputError
        The folder cannot be made or written, or the disk is full.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with temporary.open("w", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    except BaseException as error:
        with suppress(OSError):
            temporary.unlink()
        if isinstance(error, OSError):
            raise OutputError(
                f"cannot be written: {error.strerror}", where=str(path), mend="check free space and permissions"
            ) from error
        raise
