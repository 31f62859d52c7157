"""Checksums of files, read in pieces."""

from __future__ import annotations

import hashlib
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from geomosaic.errors import InputError
from geomosaic.raster.file_dependencies import holds, journal_of
from geomosaic.types import PathLike


def sha256(path: PathLike) -> str:
    """SHA-256 of a file's bytes as 64 hexadecimal digits, in constant memory.

    Raises
    ------
    InputError
        The file cannot be read.
    """
    try:
        with Path(path).open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror})", where=str(path)) from error


@dataclass
class Hashes:
    """SHA-256 of what files hold; a file of known size and modification time is not read again.

    Of a database that another program holds open, what stands in its journal counts too, see `raster.journal`.

    Attributes
    ----------
    known : dict
        Path to [size, mtime in ns, sha256].
    """

    known: dict[str, list[Any]] = field(default_factory=dict)

    def of(self, path: Path) -> str:
        """Digest of what a file holds.

        Raises
        ------
        InputError
            The file is missing or unreadable.
        """
        journal, beside = journal_of(path), ""
        if journal is not None and holds(journal):
            with suppress(InputError):  # it has just gone into the file, which is read after it
                beside = self._of(journal)
        digest = self._of(path)
        return hashlib.sha256(f"{digest} {beside}".encode()).hexdigest() if beside else digest

    def _of(self, path: Path) -> str:
        try:
            stat = path.stat()
        except OSError:
            raise InputError("the file does not exist", where=str(path), hint="check the path") from None
        entry = self.known.get(str(path))
        if entry and entry[0] == stat.st_size and entry[1] == stat.st_mtime_ns:
            return str(entry[2])
        digest = sha256(path)
        self.known[str(path)] = [stat.st_size, stat.st_mtime_ns, digest]
        return digest
