"""Workspace: a project as the page sees it, read anew from its files whenever they change."""

from __future__ import annotations

import json
import math
import threading
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from affine import Affine

from geomosaic.digests import digest_of
from geomosaic.errors import GeomosaicError, InputError
from geomosaic.geo.crs import horizontal
from geomosaic.geo.units import axis_unit
from geomosaic.jobs.manifest import Layout, recorded_warnings
from geomosaic.jobs.project import status_of
from geomosaic.project.load import Project, load_project
from geomosaic.raster.info import SourceInfo, inspect
from geomosaic.raster.vector import read_layer
from geomosaic.studio.base_map import base_map_facts
from geomosaic.studio.history import History
from geomosaic.studio.raster_tiles import RasterTiles


@dataclass(frozen=True)
class Layer:
    """Raster that the page can show.

    Attributes
    ----------
    id : str
        Name in addresses: a digest of the path, so that no request can name a file.
    name : str
    role : str
        'image', 'mosaic', 'before' (the mosaic before the last run), 'ortho', 'reference', 'dem' or 'sheet' (a map
        sheet that was printed as a GeoTIFF).
    path : Path
    """

    id: str
    name: str
    role: str
    path: Path


class Workspace:
    """Project of a studio, its rasters and the history of its edits.

    Parameters
    ----------
    path : Path
        Project file.
    """

    def __init__(self, path: Path) -> None:
        self.path = path.resolve()
        self.history = History()
        self.tiles = RasterTiles(self.raster)
        self._lock, self._hashing = threading.RLock(), threading.Lock()
        self._read: tuple[object, Project | None, list[dict[str, Any]]] = (None, None, [])
        self._folders: tuple[Path, ...] = (self.path.parent,)

    def close(self) -> None:
        """Close its files."""
        self.tiles.close()

    def project(self) -> Project | None:
        """Project as its file is now; None where that has errors, which `messages` tells."""
        return self._loaded()[0]

    def sound_project(self) -> Project:
        """Project as its file is now; an error where that has errors."""
        project = self.project()
        if project is None:
            raise InputError("the project file has errors", hint="see Messages")
        return project

    def image(self, layer: str) -> tuple[Project, Path]:
        """Project, and path of an image of it by the id of its layer; an error where there is none."""
        project, path = self.project(), self.raster(layer)
        if project is None or path is None or path not in project.images:
            raise InputError("there is no such image in the project", hint="load the page again")
        return project, path

    def messages(self) -> list[dict[str, Any]]:
        """Errors and notes of the project file: `kind` ('error', 'note'), `what`, `where`, `hint`."""
        return self._loaded()[1]

    def layers(self) -> tuple[Layer, ...]:
        """Rasters of the project that are there: its images, and what is made of them."""
        project = self.project()
        return () if project is None else tuple(_layers(project))

    def raster(self, layer: str) -> Path | None:
        """Path of a layer by its id; None where there is none."""
        return next((one.path for one in self.layers() if one.id == layer), None)

    def describe(self) -> dict[str, Any]:
        """Facts of the project for the page.

        Returns
        -------
        dict
            `name`, `file`, `crs` (WKT of the first georeferenced layer, None while there is none), `images`, `layers`,
            `messages` and `history`.
        """
        project, messages = self._loaded()
        found: dict[str, Any] = {
            "file": self.path.name,
            "name": self.path.stem,
            "crs": None,
            "images": [],
            "layers": [],
        }
        if project is not None:
            layout = Layout(project)
            aside = {*layout.set_aside, *project.set_aside}
            oriented = dict(zip(project.images, layout.models, strict=True))
            found["name"] = project.name
            for layer in _layers(project):
                facts = _facts(layer)
                if layer.role == "image":
                    facts["oriented"] = layer.path in oriented and oriented[layer.path].is_file()
                    facts["set_aside"] = layer.path in aside
                found["images" if layer.role == "image" else "layers"].append(facts)
            found["crs"] = next((one["crs"] for one in found["layers"] if one["crs"]), None)
        return {**found, "messages": messages, "history": self.history.titles}

    def base_map(self, layer: str) -> dict[str, Any] | None:
        """Base map under the map of a georeferenced layer; None where the project names none.

        Parameters
        ----------
        layer : str
            By its id.
        """
        project, path = self.project(), self.raster(layer)
        info = None if path is None else inspect(path)
        if project is None or info is None or info.crs is None or info.transform is None:
            return None
        t, (width, height) = info.transform, info.size
        return base_map_facts(project, horizontal(info.crs), (t.c, t.f + height * t.e, t.c + width * t.a, t.f))

    def steps(self) -> list[dict[str, Any]]:
        """Steps of the project, whether each is fresh or why it is stale; the first call reads all inputs.

        Returns
        -------
        list of dict
            As `geomosaic status --json` has them; empty where the project file has errors.
        """
        project = self.project()
        if project is None:
            return []
        # Hashing may take long: nobody else waits for it but who asks for the same.
        with self._hashing:
            states = status_of(project)
        return [{**asdict(state), "changed": [path.name for path in state.changed]} for state in states]

    def outlines(self) -> dict[str, Any]:
        """Footprints and seamlines of the mosaic in its CRS, as GeoJSON by layer; empty without a mosaic."""
        project = self.project()
        path = None if project is None else Layout(project).vectors
        if path is None or not path.is_file():
            return {}
        found = {}
        for name in ("footprints", "seamlines"):
            frame = read_layer(path, name)
            shown = frame[[column for column in ("image", "first", "second") if column in frame] + ["geometry"]]
            found[name] = json.loads(shown.to_json(drop_id=True))
        return found

    def feature_files(self) -> list[Path]:
        """GeoPackages beside the project file, in which features are drawn."""
        return sorted(self.path.parent.glob("*.gpkg"))

    def layout_files(self) -> list[Path]:
        """TOML files beside the project file, layouts of sheets among them."""
        return sorted(self.path.parent.glob("*.toml"))

    def watched(self) -> list[Path]:
        """Files, and folders of images, whose changes the page is told of."""
        project = self.project()
        if project is None:
            return [self.path, *self.feature_files(), *self.layout_files()]
        layout = Layout(project)
        files = [
            *self.feature_files(),
            *self.layout_files(),
            self.path,
            *project.roles.values(),
            *(file for part in project.blocks for file in part.tables),
        ]
        files += [*project.images, *(image.parent for image in project.images)]
        files += [
            layout.mosaic,
            layout.vectors,
            *layout.models,
            *layout.ties,
            *layout.adjustment[:2],
            *(layout.orthos if project.settings.output.orthos else ()),
            *layout.georeferenced,
            *layout.sheets,
        ]
        files += [layout.facts(name) for name in ("match", "orient", "mosaic", "check")]
        return list(dict.fromkeys(files))

    def _loaded(self) -> tuple[Project | None, list[dict[str, Any]]]:
        """Project and messages of the file as it is."""
        with self._lock:
            state = self._state()
            if self._read[0] != state:
                project, messages = _load(self.path)
                if project is not None:
                    self._folders = tuple(dict.fromkeys(image.parent for image in project.images))
                # As they were before: what changed while they were read is read by the next call.
                self._read = {path: state.get(path, now) for path, now in self._state().items()}, project, messages
            return self._read[1], self._read[2]

    def _state(self) -> dict[Path, tuple[int, int] | None]:
        """Stamps of the project file, and of the folders that had its images when it last had no errors."""
        return {path: file_stamp(path) for path in (self.path, *self._folders)}


