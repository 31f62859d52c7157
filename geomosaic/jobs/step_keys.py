"""Step keys: everything a result depends on, with files beside rasters and code of sensor plugins."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from functools import lru_cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from geomosaic.digests import digest_of
from geomosaic.errors import GeomosaicError
from geomosaic.project.load import Project
from geomosaic.raster.file_dependencies import companions
from geomosaic.sensor.plugin import HasFiles
from geomosaic.sensor.registry import installed, plugin

LIBRARIES = ("geomosaic", "numpy", "numba", "scipy", "rasterio", "pyproj", "shapely")
"""What can change the bytes of a result."""


@lru_cache
def versions() -> dict[str, str]:
    """Installed versions of the libraries that matter."""
    found = {}
    for name in LIBRARIES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "absent"
    return found


def ingredients(
    name: str, step_version: int, parameters: Mapping[str, Any], files: Mapping[str, str]
) -> dict[str, str]:
    """Everything a step's result depends on, each with its digest, so that a change can be named."""
    parts = {"step": f"{name} {step_version}"}
    parts |= {f"parameter {key}": digest_of(value) for key, value in parameters.items()}
    parts |= {f"file {path}": digest for path, digest in files.items()}
    parts |= {f"library {library}": found for library, found in versions().items()}
    return parts


def with_companions(
    project: Project, rasters: Sequence[Path], bands: Sequence[int] | None = None
) -> tuple[tuple[Path, ...], dict[str, str]]:
    """Rasters and the files beside them that count, and a digest of what each says of itself, under words for people.

    A world file or a mask that comes, goes or changes makes a step stale, statistics in a .aux.xml do not. A raster
    that cannot be opened has nothing beside it; the step that reads it says what is wrong.
    """
    files: dict[Path, None] = {}
    said: dict[str, str] = {}
    for raster in rasters:
        files[raster] = None
        try:
            found = companions(raster, bands)
        except GeomosaicError:
            continue
        files.update(dict.fromkeys(found.files))
        name = raster.relative_to(project.folder) if raster.is_relative_to(project.folder) else raster
        said[f"georeference or kind of {name.as_posix()}"] = digest_of(asdict(found.said))
    return tuple(files), said


def plugin_versions(sensor: str) -> dict[str, str]:
    """Version of the distribution that a sensor comes from; geomosaic's own counts for every step already."""
    return {
        f"version of {entry.distribution}": entry.version
        for entry in installed()
        if entry.name == sensor and entry.distribution != "geomosaic"
    }


def sensor_files(sensor: str, images: Sequence[Path]) -> tuple[Path, ...]:
    """Files beside the images that the sensor takes their models from; none where it cannot be loaded."""
    try:
        loaded = plugin(sensor)
    except GeomosaicError:
        return ()
    if not isinstance(loaded, HasFiles):
        return ()
    return tuple(dict.fromkeys(file for image in images for file in loaded.files(image)))
