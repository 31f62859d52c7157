"""Digitizing in a workspace: what a page reads, and what it asks for."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from pyproj import CRS

from geomosaic.errors import GeomosaicError, InputError
from geomosaic.geo.crs import crs_name, parse_map
from geomosaic.monoplotting.pictures import Picture
from geomosaic.raster.attributes import KINDS
from geomosaic.studio.digitizing.edits import changes_of, stamps, title_of
from geomosaic.studio.digitizing.layers import layer_by_id, layer_crs, layers_of, made_layer
from geomosaic.studio.digitizing.pictures import FeaturePictures
from geomosaic.studio.digitizing.shown import ShownFeatures, wrong_outline
from geomosaic.studio.digitizing.store import FeatureEdit, FeatureStore
from geomosaic.studio.workspace import Workspace
from geomosaic.whole_files import plain


class FeatureDesk:
    """Digitizing in a workspace."""

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
                layers += [{"id": one.id, "file": path.name, "name": one.name} for one in layers_of(path)]
            except GeomosaicError as error:
                wrong.append({"file": path.name, "error": error.what})
        return {
            "layers": layers, "unreadable": wrong, "pending": self.store.pending, "sketches": self.store.sketches,
            "kinds": list(KINDS), "history": self._workspace.history.titles,
        }  # fmt: skip

    def features(self, layer: str, map_layer: str | None, image: str | None) -> str:
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
        str
            JSON: facts of the layer, and `features`, see `ShownFeatures.json`.
        """
        file = layer_by_id(self._workspace.feature_files(), layer)
        table = self.store.table(file.path, file.name)
        crs, notes = layer_crs(table, file), []
        shown = ShownFeatures(table)
        if map_layer:
            shown.show("map", self._pictures.map_picture(map_layer, crs))
        if image:
            try:
                shown.show("image", self._pictures.image_picture(image, crs))
            except GeomosaicError as error:
                notes.append(f"not in the image: {error.what}")
        self._measured = shown.measure(crs, self._measured)
        facts = {
            "id": file.id, "file": file.path.name, "name": file.name, "kind": table.kind, "crs": crs_name(crs),
            "fields": [{"name": one.name, "kind": one.kind, "longest": one.longest} for one in table.fields],
            "fixed": "its vertices have heights, which drawing would lose" if table.heights else None,
            "notes": notes, "history": self._workspace.history.titles,
        }  # fmt: skip
        return f'{json.dumps(plain(facts))[:-1]}, "features": {shown.json()}}}'

    def create(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """Create a GeoPackage with one layer beside the project file.

        Parameters
        ----------
        values : mapping
            As `made_layer` takes them, and `crs`, or `map_layer` whose CRS it takes.

        Returns
        -------
        dict
            `id` of the layer.
        """
        text = str(values.get("crs") or "").strip()
        if not text and not values.get("map_layer"):
            raise InputError("nothing says which CRS the layer has", where="crs", hint="give one, such as EPSG:32633")
        crs = parse_map(text, "crs") if text else self._pictures.map_crs(str(values["map_layer"]))
        return {"id": made_layer(self._folder, values, crs).id}

    def edit(self, layer: str, values: Mapping[str, Any]) -> dict[str, Any]:
        """Make one edit: features drawn, changed or deleted.

        Parameters
        ----------
        layer : str
        values : mapping
            `changes` as `changes_of` takes them; `map_layer` or `image` for the picture; `shared` where vertices on
            edges of others are to be shared; `page` and `title`.

        Returns
        -------
        dict
            `ids` of the features, `title` and `notes`, and `stamps`: id, stamp before and stamp after of those changed.
        """
        file = layer_by_id(self._workspace.feature_files(), layer)
        with self._workspace.history.lock:
            table = self.store.table(file.path, file.name)
            changes, notes = changes_of(
                values.get("changes"),
                table,
                f"{file.path.name}, layer {file.name}",
                lambda: self._picture(values, layer_crs(table, file)),
                lambda count: self.store.free_ids(file.path, file.name, count),
                share=bool(values.get("shared")),
            )
            if not changes:
                return {"ids": [], "title": "", "notes": ["nothing was changed"], "stamps": []}
            title = title_of(changes, file.name)
            self._workspace.history.make(FeatureEdit(self.store, title, file.path, file.name, tuple(changes)))
            if isinstance(values.get("page"), str):
                self.store.sketch(values["page"], None)
        for change in changes:
            if change.after is not None and (why := wrong_outline(change.after.geometry)):
                notes.append(f"feature {change.id}: {why}")
        if self.store.pending:
            notes.append("saved in the journal; not in the GeoPackage yet")
        kept = [(one.id, one.before, one.after) for one in changes if one.before and one.after]
        marks = [(key, *stamps([before, after])) for key, before, after in kept]
        return {"ids": [change.id for change in changes], "title": title, "notes": notes, "stamps": marks}

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

    def _picture(self, values: Mapping[str, Any], crs: CRS) -> Picture:
        if values.get("image"):
            return self._pictures.image_picture(str(values["image"]), crs)
        return self._pictures.map_picture(str(values.get("map_layer")), crs)
