"""Digitizing in the studio: layers of GeoPackages beside the project, shown and edited on the map and in photos."""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import shapely
from pyproj import CRS
from shapely.geometry import mapping, shape

from geomosaic.errors import GeomosaicError, InputError, counted
from geomosaic.geo.crs import crs_name, horizontal, parse_map
from geomosaic.geo.ellipsoidal import areas_and_lengths
from geomosaic.monoplotting.digitizing import ShownLayer, with_shared_vertices
from geomosaic.monoplotting.line_drawing import View, draw
from geomosaic.monoplotting.pictures import PhotoPicture, Picture
from geomosaic.raster.attributes import KINDS, Field, checked_value
from geomosaic.raster.geopackage import (
    Feature,
    FeatureChange,
    FeatureConflict,
    FeatureTable,
    create_layer,
    feature_layers,
)
from geomosaic.studio.feature_pictures import FeaturePictures
from geomosaic.studio.feature_store import FeatureEdit, FeatureStore
from geomosaic.studio.workspace import Workspace

# Geometry types that can be drawn, as layers are made of them.
DRAWN = ("Point", "LineString", "Polygon")
_ANY = (*DRAWN, *(f"Multi{one}" for one in DRAWN))
_NAME = re.compile(r"\w[\w \-]{0,59}")
_MOST_FIELDS = 60


@dataclass(frozen=True)
class LayerFile:
    """Layer of a GeoPackage, named in addresses by a digest so that no request can name a file."""

    id: str
    path: Path
    name: str


