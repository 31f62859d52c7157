"""What a raster depends on besides its own bytes: files beside it, sources, and what they make it say of itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from geomosaic.raster.environment import environment
from geomosaic.raster.info import SourceInfo, describe, open_raster
from geomosaic.raster.local import named_files


@dataclass(frozen=True)
class Companions:
    """What a raster depends on besides its own bytes.

    Attributes
    ----------
    files : tuple of Path
        World files, mask files, headers, sources of a VRT: those that are there. Not .aux.xml: programs that only look
        at a raster keep statistics in it. Not .ovr of the raster itself: its pixels are read.
    said : SourceInfo
        CRS, transform, nodata, colours and all else that is known without reading a pixel, whatever file says it; its
        path is left empty.
    """

    files: tuple[Path, ...]
    said: SourceInfo


def companions(path: Path, bands: Sequence[int] | None = None) -> Companions:
    """Find what a raster depends on; no pixel is read.

    Raises
    ------
    RasterReadError
        The raster cannot be opened.
    """
    files, said = _opened(path, bands, (".aux.xml", ".ovr"))
    for source in named_files(path):
        # A VRT that scales its sources takes their overviews.
        files += [source, *_opened(source, None, (".aux.xml",))[0]]
    return Companions(tuple(dict.fromkeys(files)), said)


def _opened(path: Path, bands: Sequence[int] | None, without: tuple[str, ...]) -> tuple[list[Path], SourceInfo]:
    with environment(), open_raster(path) as dataset:
        names = [name for name in dataset.files if name != str(path) and not name.lower().endswith(without)]
        said = replace(describe(dataset, str(path), bands), path="")
    return [Path(name) for name in names if Path(name).is_file()], said
