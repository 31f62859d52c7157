"""What matching found before, kept by the content of the images, so that nothing is matched twice."""

from __future__ import annotations

import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from geomosaic.digests import digest_of
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

    def get(self, key: tuple[Any, ...], make: Callable[[], Arrays]) -> Arrays:
        """Arrays of a key, made where they are not there yet.

        Parameters
        ----------
        key : tuple
            All that they depend on: texts, numbers, arrays.
        make : callable
        """
        if self._folder is None:
            return make()
        name = digest_of(*key)
        path = self._folder / name[:2] / f"{name}.npz"
        try:
            with np.load(path, allow_pickle=False) as kept:
                arrays = {each: kept[each] for each in kept.files}
            return arrays
        except (OSError, ValueError, zipfile.BadZipFile):
            # Not there, or damaged by whatever happened to the disk: made again.
            pass
        arrays = dict(make())
        path.parent.mkdir(parents=True, exist_ok=True)
        with under_construction(path) as unfinished, unfinished.open("wb") as file:
            np.savez(file, **arrays)
        return arrays
