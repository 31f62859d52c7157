"""Georeferenced inputs: bands by name, placement and CRS."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from pyproj import CRS

from geomosaic.block.block import OrientedImage
from geomosaic.errors import GeomosaicWarning, InputError, did_you_mean
from geomosaic.geo.crs import horizontal
from geomosaic.geo.grid import Grid
from geomosaic.geo.projection_domain import whole_turn
from geomosaic.raster.info import SourceInfo, control_point_count, inspect

_COLOURS = ("red", "green", "blue")


def with_named_bands(scenes: Sequence[OrientedImage], names: Sequence[str]) -> tuple[OrientedImage, ...]:
    """Images restricted to named bands, in this order, whatever their order in each file.

    Parameters
    ----------
    scenes : sequence of OrientedImage
    names : sequence of str
        Band descriptions.

    Returns
    -------
    tuple of OrientedImage

    Raises
    ------
    InputError
        An image has no such band, or several.
    """
    return tuple(replace(scene, bands=tuple(_number(scene.path, name) for name in names)) for scene in scenes)


def check_same_bands(scenes: Sequence[OrientedImage]) -> None:
    """Check that images have the same bands: number, order of names, scale and offset of values.

    Parameters
    ----------
    scenes : sequence of OrientedImage

    Raises
    ------
    InputError
        Names an image that differs from the first one.
    """
    infos = [inspect(scene.path, scene.bands) for scene in scenes]
    first = infos[0]
    for scene, info in zip(scenes, infos, strict=True):
        if info.bands != first.bands:
            alpha = " besides alpha" if info.alpha or first.alpha else ""
            raise InputError(
                f"the image has {_bands(info)}{alpha}, '{scenes[0].name}' has {_bands(first)}",
                where=scene.path,
                hint="choose the same bands of all images: `bands=1,2,3`, or by name `band_names=red,green,blue`",
            )
        mine, other = _names(info), _names(first)
        if mine != other and sorted(mine) == sorted(other):
            raise InputError(
                f"the bands are {', '.join(mine)}, those of '{scenes[0].name}' are {', '.join(other)}",
                where=scene.path,
                hint=f"`band_names={','.join(other)}` brings them into one order",
            )
        if (info.scales, info.offsets) != (first.scales, first.offsets):
            raise InputError(
                f"stored numbers stand for other values (scale {info.scales[0]:g}, offset {info.offsets[0]:g}) than "
                f"those of '{scenes[0].name}' (scale {first.scales[0]:g}, offset {first.offsets[0]:g})",
                where=scene.path,
                hint="bring them to one scale first, for example with gdal_translate -unscale",
            )


def _number(path: str, name: str) -> int:
    info = inspect(path)
    plain = [i for i in range(1, info.bands + (info.alpha is not None) + 1) if i != info.alpha]
    wanted = name.strip().casefold()
    for known in (_descriptions(info), list(info.colors)):
        found = [number for number, own in zip(plain, known, strict=True) if own.casefold() == wanted]
        if len(found) == 1:
            return found[0]
        if found:
            raise InputError(f"several bands are called '{name}'", where=path, hint="choose by number: `bands`")
    have = [text for text in (*_descriptions(info), *(c for c in info.colors if c in _COLOURS)) if text]
    raise InputError(
        f"no band is called '{name}'",
        where=path,
        hint=did_you_mean(name, have) or (f"it has {', '.join(have)}" if have else "choose by number: `bands`"),
    )


def _descriptions(info: SourceInfo) -> list[str]:
    return [(text or "").strip() for text in info.descriptions]


def _names(info: SourceInfo) -> list[str]:
    """Names of bands: descriptions where all bands have one, else colour interpretations."""
    described = [text.casefold() for text in _descriptions(info)]
    if all(described) and len(set(described)) == len(described):
        return described
    return list(info.colors) if set(info.colors) >= set(_COLOURS) else []


def _bands(info: SourceInfo) -> str:
    return "one band" if info.bands == 1 else f"{info.bands} bands"


# Metres. In a projected CRS, coordinates within ±360 that step by less look like degrees; they are only warned of.
_TINY = 0.01
# Share of a quarter turn: the outer edge of a global grid's pixels may reach beyond the pole.
_HAIR = 0.01


def check_placed(info: SourceInfo, given: CRS | None = None) -> CRS:
    """CRS of a georeferenced raster, checked against its coordinates.

    Parameters
    ----------
    info : SourceInfo
    given : CRS, optional
        CRS in place of the file's.

    Returns
    -------
    CRS
        Horizontal CRS.

    Raises
    ------
    InputError
        The raster has no geotransform or CRS, or its coordinates cannot belong to that CRS.
    """
    if info.transform is None:
        points = control_point_count(info.path)
        raise InputError(
            f"the raster has no geotransform{f', but {points} control points' if points else ' and no world file'}",
            where=info.path,
            hint="place it by control points first: geomosaic georeference",
        )
    crs = given or info.crs
    grid = Grid(CRS("EPSG:4326"), info.transform, info.width, info.height)
    left, bottom, right, top = grid.bounds
    place = f"x {left:.8g} to {right:.8g}, y {bottom:.8g} to {top:.8g}"
    small = max(abs(left), abs(right)) <= 360.0 and max(abs(bottom), abs(top)) <= 90.0
    if crs is None:
        kind = "could be degrees" if small else "are no degrees, so they belong to a projected CRS"
        raise InputError(
            "the raster names no CRS", where=info.path,
            hint=f"give `src_crs`; its coordinates ({place}) {kind}",
        )  # fmt: skip
    crs = horizontal(crs)
    turn = whole_turn(crs)
    if turn is not None and max(abs(bottom), abs(top)) > turn / 4 * (1 + _HAIR):
        raise InputError(
            f"the coordinates ({place}) are no longitudes and latitudes, as the CRS '{crs.name}' has them",
            where=info.path,
            hint="give the CRS of the map that they belong to as `src_crs`, or exchange x and y",
        )
    if crs.is_projected and small and float(np.max(grid.resolution)) < _TINY:
        warnings.warn(
            f"{info.path}: the coordinates ({place}) look like degrees, and the CRS '{crs.name}' counts in "
            f"{crs.axis_info[0].unit_name}; if they are degrees, give `src_crs=EPSG:4326`",
            GeomosaicWarning,
            stacklevel=2,
        )
    return crs
