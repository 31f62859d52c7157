"""Magnetic declination of a sheet, declared in the layout or from the World Magnetic Model at a date."""

from __future__ import annotations

import warnings
from dataclasses import dataclass

from geomosaic.errors import GeomosaicWarning, InputError
from geomosaic.geo.local_frames import MapPlace
from geomosaic.geo.magnetic_declination import FIRST, LAST, NAME, WEAKEST, decimal_year, magnetic_field
from geomosaic.sheets.layout import NorthPart

_WHERE = "[north] magnetic_date"


@dataclass(frozen=True)
class Declination:
    """Magnetic north against true north.

    Attributes
    ----------
    degrees : float
        East positive.
    date : str
        As the layout has it.
    annual_change : float or None
        Degrees, east positive.
    sigma : float or None
        Standard deviation in degrees where it is that of the model; None where it was declared.
    """

    degrees: float
    date: str = ""
    annual_change: float | None = None
    sigma: float | None = None


def declination(part: NorthPart, place: MapPlace | None) -> Declination | None:
    """Declination at the middle of a sheet; None if the layout has neither a declination nor a date.

    Parameters
    ----------
    part : NorthPart
    place : MapPlace or None
        None in a local frame, which has no north.

    Raises
    ------
    InputError
        The date is none, or one that the model does not cover.
    """
    if not part.show or place is None:
        return None
    if part.magnetic is not None:
        return Declination(part.magnetic, part.magnetic_date, part.annual_change)
    if not part.magnetic_date:
        return None
    year = decimal_year(part.magnetic_date, _WHERE)
    if not FIRST <= year <= LAST:
        raise InputError(
            f"the magnetic model {NAME} holds from {FIRST:.0f} to {LAST:.0f}, not in {part.magnetic_date}",
            where=_WHERE,
            hint="give [north] magnetic, the declination in degrees, or leave the date out",
        )
    field = magnetic_field(place.longitude, place.latitude, 0.0, year)
    if field.horizontal < WEAKEST:
        warnings.warn(
            f"no magnetic north is drawn: near the magnetic pole ({field.horizontal:.0f} nT along the ground) a "
            "compass does not point",
            GeomosaicWarning,
            stacklevel=2,
        )
        return None
    return Declination(field.declination, part.magnetic_date, field.annual_change, field.sigma)
