"""Observations of edge matching as arrays: stations on the ground and their places in the photos."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pyproj import CRS

from geomosaic.block.block import ControlPoint, OrientedImage
from geomosaic.errors import InputError
from geomosaic.geo.crs import has_heights
from geomosaic.types import BoolArray, FloatArray, IntArray


@dataclass(frozen=True)
class CommonPoint:
    """Image measurement of a point that several photos show and whose place on the ground is not known.

    Attributes
    ----------
    id : str
        The same in all photos that show the point.
    image : str
        Name of the photo.
    colrow : tuple of float
        Pixels, corner-based.
    sigma_px : float
        Standard deviation of the measurement, pixels.
    z : float
        Height of the point in the CRS of the control; needed only where a photo's model uses heights.
    where : str
        File and line, for messages.
    """

    id: str
    image: str
    colrow: tuple[float, float]
    sigma_px: float = 1.0
    z: float = float("nan")
    where: str = ""


@dataclass(frozen=True)
class Stations:
    """Stations: S points on the ground, measured N times in photos.

    Attributes
    ----------
    ids : tuple of str (S,)
    xyz : array (S, 3)
        Given coordinates in the map CRS; x and y are NaN for common points.
    sigma : array (S,)
        Of the given x and y: 0 held, inf unknown.
    photo, station : int arrays (N,)
        Which photo shows which station.
    colrow : array (N, 2)
        Where, in pixels.
    sigma_px : array (N,)
    where : tuple of str (N,)
        File and line, or empty.
    """

    ids: tuple[str, ...]
    xyz: FloatArray
    sigma: FloatArray
    photo: IntArray
    station: IntArray
    colrow: FloatArray
    sigma_px: FloatArray
    where: tuple[str, ...]

    @property
    def held(self) -> BoolArray:
        """Which stations (S,) are held at their given place."""
        held: BoolArray = self.sigma == 0.0
        return held

    @property
    def shared(self) -> BoolArray:
        """Which stations (S,) are measured in more than one photo."""
        counts: IntArray = np.bincount(self.station, minlength=len(self.ids))
        several: BoolArray = counts > 1
        return several

    @classmethod
    def of(
        cls, photos: Sequence[OrientedImage], control: Sequence[ControlPoint], common: Sequence[CommonPoint]
    ) -> Stations:
        """Stations of control points (those of role 'check' are left out) and common points.

        Raises
        ------
        InputError
            A photo that is not there, a point measured twice in one, a common point in one photo only, or a number that
            is not finite.
        """
        number = {photo.name: index for index, photo in enumerate(photos)}
        heights = any(has_heights(photo.model.crs) for photo in photos)
        ids: dict[tuple[str, str], int] = {}
        xyz: list[tuple[float, float, float]] = []
        sigma: list[float] = []
        rows: list[tuple[int, int, float, float, float]] = []
        points: list[ControlPoint | CommonPoint] = [*(p for p in control if p.role == "control"), *common]
        for point in points:
            kind = "control" if isinstance(point, ControlPoint) else "common"
            where = f"{kind} point '{point.id}' in {point.image}"
            if point.image not in number:
                raise InputError("there is no such photo", where=where, hint=f"photos are: {', '.join(number)}")
            if not (np.isfinite(point.colrow).all() and 0.0 < point.sigma_px < np.inf):
                raise InputError("col, row or sigma_px is not a usable number", where=where)
            given = point.xyz if isinstance(point, ControlPoint) else (np.nan, np.nan, point.z if heights else 0.0)
            if not np.isfinite(given[2 if kind == "common" else 0 :]).all():
                raise InputError(
                    "the point has no usable coordinates or height", where=where, hint="give it a height z"
                )
            station = ids.setdefault((kind, point.id), len(ids))
            if station == len(xyz):
                xyz.append(given)
                sigma.append(point.sigma_xy if isinstance(point, ControlPoint) else np.inf)
            elif not np.array_equal(xyz[station], given, equal_nan=True):
                raise InputError("the point has other coordinates in another photo", where=where)
            rows.append((number[point.image], station, *point.colrow, point.sigma_px))
        table = np.array(rows, dtype=np.float64).reshape(-1, 5)
        photo, index = table[:, 0].astype(np.int64), table[:, 1].astype(np.int64)
        names = tuple(name for _, name in ids)
        for (first, station), count in Counter(zip(photo.tolist(), index.tolist(), strict=True)).items():
            if count > 1:
                raise InputError(f"point '{names[station]}' is measured twice", where=photos[first].name)
        stations = cls(
            names,
            np.array(xyz).reshape(-1, 3),
            np.array(sigma),
            photo,
            index,
            table[:, 2:4],
            table[:, 4].copy(),
            tuple(point.where for point in points),
        )
        alone = np.isinf(stations.sigma) & ~stations.shared
        if alone.any():
            raise InputError(
                f"common point '{names[int(np.argmax(alone))]}' is measured in one photo only",
                hint="measure it in a second photo, or leave it out",
            )
        return stations


def map_crs(photos: Sequence[OrientedImage], crs: CRS | None) -> CRS:
    """CRS in which stations are adjusted: the one given, or that of the models where they share one map.

    Parameters
    ----------
    photos : sequence of OrientedImage
    crs : CRS, optional

    Raises
    ------
    InputError
        None is given and the models do not share a map CRS.
    """
    if crs is not None:
        return crs
    first = photos[0].model.crs
    if first.is_geocentric or any(photo.model.crs != first for photo in photos):
        raise InputError("the photos do not share a map CRS", hint="name the CRS of the control points")
    return first
