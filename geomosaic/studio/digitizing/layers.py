"""Layers of GeoPackages beside a project: found by their names in addresses, and made."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pyproj import CRS

from geomosaic.digests import digest_of
from geomosaic.errors import GeomosaicError, InputError
from geomosaic.geo.crs import horizontal
from geomosaic.raster.attributes import KINDS, Field
from geomosaic.raster.geopackage import FeatureTable, create_layer, feature_layers

# Geometry types that can be drawn, as layers are made of them.
DRAWN = ("Point", "LineString", "Polygon")
_NAME = re.compile(r"\w[\w \-]{0,59}")
_MOST_FIELDS = 60


@dataclass(frozen=True)
class LayerFile:
    """Layer of a GeoPackage, named in addresses by a digest so that no request can name a file."""

    id: str
    path: Path
    name: str


def layers_of(path: Path) -> Iterator[LayerFile]:
    """Layers of a GeoPackage.

    Parameters
    ----------
    path : Path
    """
    return (_layer_file(path, name) for name in feature_layers(path))


def layer_by_id(paths: Iterable[Path], layer: str) -> LayerFile:
    """Layer of one of several GeoPackages; those that cannot be read are passed over.

    Parameters
    ----------
    paths : iterable of Path
    layer : str
        Its id.

    Raises
    ------
    InputError
        There is none.
    """
    for path in paths:
        try:
            found = next((one for one in layers_of(path) if one.id == layer), None)
        except GeomosaicError:
            continue
        if found is not None:
            return found
    raise InputError("there is no such layer", hint="another program may have moved it: load the page again")


def layer_crs(table: FeatureTable, file: LayerFile) -> CRS:
    """Horizontal CRS of a layer.

    Parameters
    ----------
    table : FeatureTable
    file : LayerFile
        For the message.

    Raises
    ------
    InputError
        It has none.
    """
    if table.crs is None:
        raise InputError(
            "the layer has no CRS", where=f"{file.path.name}, {file.name}", hint="declare it, for example in QGIS"
        )
    return horizontal(table.crs)


def made_layer(folder: Path, values: Mapping[str, Any], crs: CRS) -> LayerFile:
    """GeoPackage with one layer, newly written.

    Parameters
    ----------
    folder : Path
    values : mapping
        `name`, `kind` (one of `DRAWN`) and `fields` (of `name` and `kind`).
    crs : CRS

    Raises
    ------
    InputError
        A name or a kind cannot be taken, or the file is there already.
    """
    name, kind = str(values.get("name", "")).strip(), values.get("kind")
    if not _NAME.fullmatch(name):
        raise InputError(
            f"'{name[:80]}' cannot name a layer",
            where="name",
            hint="use letters, digits, spaces, - and _, 60 at most",
        )
    if kind not in DRAWN:
        raise InputError(f"'{kind}' is no kind of geometry", where="kind", hint=f"choose one of {', '.join(DRAWN)}")
    path = folder / f"{name}.gpkg"
    create_layer(path, name, kind, crs, _fields(values.get("fields") or []))
    return _layer_file(path, name)


def _layer_file(path: Path, name: str) -> LayerFile:
    return LayerFile(digest_of(str(path), name)[:16], path, name)


def _fields(given: Any) -> list[Field]:
    if not isinstance(given, list) or len(given) > _MOST_FIELDS:
        raise InputError(f"a layer has {_MOST_FIELDS} attributes at most", where="fields", hint="leave some out")
    made: list[Field] = []
    for one in given:
        name = str(one.get("name", "")).strip() if isinstance(one, dict) else ""
        taken = {"fid", "geom", *(field.name.casefold() for field in made)}
        if not _NAME.fullmatch(name) or name.casefold() in taken:
            raise InputError(f"'{name[:60]}' cannot name an attribute", where="fields", hint="give each its own name")
        if one.get("kind") not in KINDS:
            raise InputError(
                f"'{one.get('kind')}' is no kind of attribute", where=name, hint=f"one of {', '.join(KINDS)}"
            )
        made.append(Field(name, one["kind"]))
    return made