def kept_mosaic(project: Project) -> Path:
    """Mosaic as it was before the last run of the studio, for comparison; it need not be there.

    Parameters
    ----------
    project : Project
    """
    return project.state / "studio" / "before.tif"


def version_of(path: Path) -> str | None:
    """Version of a file, which changes with it; None where there is none.

    Parameters
    ----------
    path : Path
    """
    stamp = file_stamp(path)
    return None if stamp is None else f"{stamp[0]:x}-{stamp[1]:x}"


def _load(path: Path) -> tuple[Project | None, list[dict[str, Any]]]:
    try:
        with recorded_warnings() as notes:
            project = load_project(path)
    except GeomosaicError as error:
        where = (error.where or "").replace(f"{path.parent}/", "")
        return None, [{"kind": "error", "what": error.what, "where": where, "hint": error.hint}]
    return project, [{"kind": "note", "what": note, "where": None, "hint": None} for note in notes]


def file_stamp(path: Path) -> tuple[int, int] | None:
    """Time (ns) and size (bytes) of a file, which change when it is written; None where there is none.

    Parameters
    ----------
    path : Path
    """
    try:
        found = path.stat()
    except (OSError, ValueError):
        return None
    return found.st_mtime_ns, found.st_size


def _layers(project: Project) -> Iterator[Layer]:
    for image in (*project.images, *project.set_aside):
        yield _layer(image, image.name, "image")
    layout = Layout(project)
    made = [(layout.mosaic, project.name, "mosaic"), (kept_mosaic(project), "Before the last run", "before")]
    made += [(path, path.stem, "ortho") for path in layout.orthos]
    made += [(path, f"{path.stem}, by its control", "ortho") for path in layout.georeferenced]
    reference = project.quality.quality_reference
    matched = None if project.matching is None else project.matching.reference
    made += [(path, path.name, "reference") for path in dict.fromkeys((reference, matched)) if path is not None]
    made += [
        (path, path.name, "dem") for path in dict.fromkeys(part.dem for part in project.blocks) if path is not None
    ]
    made += [(path, path.stem, "sheet") for path in layout.sheets]
    yield from (_layer(path, name, role) for path, name, role in made if path.is_file())


