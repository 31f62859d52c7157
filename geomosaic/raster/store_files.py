"""Objects of stores as files of GDAL: only the raster that is opened, what lies beside it, and what it is made of."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rasterio import _vsiopener
from rasterio.abc import MultiByteRangeResourceContainer

from geomosaic.stores.path import StorePath, to_path
from geomosaic.stores.reading import RangeReader

# rasterio keeps files that GDAL has opened by context, of which each thread has its own: here they are those of the
# process, as one thread closes what others have opened.
_open_files: dict[Any, Any] = {}


def share_open_files() -> None:
    """Let this thread close rasters of stores that other threads have opened."""
    _vsiopener._OPEN_FILE_EXIT_STACKS.set(_open_files)


class StoreFiles(MultiByteRangeResourceContainer):  # type: ignore[misc]
    """Files that GDAL may open for one raster.

    Its neighbours are listed once, where the store lists: GDAL asks for forty names beside a TIFF. Nothing else exists
    for it: names that a file holds lead nowhere.

    Parameters
    ----------
    raster : StorePath
    sources : sequence of Path
        Further files that it is made of, those of a virtual raster.
    """

    def __init__(self, raster: StorePath, sources: Sequence[Path] = ()) -> None:
        share_open_files()
        files: tuple[Path, ...] = (raster, *sources)
        self._sizes = {str(file): int(file.stat().st_size) for file in files}
        self._beside: dict[str, StorePath] = {str(file): file for file in raster.neighbours()}

    def _known(self, path: str) -> bool:
        return path in self._sizes or path in self._beside

    def isfile(self, path: str) -> bool:
        """Whether it is one of them."""
        return self._known(path)

    def isdir(self, path: str) -> bool:
        """Nothing is a folder."""
        return False

    def ls(self, path: str) -> list[str]:
        """Nothing is listed."""
        return []

    def mtime(self, path: str) -> int:
        """Time of the last change, seconds."""
        return int(to_path(path).stat().st_mtime) if self._known(path) else 0

    def size(self, path: str) -> int:
        """Bytes."""
        if path not in self._sizes and path in self._beside:
            self._sizes[path] = int(self._beside[path].stat().st_size)
        if path not in self._sizes:
            raise FileNotFoundError(path)
        return self._sizes[path]

    def rm(self, path: str) -> None:
        """Nothing is removed."""
        raise PermissionError(path)

    def open(self, path: str, mode: str = "r", **_: Any) -> RangeReader:
        """File that is read by ranges."""
        if not self._known(path) or set(mode) - set("rbt"):
            raise FileNotFoundError(path)
        file = to_path(path)
        assert isinstance(file, StorePath)
        return RangeReader(file.name_in_store, quiet=True)
