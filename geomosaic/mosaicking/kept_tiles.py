"""Tiles of an earlier run, finished or not, that are kept where nothing they depend on has changed.

Beside the tiles stands a record of each: the key of all that it was made from, its pixel counts, and the digests of its
files. It is written after them, by whoever wrote them. A run that was stopped at any moment, by any signal, thus goes
on with what is missing.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from geomosaic.block import OrientedBlock
from geomosaic.digests import digest_of, sha256
from geomosaic.errors import GeomosaicError
from geomosaic.execution.packing import packed
from geomosaic.geo.grid import Window
from geomosaic.mosaicking.outputs import MosaicFiles
from geomosaic.mosaicking.reruns import Fact
from geomosaic.mosaicking.result_cache import EarlierRun
from geomosaic.options.declaration import paths_of, stage_values
from geomosaic.options.mosaic import MosaicOptions
from geomosaic.raster.files import Hashes
from geomosaic.raster.info import companions
from geomosaic.stores.path import to_path
from geomosaic.whole_files import write_atomic


@dataclass(frozen=True)
class Tile:
    """Tile of a mosaic, a unit of work for workers that write it themselves.

    Attributes
    ----------
    window : Window
        Its place in the mosaic.
    files : MosaicFiles
    key : str
        Digest of all that its files depend on.
    """

    window: Window
    files: MosaicFiles
    key: str

    @property
    def record(self) -> Path:
        """Record of the tile as it was written."""
        return self.files.mosaic.parent / MosaicFiles.STATE / f"{self.files.mosaic.stem}.json"


@dataclass(frozen=True)
class WrittenTile:
    """Tile as it was written.

    Attributes
    ----------
    key : str
        See `Tile`.
    counts : dict of int to int
        Pixels by label, see `MosaicUnit`, without zeros.
    facts : list of (error, scale)
        Largest error of its lattices in pixels and their median scale; empty where no image lies near.
    files : dict of str to list
        Size, modification time (ns) and SHA-256 of each file by its name; empty where the tile shows nothing.
    """

    key: str
    counts: dict[int, int]
    facts: list[Fact]
    files: dict[str, list[Any]]

    def save(self, tile: Tile) -> None:
        """Record of the tile for another run."""
        write_atomic(tile.record, json.dumps(asdict(self)))

    @classmethod
    def of(cls, tile: Tile) -> WrittenTile | None:
        """The tile as an earlier run wrote it; None where it did not, from other inputs, or where a file has changed.

        Parameters
        ----------
        tile : Tile
        """
        try:
            kept = json.loads(tile.record.read_text(encoding="utf-8"))
            found = cls(
                str(kept["key"]),
                {int(label): int(number) for label, number in kept["counts"].items()},
                [(float(error), float(scale)) for error, scale in kept["facts"]],
                dict(kept["files"]),
            )
            wanted = [path for path in (tile.files.mosaic, tile.files.labels) if path is not None and found.files]
            hashes = Hashes({str(path): found.files[path.name] for path in wanted})
            same = all(hashes.of(path) == found.files[path.name][2] for path in wanted)
        # A missing or damaged record is no error: the tile is rendered.
        except (OSError, ValueError, KeyError, TypeError, AttributeError, IndexError, RecursionError, GeomosaicError):
            return None
        return found if same and found.key == tile.key else None


def file_facts(path: Path) -> list[Any]:
    """Size, modification time (ns) and SHA-256 of a file that was just written.

    Parameters
    ----------
    path : Path
    """
    state = path.stat()
    return [state.st_size, state.st_mtime_ns, sha256(path)]


def earlier_run_in(files: MosaicFiles, block: OrientedBlock, options: MosaicOptions) -> EarlierRun:
    """State of a mosaic in tiles, which is kept in their folder.

    Files count by name, size and modification time: to read all of them again would take as long as a part of the
    mosaic. Results do not depend on what is kept, only on what is computed again.

    Parameters
    ----------
    files : MosaicFiles
    block : OrientedBlock
    options : MosaicOptions

    Returns
    -------
    EarlierRun
    """
    scenes = []
    for scene in block.scenes:
        masks = () if scene.clouds is None else (to_path(scene.clouds.path),)
        beside = companions(to_path(scene.path), scene.bands).files
        scenes.append(digest_of(packed(scene), *_states((to_path(scene.path), *beside, *masks))))
    surface = block.surface
    ground = [packed(surface), *_states(_files_of_surface(surface))]
    # As in projects: files of colours and seams show in these, those of records change no pixel.
    apart = ("colour", "seams", "edits", "records")
    others = set(paths_of(options)) - set(paths_of(options, apart))
    ground += [stage_values(options, "all"), *_states(sorted(others))]
    colour, seams = (
        digest_of(stage_values(options, stage), *_states(paths_of(options, (stage,)))) for stage in ("colour", "seams")
    )
    return EarlierRun(files.state / "units.json", scenes, digest_of(*ground), colour, seams)


def _files_of_surface(surface: Any) -> Iterator[Path]:
    """Rasters that heights and their standard deviations are read from."""
    for one in (surface, getattr(surface, "sigma", None)):
        path = getattr(one, "path", "")
        if path:
            yield to_path(path)
            yield from companions(to_path(path)).files


def _states(paths: Iterable[Path]) -> list[Any]:
    """Name, size and modification time of files."""
    found = []
    for path in paths:
        try:
            state = path.stat()
            found.append([str(path), state.st_size, state.st_mtime_ns])
        except OSError:
            found.append([str(path)])
    return found
