"""Features of a layer as a page shows them: on the map, in an image, measured on the ellipsoid."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import shapely
from pyproj import CRS
from shapely.geometry import mapping

from geomosaic.geo.ellipsoidal import areas_and_lengths
from geomosaic.monoplotting.digitizing import ShownLayer
from geomosaic.monoplotting.line_drawing import View, draw
from geomosaic.monoplotting.pictures import PhotoPicture, Picture
from geomosaic.raster.geopackage import FeatureTable
from geomosaic.studio.digitizing.edits import stamp


class ShownFeatures:
    """Features of a layer for a page.

    Parameters
    ----------
    table : FeatureTable

    Attributes
    ----------
    found : dict of int to dict
        By the feature's id: `id`, `stamp` (of what it holds), `values`, `map`, `image` (GeoJSON; None where it is not
        wholly in it), `drawn` (what the photo shows of it, `hidden` pieces marked), `area`, `length`, `wrong`.
    """

    def __init__(self, table: FeatureTable) -> None:
        self._shapes = {key: one.geometry for key, one in table.features.items() if one.geometry is not None}
        self.found: dict[int, dict[str, Any]] = {
            key: {"id": key, "stamp": stamp(one), "values": dict(one.values), "map": None, "image": None, "drawn": []}
            for key, one in table.features.items()
        }

    def show(self, side: str, picture: Picture) -> None:
        """Add what a picture shows.

        Parameters
        ----------
        side : str
            'map' or 'image'.
        picture : Picture
        """
        shown = ShownLayer.of(picture, self._shapes.values())
        for key, geometry in self._shapes.items():
            self.found[key][side] = _json(shown.shown(geometry))
        if isinstance(picture, PhotoPicture) and self._shapes:
            keys, shapes = list(self._shapes), list(self._shapes.values())
            made = draw(picture.view, shapes, _bounds(picture.view, shapes), hidden=True)
            for piece, index, hidden in zip(made.geometries, made.feature, made.hidden, strict=True):
                self.found[keys[index]]["drawn"].append({"geometry": _json(piece), "hidden": hidden})

    def measure(self, crs: CRS, known: Mapping[str, tuple[float, float]]) -> dict[str, tuple[float, float]]:
        """Add areas, lengths and what is wrong with outlines.

        Parameters
        ----------
        crs : CRS
        known : mapping
            Areas and lengths that were measured before, as this returned them.
        """
        names = {key: f"{crs.srs} {self.found[key]['stamp']}" for key in self._shapes}
        new = [key for key, name in names.items() if name not in known]
        measured = areas_and_lengths([self._shapes[key] for key in new], crs).tolist()
        fresh = {names[key]: (area, length) for key, (area, length) in zip(new, measured, strict=True)}
        kept = {name: fresh[name] if name in fresh else known[name] for name in names.values()}
        for key, one in self.found.items():
            one["area"], one["length"] = kept[names[key]] if key in names else (None, None)
            one["wrong"] = wrong_outline(self._shapes.get(key))
        return kept


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


def _json(geometry: Any) -> dict[str, Any] | None:
    return None if geometry is None else mapping(geometry)
