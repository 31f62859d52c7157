"""Schemes by name."""

from __future__ import annotations

from geomosaic.errors import InputError, did_you_mean
from geomosaic.sheets.series.mgrs import Mgrs
from geomosaic.sheets.series.national import ign, international, tk
from geomosaic.sheets.series.regular import Scheme, regular

SCHEMES: dict[str, str] = {
    "international": "division of the international map 1:1 000 000, on WGS 84; sheets in UTM",
    "puwg1992": "the same on ETRS89, as in Poland; sheets in PUWG 1992 (EPSG:2180)",
    "soviet": "the same on Pulkovo 1942, with Russian letters; sheets in Gauss-Krüger of 6°",
    "tk": "German TK 25, TK 50, TK 100 and TÜK 200, on DHDN; sheets in UTM on ETRS89",
    "ign": "French sheets 1:50 000 and 1:25 000, on NTF; sheets in Lambert-93",
    "mgrs": "UTM squares of 100 km, 10 km, 1 km or 100 m with their MGRS names",
    "grid": "squares or rectangles of any size in any CRS",
}
"""What each is."""
NEEDS_SCALE = ("international", "puwg1992", "soviet", "tk", "ign")


def scheme(
    name: str,
    scale: float | None = None,
    *,
    size: tuple[float, ...] = (),
    crs: str | None = None,
    origin: tuple[float, float] = (0.0, 0.0),
) -> Scheme:
    """A scheme by its name.

    Parameters
    ----------
    name : str
        One of `SCHEMES`.
    scale : float, optional
        Denominator; it chooses the sheets of those that have some for several scales.
    size : tuple of float
        Side or width and height, map units: of 'mgrs' and 'grid'.
    crs : str, optional
        Of 'grid'.
    origin : tuple of float
        Of 'grid'.

    Raises
    ------
    InputError
        No such scheme, or something it needs is missing.
    """
    if name not in SCHEMES:
        hint = did_you_mean(name, SCHEMES) or f"one of {', '.join(SCHEMES)}"
        raise InputError(f"there is no scheme '{name}'", where="`scheme`", hint=hint)
    if name in NEEDS_SCALE and scale is None:
        raise InputError(f"'{name}' has sheets for several scales", where="`scale`", hint="write `scale=1:25000`")
    whole = round(scale or 0)
    if name == "international":
        return international(whole, map_crs="EPSG:32{half}{zone:02d}", south=True)
    if name == "puwg1992":
        return international(whole, crs="EPSG:4258", map_crs="EPSG:2180", title=f"the division of PUWG 1992, 1:{whole}")
    if name == "soviet":
        return international(
            whole, crs="EPSG:4284", letters="cyrillic", map_crs="EPSG:284{gauss:02d}",
            title=f"the Soviet division 1:{whole}",
        )  # fmt: skip
    if name == "tk":
        return tk(whole)
    if name == "ign":
        return ign(whole)
    if name == "mgrs":
        if len(size) != 1 and size:
            raise InputError("MGRS squares have one size", where="`size`", hint="100000, 10000, 1000 or 100")
        return Mgrs(round(size[0]) if size else 100_000, scale)
    if not size or crs is None:
        raise InputError(
            "a grid needs the size of its sheets and a CRS", where="`scheme`", hint="give `size` and `crs`"
        )
    return regular(crs, (size[0], size[-1]), origin=origin, scale=scale)
