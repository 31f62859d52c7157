"""File dependencies of rasters and databases: sidecars, sources of a VRT, journals; only files of this machine.

QGIS keeps GeoPackages open: an edit that is saved there is in SQLite's journal, which readers see, long before it is
in the file itself.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from geomosaic.digests import digest_of, sha256
from geomosaic.errors import InputError

KINDS = (".gpkg", ".sqlite", ".db", ".mbtiles")


def journal_of(path: Path) -> Path | None:
    """Path of the write-ahead journal of an SQLite database.

    Journals of the older kind (`-journal`) need not be looked at: with them the file itself holds what was saved.

    Parameters
    ----------
    path : Path

    Returns
    -------
    Path or None
        None for files of other kinds.
    """
    return path.with_name(f"{path.name}-wal") if path.suffix.lower() in KINDS else None


def holds(journal: Path) -> bool:
    """Whether a journal is there and not empty.

    Parameters
    ----------
    journal : Path

    Returns
    -------
    bool
    """
    try:
        return journal.stat().st_size > 0
    except OSError:  # it goes when the other program closes the file, perhaps at this moment
        return False


@dataclass
class Hashes:
    """SHA-256 of what files hold; a file of known size and modification time is not read again.

    Of a database that another program holds open, what stands in its journal counts too, see `journal_of`.

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
        return digest_of(digest, beside) if beside else digest

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
