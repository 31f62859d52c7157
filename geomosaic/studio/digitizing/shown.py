"""Features of a layer as a page shows them: on the map, in an image, measured on the ellipsoid."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from typing import Any

import numpy as np
import shapely
from pyproj import CRS

from geomosaic.geo.ellipsoidal import areas_and_lengths
from geomosaic.monoplotting.digitizing import ShownLayer
from geomosaic.monoplotting.line_drawing import View, draw
from geomosaic.monoplotting.pictures import PhotoPicture, Picture
from geomosaic.raster.geopackage import FeatureTable
from geomosaic.studio.digitizing.edits import stamps
from geomosaic.whole_files import plain

# Share of a photo's sides by which lines between vertices beyond it may reach into it, bent by the relief.
_BEYOND = 0.2


class ShownFeatures:
    """Features of a layer for a page."""

    def __init__(self, table: FeatureTable) -> None:
        self._known = {key: one.geometry for key, one in table.features.items() if one.geometry is not None}
        self._shapes = np.array([*self._known.values(), None], dtype=object)[:-1]
        self._facts: dict[int, dict[str, Any]] = {
            key: {"id": key, "stamp": mark, "values": plain(one.values)}
            for (key, one), mark in zip(table.features.items(), stamps(table.features.values()), strict=True)
        }
        # GeoJSON of each feature by the name it is told under.
        self._texts: dict[str, dict[int, str]] = {"map": {}, "image": {}, "drawn": {}}

    def show(self, side: str, picture: Picture) -> None:
        """Add what a picture shows.

        Parameters
        ----------
        side : str
            'map' or 'image'.
        picture : Picture
        """
        if not self._known:
            return
        found = ShownLayer.of(picture, self._shapes).shown()
        seen = [(key, shape) for key, shape in zip(self._known, found, strict=True) if shape is not None]
        texts = shapely.to_geojson([shape for _, shape in seen])
        self._texts[side] = {key: text for (key, _), text in zip(seen, texts, strict=True)}
        if isinstance(picture, PhotoPicture):
            self._texts["drawn"] = self._drawn(picture.view, dict(seen))

    def _drawn(self, view: View, seen: Mapping[int, Any]) -> dict[int, str]:
        """Pieces that a photo shows of the features, along the relief."""
        frame = shapely.box(
            *(-_BEYOND * side for side in view.model.size), *((1 + _BEYOND) * s for s in view.model.size)
        )
        near = [key for key in self._known if key not in seen or shapely.box(*seen[key].bounds).intersects(frame)]
        if not near:
            return {}
        shapes = [self._known[key] for key in near]
        made = draw(view, shapes, _bounds(view, shapes), hidden=True)
        pieces: dict[int, list[str]] = {}
        texts = shapely.to_geojson(made.geometries)
        for text, index, hidden in zip(texts, made.feature, made.hidden, strict=True):
            pieces.setdefault(near[index], []).append(f'{{"geometry":{text},"hidden":{"true" if hidden else "false"}}}')
        return {key: f"[{','.join(own)}]" for key, own in pieces.items()}

    def measure(self, crs: CRS, known: Mapping[str, tuple[float, float]]) -> dict[str, tuple[float, float]]:
        """Add areas, lengths and what is wrong with outlines.

        Parameters
        ----------
        crs : CRS
        known : mapping
            Areas and lengths that were measured before, as this returned them.
        """
        names = {key: f"{crs.srs} {self._facts[key]['stamp']}" for key in self._known}
        new = [key for key, name in names.items() if name not in known]
        measured = areas_and_lengths([self._known[key] for key in new], crs).tolist()
        fresh = {names[key]: (area, length) for key, (area, length) in zip(new, measured, strict=True)}
        kept = {name: fresh[name] if name in fresh else known[name] for name in names.values()}
        for key, one in self._facts.items():
            one["area"], one["length"] = plain(kept[names[key]]) if key in names else (None, None)
            one["wrong"] = None
        for key in np.array([*self._known], dtype=int)[~shapely.is_valid(self._shapes)].tolist():
            self._facts[key]["wrong"] = wrong_outline(self._known[key])
        return kept

    def json(self) -> str:
        """Features as JSON.

        Returns
        -------
        str
            List of `id`, `stamp` (of what it holds), `values`, `area`, `length`, `wrong`, `map`, `image` (GeoJSON; null
            where it is not wholly in it) and `drawn` (what the photo shows of it, `hidden` pieces marked).
        """
        on_map, in_image, drawn = (self._texts[name] for name in ("map", "image", "drawn"))
        return "[" + ",".join(
            f'{json.dumps(facts)[:-1]},"map":{on_map.get(key, "null")},"image":{in_image.get(key, "null")},'
            f'"drawn":{drawn.get(key, "[]")}}}'
            for key, facts in self._facts.items()
        ) + "]"  # fmt: skip


def wrong_outline(geometry: Any) -> str | None:
    """What is wrong with an outline, in words; None for one that crosses nothing.

    Parameters
    ----------
    geometry : shapely geometry or None
    """
    if geometry is None or geometry.area == 0.0 or geometry.is_valid:
        return None
    reason = shapely.is_valid_reason(geometry)
    place = re.search(r"\[(.*)\]", reason)
    return f"the outline crosses or touches itself at {place.group(1)}" if place else reason


def _bounds(view: View, shapes: Any) -> tuple[float, float, float, float]:
    """Extent of the features: what the photo does not show of them is cut by its frame."""
    left, bottom, right, top = shapely.total_bounds(list(shapes)).tolist()
    margin = 10.0 * view.sampling
    return left - margin, bottom - margin, right + margin, top + margin
