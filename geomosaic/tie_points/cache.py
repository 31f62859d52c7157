"""What matching found before, kept by the content of the images, so that nothing is matched twice."""

from __future__ import annotations

import os
import zipfile
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np

from geomosaic.digests import digest_of
from geomosaic.errors import OutputError
from geomosaic.types import AnyArray
from geomosaic.whole_files import under_construction

Arrays = Mapping[str, AnyArray]

# Bytes that are kept of earlier runs: features and pairs of some 4,000 photos.
KEPT = 4_000_000_000


class Cache:
    """Arrays by what they were made of.

    Parameters
    ----------
    folder : Path, optional
        None keeps nothing.
    """

    def __init__(self, folder: Path | None) -> None:
        self._folder = folder
        self._writing = Lock()
        self._used: set[Path] = set()

    @property
    def names(self) -> frozenset[str] | None:
        """Names of all that is kept; None where nothing is."""
        return None if self._folder is None else frozenset(path.stem for path in self._folder.glob("*/*.npz"))

    def get(self, key: tuple[Any, ...], make: Callable[[], Arrays]) -> Arrays:
        """Arrays of a key, made where they are not there yet.

        Parameters
        ----------
        key : tuple
            All that they depend on: texts, numbers, arrays.
        make : callable

        Raises
        ------
        OutputError
            The folder cannot be made or written, or the disk is full.
        """
        return make() if self._folder is None else self.named(digest_of(*key), make)

    def named(self, name: str, make: Callable[[], Arrays]) -> Arrays:
        """Arrays of a name, made where they are not there yet; see `get`.

        Parameters
        ----------
        name : str
            Digest of the key.
        make : callable
        """
        if self._folder is None:
            return make()
        path = self._folder / name[:2] / f"{name}.npz"
        self._used.add(path)
        try:
            # Opened here: NumPy leaves a file open that is no archive.
            with path.open("rb") as file, np.load(file, allow_pickle=False) as kept:
                arrays = {each: kept[each] for each in kept.files}
            with suppress(OSError):  # a folder that cannot be written is read all the same
                os.utime(path)
            return arrays
        except (OSError, EOFError, ValueError, zipfile.BadZipFile):
            # Not there, or damaged by whatever happened to the disk: made again.
            pass
        arrays = dict(make())
        # One at a time: images of one content have one key, and threads one name for the unfinished file.
        with self._writing:
            try:
                path.parent.mkdir(parents=True, exist_ok=True)
            except OSError as error:
                what, hint = f"{self._folder} cannot be made ({error.strerror})", "give the path of a folder"
                raise OutputError(what, where="`cache`", hint=hint) from error
            with under_construction(path) as unfinished, unfinished.open("wb") as made:
                np.savez(made, **arrays)
        return arrays

    def trim(self, most: int = KEPT) -> None:
        """Remove what was not asked for, least recently used first, until the rest is small enough.

        Parameters
        ----------
        most : int
            Bytes. What this cache was asked for stays, however large.
        """
        if self._folder is None:
            return
        files = []
        for path in self._folder.glob("*/*.npz"):
            with suppress(OSError):  # another run removed it
                known = path.stat()
                files.append((known.st_mtime_ns, known.st_size, path))
        total = sum(size for _, size, _ in files)
        for _, size, path in sorted(files):
            if total <= most:
                return
            if path not in self._used:
                with suppress(OSError):
                    path.unlink()
                total -= size
