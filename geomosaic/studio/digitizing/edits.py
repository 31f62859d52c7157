"""Edits of features as a page asks for them: geometries of its picture, attributes by name, features deleted."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import shapely
from shapely.geometry import shape

from geomosaic.digests import digest_of
from geomosaic.errors import InputError, counted
from geomosaic.monoplotting.digitizing import ShownLayer, with_shared_vertices
from geomosaic.monoplotting.pictures import Picture
from geomosaic.raster.attributes import checked_value
from geomosaic.raster.geopackage import Feature, FeatureChange, FeatureConflict, FeatureTable
from geomosaic.studio.digitizing.layers import DRAWN

_ANY = (*DRAWN, *(f"Multi{one}" for one in DRAWN))


def changes_of(
    requested: Any, table: FeatureTable, where: str, picture: Callable[[], Picture],
    free_ids: Callable[[int], list[int]], *, share: bool,
) -> tuple[list[FeatureChange], list[str]]:  # fmt: skip
    """Changes of features, and notes on what was drawn.

    Parameters
    ----------
    requested : list of mapping
        Each of `id` (None for a new feature), `stamp` as it was told, and any of `geometry` (GeoJSON in the picture),
        `values` and `remove`.
    table : FeatureTable
    where : str
        File and layer, for messages.
    picture : callable
        Picture that was drawn in, asked for where there is a geometry.
    free_ids : callable
        As many row numbers for new features.
    share : bool
        Whether vertices on edges of other features are shared with these.

    Raises
    ------
    FeatureConflict
        A feature is not as it was told.
    InputError
        What was asked for cannot be made.
    """
    if not isinstance(requested, list) or not all(isinstance(one, dict) for one in requested):
        raise InputError("an edit has a list of changes", hint="load the page again")
    befores = [_before(one, table, where) for one in requested]
    drawn = [index for index, one in enumerate(requested) if one.get("geometry") is not None]
    shapes: dict[int, Any] = {}
    shared: dict[int, Any] = {}
    notes: list[str] = []
    if drawn:
        if table.heights:
            raise InputError(
                "vertices of this layer have heights, which drawing would lose", hint="draw in another layer"
            )
        within = picture()
        known = {key: one.geometry for key, one in table.features.items() if one.geometry is not None}
        carried, notes = ShownLayer.of(within, known.values()).carried(_shape(requested[i]["geometry"]) for i in drawn)
        shapes = {index: _of_kind(one, table.kind) for index, one in zip(drawn, carried, strict=True)}
    new = iter(free_ids(sum(before is None for before in befores)))
    ids = [one["id"] if before is not None else next(new) for one, before in zip(requested, befores, strict=True)]
    if drawn and share:
        edited = {ids[index]: geometry for index, geometry in shapes.items()}
        gone = {ids[index] for index, one in enumerate(requested) if one.get("remove")}
        layer = {key: one for key, one in {**known, **edited}.items() if key not in gone}
        shared = with_shared_vertices(edited, layer, within.tolerance)
    changes = []
    for index, (one, before, key) in enumerate(zip(requested, befores, ids, strict=True)):
        if one.get("remove"):
            after = None
        else:
            geometry = shared.pop(key, shapes.get(index, None if before is None else before.geometry))
            after = Feature(geometry, _attributes(one.get("values"), before, table))
            if before is None and geometry is None:
                raise InputError("a new feature has no geometry", hint="draw it")
        changes.append(FeatureChange(key, before, after))
    for key, geometry in shared.items():
        neighbour = table.features[key]
        changes.append(FeatureChange(key, neighbour, Feature(geometry, neighbour.values)))
    return changes, notes


def stamps(features: Iterable[Feature]) -> list[str]:
    """Digests of what features hold: an edit of another state of one is refused.

    Parameters
    ----------
    features : iterable of Feature
    """
    some = list(features)
    shapes = np.array([*(one.geometry for one in some), None], dtype=object)[:-1]
    return [
        digest_of(blob or b"", repr(sorted(one.values.items())))[:16]
        for one, blob in zip(some, shapely.to_wkb(shapes, flavor="iso"), strict=True)
    ]


def title_of(changes: Sequence[FeatureChange], layer: str) -> str:
    """Words for an edit in the history.

    Parameters
    ----------
    changes : sequence of FeatureChange
    layer : str
        Its name.
    """
    made = [one for one in changes if one.before is None]
    gone = [one for one in changes if one.after is None]
    word = "drawn" if made else "deleted" if gone else "changed"
    main = made or gone or changes
    name = f"feature {main[0].id}" if len(main) == 1 else counted(len(main), "feature")
    return f"{name} of {layer} {word}"


def _before(one: Mapping[str, Any], table: FeatureTable, where: str) -> Feature | None:
    if one.get("id") is None:
        return None
    found = table.features.get(one["id"]) if isinstance(one["id"], int) else None
    if found is None or [one.get("stamp")] != stamps([found]):
        raise FeatureConflict((one["id"],), where)
    return found


def _shape(given: Any) -> Any:
    """Geometry in a picture, from GeoJSON of the page."""
    try:
        if given["type"] not in _ANY:
            raise ValueError(given["type"])
        made = shape({"type": given["type"], "coordinates": given["coordinates"]})
        coordinates = shapely.get_coordinates(made)
        if made.is_empty or made.has_z or not all(map(math.isfinite, coordinates.ravel().tolist())):
            raise ValueError("no vertices")
    except (KeyError, TypeError, ValueError, AttributeError, IndexError, shapely.errors.ShapelyError):
        raise InputError(
            "this is no geometry", hint="a line has two vertices or more, the outline of an area three"
        ) from None
    return made


def _of_kind(geometry: Any, kind: str) -> Any:
    """Geometry as a layer of a kind keeps it."""
    own = geometry.geom_type.upper()
    if kind in (own, "GEOMETRY"):
        return geometry
    if kind == f"MULTI{own}":
        return getattr(shapely, f"Multi{geometry.geom_type}")([geometry])
    if own == f"MULTI{kind}" and len(geometry.geoms) == 1:
        return geometry.geoms[0]
    raise InputError(f"a layer of {kind.lower()} takes no {own.lower()}", hint="draw it in another layer")


def _attributes(given: Any, before: Feature | None, table: FeatureTable) -> dict[str, Any]:
    values = {field.name: None for field in table.fields} if before is None else dict(before.values)
    if given is None:
        return values
    if not isinstance(given, dict):
        raise InputError("attributes are given by name", hint="load the page again")
    fields = {field.name: field for field in table.fields}
    for name, value in given.items():
        if name not in fields:
            raise InputError(
                f"the layer has no attribute '{str(name)[:60]}'", hint="another program may have renamed it"
            )
        values[name] = checked_value(value, fields[name])
    return values
