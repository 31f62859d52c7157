"""What every reader of control gives, and what they share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import PurePath

import numpy as np
from pyproj import CRS

from geomosaic.control.points import ImageControl, Origin
from geomosaic.errors import InputError, did_you_mean
from geomosaic.geo.crs import parse_crs


@dataclass(frozen=True)
class Reading:
    """Control, and how the file was understood.

    Attributes
    ----------
    control : ImageControl
    format : str
        'csv', 'qgis', 'odm', 'raster' or 'world'.
    notes : tuple of str
        What was decided while reading, for the reader of the report.
    """

    control: ImageControl
    format: str
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Measured:
    """One point as it was read; z is NaN where the file has none."""

    name: str
    colrow: tuple[float, float]
    xyz: tuple[float, float, float]
    origin: Origin
    sigma: float = 1.0
    role: str = "control"
    enabled: bool = True


def control_of(points: Sequence[Measured], crs: CRS, path: str) -> ImageControl:
    """Join points to one value; heights are left off where no point has one.

    Raises
    ------
    InputError
        There are no points, or one of them is wrong.
    """
    if not points:
        raise InputError("there are no points in the file", where=path, mend="is it the right file?")
    ground = np.array([point.xyz for point in points])
    if np.isnan(ground[:, 2]).all():
        ground = ground[:, :2]
    return ImageControl(
        tuple(point.name for point in points),
        np.array([point.colrow for point in points]),
        ground,
        crs,
        np.array([point.sigma for point in points]),
        tuple(point.role for point in points),
        np.array([point.enabled for point in points]),
        tuple(point.origin for point in points),
    )


def ground_crs(said: str | CRS | None, given: str | CRS | None, where: str) -> CRS:
    """Settle the CRS of the ground between what the file says and what the user gives.

    Raises
    ------
    InputError
        Neither says it, or they differ.
    """
    stated = parse_crs(said, where) if said else None
    wanted = parse_crs(given, "the CRS given for the control") if given else None
    found = stated or wanted
    if found is None:
        raise InputError(
            "the file does not say which CRS its ground coordinates are in",
            where=where,
            mend="give it, for example EPSG:32633",
        )
    if stated is not None and wanted is not None and not stated.equals(wanted, ignore_axis_order=True):
        raise InputError(
            f"the file says its ground coordinates are in '{stated.name}', and '{wanted.name}' is given",
            where=where,
            mend="give none, or correct the file; control is transformed to the CRS of the output by itself",
        )
    return found


def choose_image(names: Sequence[str], image: str | None, path: str) -> set[str]:
    """Return which of the names of a file's images mean `image`; the only one there is when none is given.

    Names match with their whole file name, else without extension; folders do not count.

    Raises
    ------
    InputError
        Several images and none chosen, or one chosen that the file does not have.
    """
    known = sorted(set(names))
    shown = ", ".join(known[:8]) + (" ..." if len(known) > 8 else "")
    if image is None:
        if (images := len({_last(name) for name in known})) > 1:
            raise InputError(f"the file has points of {images} images: {shown}", where=path, mend="name the image")
        return set(known)
    found = {name for name in known if _last(name) == _last(image)}
    found = found or {name for name in known if _stem(name) == _stem(image)}
    if not found:
        hint = did_you_mean(_last(image), [_last(name) for name in known])
        raise InputError(
            f"no point is measured in '{_last(image)}'", where=path, mend=f"{hint} the file has {shown}".strip()
        )
    if len({_last(name) for name in found}) > 1:
        raise InputError(f"'{image}' may mean {' or '.join(sorted(found))}", where=path, mend="give the extension too")
    return found


def _last(name: str) -> str:
    return PurePath(name.replace("\\", "/")).name.casefold()


def _stem(name: str) -> str:
    base, dot, extension = _last(name).rpartition(".")
    return base if dot and base and extension.isalnum() and not extension.isdigit() else _last(name)
