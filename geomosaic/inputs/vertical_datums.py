"""CRS and vertical datum of positions and DEMs: declared, or an error with the cost of a wrong guess."""

from __future__ import annotations

import math

from pyproj import CRS

from geomosaic.errors import HeightDatumError, InputError
from geomosaic.geo.crs import crs_label, height_name, parse_crs, with_heights, with_local_heights
from geomosaic.sensor.plausibility import DATUMS, datum_risk
from geomosaic.surface.model import undulation


def with_declared_heights(crs: CRS, heights: str | None, where: str | None = None) -> CRS:
    """CRS with its declared vertical datum, which replaces its own.

    Parameters
    ----------
    crs : CRS
    heights : str or None
        See `geomosaic.sensor.plausibility.DATUMS`; None leaves the CRS as it is.
    where : str, optional
        Input, for the message.

    Raises
    ------
    HeightDatumError
        The vertical datum is unknown, or its grid file is missing.
    """
    return crs if heights is None else with_heights(crs, heights, where)


def positions_crs(crs: str, heights: str | None, where: str | None = None) -> CRS:
    """CRS of positions with its declared vertical datum.

    Parameters
    ----------
    crs : str
        EPSG code, WKT or PROJ string.
    heights : str or None
        Declared vertical datum, see `geomosaic.sensor.plausibility.DATUMS`.
    where : str, optional
        Input, for the message.

    Raises
    ------
    InputError
        The text is no CRS, or one without x and y, or the vertical datum contradicts it.
    HeightDatumError
        The vertical datum is unknown, or its grid file is missing.
    """
    given = parse_crs(crs, where or "`crs`")
    if given.is_vertical and not given.is_compound:
        raise InputError(
            f"'{crs[:80]}' ({given.name}) is a vertical CRS: it defines heights, not x and y",
            where=where,
            hint="name a horizontal CRS, such as EPSG:32633, and this one as the vertical datum (heights)",
        )
    if given.is_geocentric and heights not in (None, "ellipsoidal"):
        raise InputError(
            f"positions in the geocentric CRS '{given.name}' have no vertical datum, but '{heights}' is given",
            where=where,
            hint="leave out the vertical datum, or name the CRS that the heights belong to",
        )
    return with_declared_heights(with_local_heights(given), heights, where or "`heights`")


def frame_description(crs: CRS | None) -> str:
    """CRS in words: its name, code, unit and vertical datum.

    Parameters
    ----------
    crs : CRS or None

    Returns
    -------
    str
        'none' without a CRS.
    """
    if crs is None:
        return "none"
    unit = crs.axis_info[0].unit_name if crs.axis_info else "unknown unit"
    return f"{crs_label(crs)}, {unit}; heights: {height_name(crs)}"


def undeclared_heights_error(
    what: str,
    where: str,
    option: str,
    crs: CRS,
    place: tuple[float, float],
    reach: float | None = None,
) -> HeightDatumError:
    """Error about heights without a vertical datum: what a wrong guess costs, and which option settles it.

    Parameters
    ----------
    what : str
        Subject of the message, as 'the positions'.
    where : str
        File.
    option : str
        Option that declares them.
    crs : CRS
        Horizontal CRS.
    place : tuple of float
        x, y in `crs`.
    reach : float, optional
        Pixels that one metre of height moves the edge of the image.

    Returns
    -------
    HeightDatumError
        To be raised by the caller.
    """
    risk = datum_risk(undulation(crs, *place), reach or math.nan)
    return HeightDatumError(
        f"the heights of {what} have no vertical datum{risk}",
        where=where,
        hint=f"declare it with {option}: {DATUMS}",
    )
