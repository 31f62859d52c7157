"""What matching found before, kept by the content of the images, so that nothing is matched twice."""

from __future__ import annotations

import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np

from geomosaic.digests import digest_of
from geomosaic.errors import OutputError
from geomosaic.types import AnyArray
from geomosaic.whole_files import under_construction

Arrays = Mapping[str, AnyArray]


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
        if self._folder is None:
            return make()
        name = digest_of(*key)
        path = self._folder / name[:2] / f"{name}.npz"
        try:
            # Opened here: NumPy leaves a file open that is no archive.
            with path.open("rb") as file, np.load(file, allow_pickle=False) as kept:
                arrays = {each: kept[each] for each in kept.files}
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