def _layer(path: Path, name: str, role: str) -> Layer:
    return Layer(digest_of(role, str(path))[:16], name, role, path)


def _facts(layer: Layer) -> dict[str, Any]:
    """Facts of a layer; of one that cannot be read, what is wrong with it."""
    found: dict[str, Any] = {"id": layer.id, "name": layer.name, "role": layer.role, "crs": None, "error": None}
    found["version"] = version_of(layer.path)
    stamp = file_stamp(layer.path)
    info = _inspected(str(layer.path), stamp) if stamp is not None else None
    if info is None:
        return {**found, "error": "the file is gone"}
    if isinstance(info, str):
        return {**found, "error": info}
    t = info.transform
    return {
        **found,
        "width": info.width, "height": info.height, "bands": info.bands, "dtype": info.dtype,
        "crs": None if info.crs is None else info.crs.to_wkt(),
        "map_crs": None if info.crs is None else horizontal(info.crs).to_wkt(),
        "crs_name": None if info.crs is None else horizontal(info.crs).name,
        "affine": None if t is None else list(t)[:6],
        "on_map": info.crs is not None and t is not None and _plain(t),
        "geographic": info.crs is not None and horizontal(info.crs).is_geographic,
        "metres_per_unit": 1.0 if info.crs is None else axis_unit(horizontal(info.crs)),
    }  # fmt: skip


def _plain(t: Affine) -> bool:
    """Whether pixels are squares with north up, as tiles of a map must be."""
    return bool(t.b == t.d == 0 and t.a > 0 and math.isclose(t.a, -t.e, rel_tol=1e-9))


@lru_cache(maxsize=4096)
def _inspected(path: str, stamp: tuple[int, int]) -> SourceInfo | str:
    """Metadata of a raster as it was at that time, or what is wrong with it."""
    try:
        return inspect(path)
    except GeomosaicError as error:
        return error.what