class FeatureDesk:
    """Digitizing in a workspace.

    Parameters
    ----------
    workspace : Workspace
    """

    def __init__(self, workspace: Workspace) -> None:
        self._workspace = workspace
        self._folder = workspace.path.parent
        self.store = FeatureStore(self._folder / ".geomosaic" / workspace.path.stem / "digitizing.jsonl")
        self._pictures = FeaturePictures(workspace)
        self._measured: dict[str, tuple[float, float]] = {}
        self.store.flush()

    def state(self) -> dict[str, Any]:
        """Layers beside the project file, edits that wait, and sketches.

        Returns
        -------
        dict
            `layers` (`id`, `file`, `name`, `error`), `pending`, `sketches` and `history`.
        """
        layers, wrong = [], []
        for path in self._workspace.feature_files():
            try:
                layers += [{"id": one.id, "file": path.name, "name": one.name} for one in _layers(path)]
            except GeomosaicError as error:
                wrong.append({"file": path.name, "error": error.what})
        return {
            "layers": layers, "unreadable": wrong, "pending": self.store.pending, "sketches": self.store.sketches,
            "kinds": list(KINDS), "history": self._workspace.history.titles,
        }  # fmt: skip

    def features(self, layer: str, map_layer: str | None, image: str | None) -> dict[str, Any]:
        """Features of a layer, on the map and in an image.

        Parameters
        ----------
        layer : str
            By its id.
        map_layer : str, optional
            Georeferenced raster whose CRS the map has, by its id.
        image : str, optional
            Image that is shown, by its id.

        Returns
        -------
        dict
            Facts of the layer, and `features`: `id`, `stamp` (of what it holds), `values`, `map`, `image` (GeoJSON;
            None where they are not wholly in it), `drawn` (what the photo shows of it, `hidden` pieces marked), `area`,
            `length`, `wrong`.
        """
        file = self._layer(layer)
        table = self.store.table(file.path, file.name)
        crs, notes = _crs(table, file), []
        shapes = {key: one.geometry for key, one in table.features.items() if one.geometry is not None}
        found: dict[int, dict[str, Any]] = {
            key: {"id": key, "stamp": _stamp(one), "values": dict(one.values), "map": None, "image": None, "drawn": []}
            for key, one in table.features.items()
        }
        if map_layer:
            shown = ShownLayer.of(self._pictures.map_picture(map_layer, crs), shapes.values())
            for key, geometry in shapes.items():
                found[key]["map"] = _json(shown.shown(geometry))
        if image:
            try:
                picture = self._pictures.image_picture(image, crs)
                self._show(picture, shapes, found)
            except GeomosaicError as error:
                notes.append(f"not in the image: {error.what}")
        self._measure(found, shapes, crs)
        return {
            "id": file.id, "file": file.path.name, "name": file.name, "kind": table.kind, "crs": crs_name(crs),
            "fields": [{"name": one.name, "kind": one.kind, "longest": one.longest} for one in table.fields],
            "fixed": "its vertices have heights, which drawing would lose" if table.heights else None,
            "features": list(found.values()), "notes": notes, "history": self._workspace.history.titles,
        }  # fmt: skip

    def create(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """Create a GeoPackage with one layer beside the project file.

        Parameters
        ----------
        values : mapping
            `name`, `kind` (one of `DRAWN`), `fields` (of `name` and `kind`), and `crs`, or `map_layer` whose CRS it
            takes.

        Returns
        -------
        dict
            `id` of the layer.
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
        text = str(values.get("crs") or "").strip()
        if not text and not values.get("map_layer"):
            raise InputError("nothing says which CRS the layer has", where="crs", hint="give one, such as EPSG:32633")
        crs = parse_map(text, "crs") if text else self._pictures.map_crs(str(values["map_layer"]))
        path = self._folder / f"{name}.gpkg"
        create_layer(path, name, kind, crs, _fields(values.get("fields") or []))
        return {"id": _layer_file(path, name).id}

    def edit(self, layer: str, values: Mapping[str, Any]) -> dict[str, Any]:
        """Make one edit: features drawn, changed or deleted.

        Parameters
        ----------
        layer : str
        values : mapping
            `changes`, each of `id` (None for a new feature), `stamp` as it was told, and any of `geometry` (GeoJSON in
            the picture), `values` and `remove`; `map_layer` or `image` for the picture; `shared` where vertices on
            edges of others are to be shared; `page` and `title`.

        Returns
        -------
        dict
            `ids` of the features, and `notes`.
        """
        file = self._layer(layer)
        with self._workspace.history.lock:
            table = self.store.table(file.path, file.name)
            changes, notes = self._changes(file, table, values)
            if not changes:
                return {"ids": [], "notes": ["nothing was changed"]}
            title = _title(changes, file.name)
            self._workspace.history.make(FeatureEdit(self.store, title, file.path, file.name, tuple(changes)))
            if isinstance(values.get("page"), str):
                self.store.sketch(values["page"], None)
        for change in changes:
            if change.after is not None and (why := _wrong(change.after.geometry)):
                notes.append(f"feature {change.id}: {why}")
        if self.store.pending:
            notes.append("saved in the journal; not in the GeoPackage yet")
        return {"ids": [change.id for change in changes], "title": title, "notes": notes}

    def sketch(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """Keep what a page is drawing; nothing is answered.

        Parameters
        ----------
        values : mapping
            `page`, and `drawn`: None, or `layer`, `side`, `kind` and `coordinates` in the picture, with what names it.
        """
        page, drawn = values.get("page"), values.get("drawn")
        if not isinstance(page, str) or not 0 < len(page) <= 40 or not isinstance(drawn, dict | None):
            raise InputError("this is no sketch", hint="load the page again")
        self.store.sketch(page, drawn)
        return {}

    def settle(self, values: Mapping[str, Any]) -> None:
        """Settle edits that wait: try again, save one over what another program has saved, or drop it.

        Parameters
        ----------
        values : mapping
            `act` ('again', 'over', 'drop') and `number`.
        """
        if values.get("act") == "again":
            self.store.flush()
        elif values.get("act") in ("over", "drop") and isinstance(values.get("number"), int):
            self.store.settle(values["number"], over=values["act"] == "over")
        else:
            raise InputError("edits are settled by 'again', 'over' or 'drop'", hint="load the page again")

    def place(self, image: str, map_layer: str, first: float, second: float, *, on_map: bool) -> dict[str, Any]:
        """Place of a pixel with its error ellipse, or pixel of a place, see `FeaturePictures.place`.

        Parameters
        ----------
        image, map_layer : str
            By their ids.
        first, second : float
            Column and row, or x and y.
        on_map : bool
        """
        return self._pictures.place(image, map_layer, (first, second), on_map=on_map)

    def _changes(
        self, file: LayerFile, table: FeatureTable, values: Mapping[str, Any]
    ) -> tuple[list[FeatureChange], list[str]]:
        asked = values.get("changes")
        if not isinstance(asked, list) or not all(isinstance(one, dict) for one in asked):
            raise InputError("an edit has a list of changes", hint="load the page again")
        befores = [_before(one, table, file) for one in asked]
        drawn = [index for index, one in enumerate(asked) if one.get("geometry") is not None]
        if drawn and table.heights:
            raise InputError(
                "vertices of this layer have heights, which drawing would lose", hint="draw in another layer"
            )
        shapes: dict[int, Any] = {}
        shared: dict[int, Any] = {}
        notes: list[str] = []
        if drawn:
            picture = self._picture(values, _crs(table, file))
            known = {key: one.geometry for key, one in table.features.items()}
            carried, notes = ShownLayer.of(picture, known.values()).carried(_shape(asked[i]["geometry"]) for i in drawn)
            shapes = {index: _of_kind(one, table.kind) for index, one in zip(drawn, carried, strict=True)}
        new = self.store.free_ids(file.path, file.name, sum(before is None for before in befores))
        ids = [one["id"] if before is not None else new.pop(0) for one, before in zip(asked, befores, strict=True)]
        if drawn and values.get("shared"):
            edited = {ids[index]: geometry for index, geometry in shapes.items()}
            gone = {ids[index] for index, one in enumerate(asked) if one.get("remove")}
            layer = {key: one for key, one in {**known, **edited}.items() if key not in gone}
            shared = with_shared_vertices(edited, layer, picture.tolerance)
        changes = []
        for index, (one, before, key) in enumerate(zip(asked, befores, ids, strict=True)):
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

    def _picture(self, values: Mapping[str, Any], crs: CRS) -> Picture:
        if values.get("image"):
            return self._pictures.image_picture(str(values["image"]), crs)
        return self._pictures.map_picture(str(values.get("map_layer")), crs)

    def _show(self, picture: Picture, shapes: Mapping[int, Any], found: Mapping[int, dict[str, Any]]) -> None:
        """Add what an image shows of the features."""
        shown = ShownLayer.of(picture, shapes.values())
        for key, geometry in shapes.items():
            found[key]["image"] = _json(shown.shown(geometry))
        if isinstance(picture, PhotoPicture) and shapes:
            keys = list(shapes)
            made = draw(
                picture.view, [shapes[key] for key in keys], _bounds(picture.view, shapes.values()), hidden=True
            )
            for piece, index, hidden in zip(made.geometries, made.feature, made.hidden, strict=True):
                found[keys[index]]["drawn"].append({"geometry": _json(piece), "hidden": hidden})

    def _measure(self, found: Mapping[int, dict[str, Any]], shapes: Mapping[int, Any], crs: CRS) -> None:
        """Add areas, lengths and what is wrong with outlines; what was measured before is not measured again."""
        of = {key: f"{crs.srs} {one['stamp']}" for key, one in found.items()}
        new = [key for key in shapes if of[key] not in self._measured]
        kept = {of[key]: self._measured[of[key]] for key in shapes if key not in set(new)}
        for key, (area, length) in zip(new, areas_and_lengths([shapes[one] for one in new], crs).tolist(), strict=True):
            kept[of[key]] = area, length
        self._measured = kept
        for key, one in found.items():
            one["area"], one["length"] = kept.get(of[key], (None, None))
            one["wrong"] = _wrong(shapes.get(key))

    def _layer(self, layer: str) -> LayerFile:
        for path in self._workspace.feature_files():
            try:
                found = next((one for one in _layers(path) if one.id == layer), None)
            except GeomosaicError:
                continue
            if found is not None:
                return found
        raise InputError("there is no such layer", hint="another program may have moved it: load the page again")


def _layers(path: Path) -> Iterator[LayerFile]:
    return (_layer_file(path, name) for name in feature_layers(path))


def _layer_file(path: Path, name: str) -> LayerFile:
    return LayerFile(hashlib.sha256(f"{path}\0{name}".encode()).hexdigest()[:16], path, name)


def _crs(table: FeatureTable, file: LayerFile) -> CRS:
    if table.crs is None:
        raise InputError(
            "the layer has no CRS", where=f"{file.path.name}, {file.name}", hint="declare it, for example in QGIS"
        )
    return horizontal(table.crs)


def _stamp(feature: Feature) -> str:
    """Digest of what a feature holds: an edit of another state of it is refused."""
    geometry = b"" if feature.geometry is None else shapely.to_wkb(feature.geometry, flavor="iso")
    return hashlib.sha256(geometry + repr(sorted(feature.values.items())).encode()).hexdigest()[:16]


def _before(one: Mapping[str, Any], table: FeatureTable, file: LayerFile) -> Feature | None:
    if one.get("id") is None:
        return None
    found = table.features.get(one["id"]) if isinstance(one["id"], int) else None
    if found is None or one.get("stamp") != _stamp(found):
        raise FeatureConflict((one["id"],), f"{file.path.name}, layer {file.name}")
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


def _wrong(geometry: Any) -> str | None:
    """What is wrong with an outline, in words."""
    if geometry is None or geometry.area == 0.0 or geometry.is_valid:
        return None
    reason = shapely.is_valid_reason(geometry)
    place = re.search(r"\[(.*)\]", reason)
    return f"the outline crosses or touches itself at {place.group(1)}" if place else reason


def _title(changes: list[FeatureChange], layer: str) -> str:
    made = [one for one in changes if one.before is None]
    gone = [one for one in changes if one.after is None]
    word = "drawn" if made else "deleted" if gone else "changed"
    main = made or gone or changes
    name = f"feature {main[0].id}" if len(main) == 1 else counted(len(main), "feature")
    return f"{name} of {layer} {word}"


def _bounds(view: View, shapes: Any) -> tuple[float, float, float, float]:
    """Extent of the features: what the photo does not show of them is cut by its frame."""
    left, bottom, right, top = shapely.total_bounds(list(shapes)).tolist()
    margin = 10.0 * view.sampling
    return left - margin, bottom - margin, right + margin, top + margin


def _json(geometry: Any) -> dict[str, Any] | None:
    return None if geometry is None else mapping(geometry)
