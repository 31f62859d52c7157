"""What has been saved to a database that another program holds open, and stands beside it until that closes it.

QGIS keeps GeoPackages open: an edit that is saved there is in SQLite's journal, which readers see, long before it is
in the file itself.
"""

from __future__ import annotations

from pathlib import Path

KINDS = (".gpkg", ".sqlite", ".db", ".mbtiles")


def journal_of(path: Path) -> Path | None:
    """Where SQLite's journal of a file would be; None for files of other kinds.

    Journals of the older kind (`-journal`) need not be looked at: with them the file itself holds what was saved.
    """
    return path.with_name(f"{path.name}-wal") if path.suffix.lower() in KINDS else None


def holds(journal: Path) -> bool:
    """Whether a journal is there and not empty."""
    try:
        return journal.stat().st_size > 0
    except OSError:  # it goes when the other program closes the file, perhaps at this moment
        return False
