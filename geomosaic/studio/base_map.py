"""Base map of tiles from an address that the project names: where it may be loaded from, and how it lies under a map.

Tiles of the web are in the spherical Mercator projection. The browser draws them in the CRS of the map through
polynomials that are fitted to the exact transformation over the map's surroundings.
"""

from __future__ import annotations

from typing import Any
from urllib.parse import urlsplit

import numpy as np
from pyproj import CRS

from geomosaic.errors import InputError
from geomosaic.geo.transform import Transform
from geomosaic.project.load import Project
from geomosaic.types import FloatArray

_MERCATOR = CRS("EPSG:3857")
# Order of the polynomials, places along each side that they are fitted to, and the sides of the surroundings as a
# multiple of the map's.
_ORDER, _PLACES, _AROUND = 6, 25, 3.0


def base_map_host(project: Project | None) -> str:
    """Scheme and host that tiles are loaded from, as a content security policy names them; '' without a base map.

    Parameters
    ----------
    project : Project or None
    """
    address = None if project is None else project.settings.studio.base_map
    if address is None:
        return ""
    parts = urlsplit(address)
    return f"{parts.scheme}://{parts.netloc}"


def base_map_facts(project: Project, crs: CRS, bounds: tuple[float, float, float, float]) -> dict[str, Any] | None:
    """JSON values of the base map under a map; None where the project names none.

    Parameters
    ----------
    project : Project
    crs : CRS
        Of the map, in the plane or geographic.
    bounds : tuple of float
        Left, bottom, right and top of what the map shows.

    Raises
    ------
    InputError
        The surroundings have no place in the tiles' projection.
    """
    own = project.settings.studio
    if own.base_map is None:
        return None
    low, high = np.array(bounds[:2]), np.array(bounds[2:])
    middle, half = (low + high) / 2.0, _AROUND * np.maximum((high - low) / 2.0, 1e-9)
    forward, error = _fitted(crs, middle, half)
    return {
        "address": own.base_map,
        "host": base_map_host(project),
        "notice": own.base_map_notice,
        "largest_zoom": own.base_map_zoom,
        "extent": [*(middle - half).tolist(), *(middle + half).tolist()],
        "error_m": error,
        **forward,
    }


def _fitted(crs: CRS, middle: FloatArray, half: FloatArray) -> tuple[dict[str, Any], float]:
    """Polynomials from the map to the tiles' projection and back, and their largest error on the ground, metres."""
    side = np.cos(np.pi * (np.arange(_PLACES) + 0.5) / _PLACES)  # Chebyshev's places keep the error even
    uv = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    there = Transform(crs, _MERCATOR)(middle + uv * half)
    if not np.isfinite(there).all():
        raise InputError(
            "the map has no place in the projection of web tiles", hint="choose a map that is no polar one"
        )
    centre = (there.min(axis=0) + there.max(axis=0)) / 2.0
    size = (there.max(axis=0) - there.min(axis=0)) / 2.0
    st = (there - centre) / size
    to, back = _solve(uv, st), _solve(st, uv)
    check = np.random.default_rng(1).uniform(-1.0, 1.0, (400, 2))
    exact = Transform(crs, _MERCATOR)(middle + check * half)
    off = np.abs(_terms(check) @ to * size + centre - exact)
    # The projection enlarges by the secant of the latitude.
    enlarged = np.cosh(exact[:, 1] / 6378137.0)
    error = float((np.hypot(*off.T) / enlarged).max())
    facts = {
        "order": _ORDER,
        "map_centre": middle.tolist(), "map_size": half.tolist(),
        "tile_centre": centre.tolist(), "tile_size": size.tolist(),
        "to_tiles": to.T.tolist(), "to_map": back.T.tolist(),
    }  # fmt: skip
    return facts, error


def _terms(uv: FloatArray) -> FloatArray:
    """Products u^i v^j (N, T) with i + j up to the order, i ascending, then j."""
    powers = [(i, j) for i in range(_ORDER + 1) for j in range(_ORDER + 1 - i)]
    return np.column_stack([uv[:, 0] ** i * uv[:, 1] ** j for i, j in powers])


def _solve(source: FloatArray, target: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.lstsq(_terms(source), target, rcond=None)[0], dtype=np.float64)
